"""Segments: time, joints and their limits on the curve, what each kind may do, and how they follow one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.motion.kinematics import HermiteCurve
from planners.certify.plan_view import PlanView
from planners.certify.settings import CertifySettings
from planners.plan.scenery import ARMS, JOINT_NAMES
from planners.plan.verdicts import Check

_EMPTY_MOTIONS = ("transit", "approach", "retreat")
"""Kinds whose way may have no length; then their mover rests."""
_ROUNDING = 1e-9
"""What floating point may add to a time, a position or a rate."""
_FINGERS = {"grip": -1.0, "release": 1.0}
"""Sign of the change of an opening."""


@dataclass(frozen=True)
class KindRules:
    """What segments of each kind may do in one kind of plan."""

    plan: str
    """What the plan is called."""
    kinds: frozenset[str]
    """Those that it may have."""
    bodies_rest: frozenset[str]
    """Kinds in which no body moves."""
    joints_rest: frozenset[str]
    """Kinds in which no joint moves."""


_HANDS_ONLY = frozenset({"transit", "approach", "retreat", "grip", "release"})
PLATE_LIFT = KindRules("plate lift", _HANDS_ONLY | {"transfer"}, _HANDS_ONLY, frozenset(_FINGERS))
"""A transfer may move the plate, and need not; the cup holds from first to last."""
_SWITCHING = frozenset({*_FINGERS, "attach", "detach"})
_STANDING = _SWITCHING | {"handover"}
SUCTION_TOOL = KindRules(
    "suction-tool plan", _HANDS_ONLY | _STANDING | {"transfer"}, _HANDS_ONLY | _STANDING, _STANDING
)


def joint_checks(evidence: Evidence) -> list[Check]:
    """Check time, rest, who moves, positions, velocities, accelerations and that they belong together."""
    plan, settings = evidence.plan, evidence.settings
    return [
        _time(plan, settings),
        _rest(plan, settings),
        _movers(plan, settings),
        *_limits(plan, settings),
        _velocity_consistency(plan, settings),
        _acceleration_consistency(plan, settings),
    ]


def _time(plan: PlanView, settings: CertifySettings) -> Check:
    finding = Finding("time", "s")
    for segment in plan.segments:
        steps = np.diff(segment.time)
        finding.note_all(steps - _ROUNDING, lambda i, s=segment: f"{s.place(i)} and the next: time must rise")
        longest = settings.time_step + _ROUNDING
        finding.note_all(longest - steps, lambda i, s=segment: f"{s.place(i)} and the next: longest step")
    if plan.segments:
        start = abs(float(plan.segments[0].time[0]))
        if start > settings.join:
            finding.note(settings.join - start, f"{plan.segments[0].place(0)}: the first time is not 0")
    return finding.check()


def _rest(plan: PlanView, settings: CertifySettings) -> Check:
    """A plan begins and ends at rest; and joints rest that its segments, and their kinds, do not move."""
    finding = Finding("rest", "rad/s")
    for segment in plan.segments:
        moves = [arm in segment.movers and segment.kind not in _STANDING for arm in ARMS]
        resting = np.flatnonzero(~np.repeat(moves, 6))
        finding.note_all(
            settings.rest_velocity - np.abs(segment.velocities[:, resting]),
            lambda i, j, s=segment, r=resting: f"{s.place(i)}: {JOINT_NAMES[r[j]]}",
        )
    for first in plan.segments[:1]:
        finding.note_joints(first, settings.rest_velocity - np.abs(first.velocities[:1]))
    for last in plan.segments[-1:]:
        end = len(last.time) - 1
        finding.note_joints(last, settings.rest_velocity - np.abs(last.velocities[end:]), first=end)
    return finding.check()


def _movers(plan: PlanView, settings: CertifySettings) -> Check:
    """Arms that are no movers rest, and every mover moves, unless it goes a way of no length."""
    finding = Finding("movers", "rad")
    for segment in plan.segments:
        moves = np.ptp(segment.positions, axis=0) > settings.join
        moves |= np.abs(segment.velocities).max(axis=0) > settings.rest_velocity
        moving = {arm for arm, joints in zip(ARMS, moves.reshape(2, 6), strict=True) if joints.any()}
        if moving or segment.kind not in _EMPTY_MOTIONS:
            idle = sorted(set(segment.movers) - moving)
            finding.require(not idle, segment.place(), f"{' and '.join(idle)} is a mover and rests")
        resting = np.flatnonzero([arm not in segment.movers for arm in np.repeat(ARMS, 6)])
        drift = np.abs(segment.positions[:, resting] - segment.positions[0, resting])
        finding.note_all(
            settings.join - drift, lambda i, j, s=segment, r=resting: f"{s.place(i)}: {JOINT_NAMES[r[j]]} is no mover"
        )
    return finding.check()


def _limits(plan: PlanView, settings: CertifySettings) -> list[Check]:
    stated = [plan.cell.arms[arm] for arm in ARMS]
    low, high, fastest, hardest = (
        np.concatenate([getattr(arm, name) for arm in stated])
        for name in ("position_min", "position_max", "velocity_max", "acceleration_max")
    )
    slack, after = settings.limit_slack, " and the curve after it"
    position = Finding("joint_positions", "rad")
    velocity = Finding("joint_velocities", "rad/s")
    acceleration = Finding("joint_accelerations", "rad/s^2")
    for segment in plan.segments:
        curve = HermiteCurve(segment.time, segment.positions, segment.velocities)
        lowest, highest = curve.position_extremes()
        position.note_joints(segment, lowest - low + slack * np.abs(low) + _ROUNDING, after)
        position.note_joints(segment, high + slack * np.abs(high) - highest + _ROUNDING, after)
        velocity.note_joints(segment, (1 + slack) * fastest - curve.velocity_peak, after)
        acceleration.note_joints(segment, (1 + slack) * hardest - np.abs(segment.accelerations), after)
        acceleration.note_joints(segment, (1 + slack) * hardest - curve.acceleration_peak, after)
    return [position.check(), velocity.check(), acceleration.check()]


def _velocity_consistency(plan: PlanView, settings: CertifySettings) -> Check:
    finding = Finding("velocity_consistency", "rad/s")
    for segment in plan.segments:
        rate = np.diff(segment.positions, axis=0) / np.diff(segment.time)[:, None]
        mean = (segment.velocities[:-1] + segment.velocities[1:]) / 2
        finding.note_joints(segment, settings.velocity_consistency - np.abs(rate - mean), " and the next")
    return finding.check()


def _acceleration_consistency(plan: PlanView, settings: CertifySettings) -> Check:
    """The mean acceleration of a step lies between the accelerations stated at its ends, up to a tolerance.

    Not near the mean of the two: an acceleration may jump within a step, as those of time-optimal motions do.
    """
    finding = Finding("acceleration_consistency", "rad/s^2")
    for segment in plan.segments:
        mean = np.diff(segment.velocities, axis=0) / np.diff(segment.time)[:, None]
        start, end = segment.accelerations[:-1], segment.accelerations[1:]
        outside = np.maximum(np.minimum(start, end) - mean, mean - np.maximum(start, end))
        tolerance = settings.acceleration_consistency + settings.acceleration_fraction * np.abs(mean).max()
        finding.note_joints(segment, tolerance - np.maximum(outside, 0.0), " and the next")
    return finding.check()


def kind_check(evidence: Evidence, rules: KindRules) -> Check:
    """Check what moves in segments of each kind, bodies in transfers and fingers in grips only, and for how long."""
    finding, join, switching = Finding("kinds", "1"), evidence.settings.join, evidence.settings.switching
    for segment in evidence.plan.segments:
        where = segment.place()
        finding.require(segment.kind in rules.kinds, where, f"has no place in a {rules.plan}")
        if segment.kind in rules.bodies_rest:
            for name, poses in segment.transforms.items():
                finding.require(float(np.ptp(poses, axis=0).max()) <= join, where, f"{name} moves")
        if segment.kind in _SWITCHING:
            lasts = float(segment.time[-1] - segment.time[0])
            told = f"fingers and vacuum have {1e3 * lasts:.3g} ms, and need {1e3 * switching:g}"
            finding.require(lasts >= switching - _ROUNDING, where, told)
        if segment.kind in _FINGERS:
            change = _FINGERS[segment.kind] * np.array([w[-1] - w[0] for w in segment.gripper_width.values()])
            finding.require(change.max(initial=0.0) > join, where, "no fingers move as the kind says")
            finding.require(change.min(initial=0.0) >= -join, where, "fingers move the other way")
        if segment.kind in rules.joints_rest:
            still = float(np.ptp(segment.positions, axis=0).max()) <= join
            finding.require(still, where, "joints move with the fingers" if segment.kind in _FINGERS else "joints move")
    return finding.check()


def join_checks(evidence: Evidence, start: Sequence[float] | None) -> list[Check]:
    """Check that segments meet, and that the first starts with the joints where they should.

    Args:
        evidence: of the document.
        start: (12,) as the task states it [rad]; None: at home, and anywhere where that is not known.
    """
    plan, settings = evidence.plan, evidence.settings
    joins, begin = Finding("joins", "s, rad, rad/s, m"), Finding("start", "rad")
    for before, after in pairwise(plan.segments):
        where = after.place(0)
        joins.note(settings.join - abs(float(after.time[0] - before.time[-1])), f"{where}: time")
        for name in ("positions", "velocities"):
            jump = np.abs(getattr(after, name)[0] - getattr(before, name)[-1])
            joins.note_all(settings.join - jump, lambda j, w=where, n=name: f"{w}: {n} of {JOINT_NAMES[j]}")
        for arm, widths in after.gripper_width.items():
            jump = abs(float(widths[0] - before.gripper_width[arm][-1]))
            joins.note(settings.join - jump, f"{where}: opening of the {arm} gripper")
    last = {name: body.T_world_start for name, body in plan.bodies.items()}
    for segment in plan.segments:
        for name, poses in segment.transforms.items():
            joins.note(
                settings.join - float(np.abs(poses[0] - last[name]).max()), f"{segment.place(0)}: pose of {name}"
            )
            last[name] = poses[-1]
    home = None if evidence.reference is None else evidence.reference.home
    expected = home if start is None else np.array(start)
    if plan.segments and expected is not None:
        begin.note_joints(plan.segments[0], settings.join - np.abs(plan.segments[0].positions[:1] - expected))
    return [joins.check(), begin.check()]
