"""Who holds the tool, what is on its cup and what stands on what, from segment to segment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.geometry.level_contacts import LevelFaces, contact_points
from planners.certify.geometry.vectors import cross, length
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion
from planners.certify.motion.solids import ConvexSolid, signed_distance
from planners.certify.plan_view import NumberedSegment
from planners.certify.tool.task import TOOL
from planners.geometry.pose import Array
from planners.plan.contacts import BearingContact
from planners.plan.verdicts import Check


@dataclass(frozen=True)
class ToolState:
    """Where things are between two segments."""

    hands: frozenset[str]
    """Arms that hold the tool."""
    sucked: str | None
    """The object on the cup."""
    supports: Mapping[str, frozenset[str]]
    """What each body that is in no hand and on no cup stands on."""


@dataclass(frozen=True)
class StateChange:
    """One segment, with the states before and after it."""

    segment: NumberedSegment
    before: ToolState
    after: ToolState

    @property
    def bearers(self) -> frozenset[str]:
        """Arms that hold the tool all along."""
        return self.before.hands & self.after.hands

    @property
    def on_cup(self) -> frozenset[str]:
        """The object on the cup before or after, if any."""
        return frozenset(name for name in (self.before.sucked, self.after.sucked) if name is not None)

    def needs_sets(self, name: str) -> bool:
        """Whether the contacts of a body must be shown: it is in a hand all along, or on the cup."""
        return bool(self.bearers) if name == TOOL else name in self.on_cup


class ToolStates:
    """Follows a plan, and notes where a hand, the vacuum or a support is not what it must be."""

    def __init__(self, evidence: Evidence) -> None:
        """Go through the plan; afterwards `steps` has one entry a segment."""
        self.settings, self.steps = evidence.settings, list[StateChange]()
        self._hands = Finding("hands", "1")
        self._vacuum = Finding("vacuum", "N")
        self._support = Finding("supports", "1")
        state = ToolState(frozenset(), None, start_supports(evidence))
        for motion in evidence.motions:
            after = self._after(motion, state)
            self.steps.append(StateChange(motion.segment, state, after))
            self._check_contacts(self.steps[-1], motion)
            state = after
        for last in evidence.plan.segments[-1:]:
            text = f"{state.sucked} is still on the cup"
            self._vacuum.require(state.sucked is None, f"{last.place()}, end", text)

    def checks(self) -> list[Check]:
        """Return what was found of hands, vacuum and supports."""
        return [self._hands.check(), self._vacuum.check(), self._support.check()]

    def _after(self, motion: SegmentMotion, state: ToolState) -> ToolState:
        segment, supports = motion.segment, dict(state.supports)
        hands = self._hands_after(segment, state)
        if hands and not state.hands:
            supports.pop(TOOL, None)
        if state.hands and not hands:
            supports[TOOL] = self._settled(motion, TOOL)
        sucked = self._sucked_after(segment, state)
        if segment.kind == "attach" and sucked is not None:
            supports.pop(sucked, None)
            above = [name for name, below in supports.items() if sucked in below]
            self._support.require(not above, segment.place(), f"{sucked} is taken from under {', '.join(above)}")
        if segment.kind == "detach" and state.sucked is not None:
            supports[state.sucked] = self._settled(motion, state.sucked)
        return ToolState(hands, sucked, supports)

    def _settled(self, motion: SegmentMotion, name: str) -> frozenset[str]:
        """Return what a body stands on when it is let go of: the contacts of its last set."""
        last = motion.samples - 1
        contacts = [c for one in motion.contacts if one.body == name and one.sample == last for c in one.bearing]
        below = frozenset(c.by for c in contacts if c.kind == "environment" and float(c.force @ c.normal) > 0.0)
        self._support.require(bool(below), motion.segment.place(last), f"{name} is let go of, and nothing bears it")
        return below

    def _hands_after(self, segment: NumberedSegment, state: ToolState) -> frozenset[str]:
        where, stated = segment.place(), frozenset(grip.arm for grip in segment.grips)
        for grip in segment.grips:
            self._hands.require(grip.body == TOOL, where, f"a hand holds {grip.body}: fingers hold the tool alone")
        acting = None if segment.grip is None else segment.grip.arm
        if segment.kind == "grip":
            self._hands.require(acting is not None, where, "names no hand that takes hold")
            self._hands.require(acting not in state.hands, where, f"the {acting} hand holds the tool already")
            after = state.hands if acting is None else state.hands | {acting}
            expected = after
        elif segment.kind == "release":
            self._hands.require(acting in state.hands, where, f"the {acting} hand does not hold the tool")
            after, expected = state.hands - {acting or ""}, state.hands
        else:
            after = expected = state.hands
        held, said = _listed(expected), _listed(stated)
        self._hands.require(stated == expected, where, f"held by {held}, and {said} in the document")
        if segment.kind == "handover":
            self._hands.require(len(after) == 2, where, "the tool is not in both hands")
        if segment.kind == "transfer":
            self._hands.require(len(after) == 1, where, "the tool moves, and not in one hand")
        movers = frozenset(segment.movers) & state.hands
        if segment.kind in ("transit", "approach", "retreat"):
            self._hands.require(not movers, where, f"{_listed(movers)} moves and holds the tool: it is no free hand")
        return after

    def _sucked_after(self, segment: NumberedSegment, state: ToolState) -> str | None:
        where = segment.place()
        on_cup = {c.body for c in segment.contacts if c.kind == "suction" and c.by == TOOL}
        if segment.kind == "attach":
            one = len(on_cup) == 1 and state.sucked is None
            self._vacuum.require(one, where, f"takes {_listed(on_cup)}, with {state.sucked} on the cup")
            return next(iter(on_cup)) if one else state.sucked
        if segment.kind == "detach":
            known = state.sucked is not None and on_cup == {state.sucked}
            self._vacuum.require(known, where, f"gives up {_listed(on_cup)}, with {state.sucked} on the cup")
            return None
        stray = on_cup - {state.sucked}
        self._vacuum.require(not stray, where, f"{_listed(stray)} is sucked, and was never attached")
        return state.sucked

    # The contacts of one segment.

    def _check_contacts(self, step: StateChange, motion: SegmentMotion) -> None:
        hands = step.before.hands | step.after.hands
        still = {name for name, poses in motion.body_poses.items() if np.ptp(poses, axis=0).max() <= self.settings.join}
        for one in motion.contacts:
            for contact in one.bearing:
                self._party(contact, one, hands, still)
            self._empty_cup(step, one)
        self._reactions(step, motion.contacts)

    def _party(self, contact: BearingContact, one: BodyContacts, hands: frozenset[str], still: set[str]) -> None:
        if contact.kind == "soft_finger":
            allowed = contact.by in hands and one.body == TOOL
            self._hands.require(allowed, one.where, f"fingers of the {contact.by} hand press, which do not hold it")
        elif contact.kind == "environment":
            allowed = {contact.by, one.body} <= still
            self._support.require(allowed, one.where, f"rests on {contact.by}, and one of them moves")

    def _empty_cup(self, step: StateChange, one: BodyContacts) -> None:
        """The cup bears nothing before the vacuum is on, nor after it went off."""
        empty = {"attach": 0, "detach": len(step.segment.time) - 1}.get(step.segment.kind)
        if one.sample != empty:
            return
        for contact in one.bearing:
            if contact.kind == "suction":
                left = self.settings.force_balance - length(contact.force)
                self._vacuum.note(left, f"{one.where}: the cup bears something without vacuum")

    def _reactions(self, step: StateChange, group: Sequence[BodyContacts]) -> None:
        """What the tool exerts on an object, the object exerts on the tool."""
        sets = {(one.body, one.sample): one for one in group}
        for name in step.on_cup:
            samples = {sample for body, sample in sets if body in (name, TOOL)}
            for sample in sorted(samples):
                where = f"{step.segment.place(sample)}: {name} and tool"
                on_object = _suction(sets.get((name, sample)), TOOL)
                on_tool = _suction(sets.get((TOOL, sample)), name)
                if on_object is None or on_tool is None:
                    self._vacuum.require(False, where, "the suction is not listed on both")
                    continue
                apart = float(np.abs(on_object + on_tool).max())
                self._vacuum.note(self.settings.cone_slack - apart, f"{where}: not opposite")


def _suction(one: BodyContacts | None, by: str) -> Array | None:
    """Return force, torque and point of one suction contact such that those of its reaction are the negative."""
    found = [] if one is None else [c for c in one.bearing if c.kind == "suction" and c.by == by]
    if len(found) != 1:
        return None
    # The torque is taken about the world's origin, so that a reaction at another point is not opposite.
    return np.concatenate([found[0].force, found[0].torque + cross(found[0].point, found[0].force)])


def _listed(names: set[str] | frozenset[str]) -> str:
    return " and ".join(sorted(names)) or "nothing"


def start_supports(evidence: Evidence) -> dict[str, frozenset[str]]:
    """Return what each movable body stands on at the start.

    That is what it touches that does not reach above its foot, or has a level place under it, as a tray with walls has.
    """
    bodies, touch = evidence.plan.bodies, evidence.settings.touch_depth
    parts: dict[str, list[ConvexSolid]] = {}
    for solid in evidence.solids:
        if solid.arm is None:
            parts.setdefault(solid.frame.owner, []).append(solid)
    top = {name: float(bodies[name].heights.max()) for name in parts}

    def apart(name: str, other: str) -> float:
        poses = bodies[name].T_world_start, bodies[other].T_world_start
        return min(signed_distance(a, poses[0], b, poses[1]) for a in parts[name] for b in parts[other])

    levels = {name: LevelFaces(bodies[name].shape, bodies[name].T_world_start) for name in parts}

    def carries(other: str, name: str) -> bool:
        if bodies[other].lowest >= bodies[name].lowest:
            # A thin body that lies on this one has its top as near.
            return False
        if top[other] <= bodies[name].lowest + touch:
            return True
        upper, lower = levels[name], levels[other]
        near = np.all((upper.low <= lower.high + touch) & (lower.low <= upper.high + touch))
        return bool(near) and len(contact_points(upper, lower, touch)) > 0

    found = {}
    for name in (name for name in parts if not bodies[name].static):
        below = [other for other in parts if other != name and carries(other, name)]
        found[name] = frozenset(other for other in below if apart(name, other) <= touch)
    return found
