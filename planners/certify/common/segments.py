"""Segments: time, joints and their limits on the curve, what each kind may do, and how they follow one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.certify.finding import Finding
from planners.certify.motion.kinematics import HermiteCurve
from planners.certify.motion.segment_motion import SegmentMotion
from planners.certify.plan_view import PlanView, SegmentView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.scenery import ARMS, JOINT_NAMES
from planners.plan.verdicts import Check

_JOINTS_REST = ("grip", "release", "attach", "detach")
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
_STANDING = frozenset({*_FINGERS, "handover", "attach", "detach"})
SUCTION_TOOL = KindRules(
    "suction-tool plan", _HANDS_ONLY | _STANDING | {"transfer"}, _HANDS_ONLY | _STANDING, _STANDING
)


def joint_checks(plan: PlanView, settings: CertifySettings) -> list[Check]:
    """Check time, rest, who moves, positions, velocities, accelerations and that they belong together."""
    return [
        _time(plan, settings),
        _rest(plan, settings),
        _movers(plan, settings),
        *_limit_checks(plan, settings),
        _consistency(plan, settings),
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
    finding = Finding("rest", "rad/s")

    def note(segment: SegmentView, first: int, speeds: Array) -> None:
        margins = settings.rest_velocity - np.abs(speeds)
        finding.note_all(margins, lambda i, j: f"{segment.place(first + i)}: {JOINT_NAMES[j]}")

    for segment in plan.segments:
        if segment.kind in _JOINTS_REST:
            note(segment, 0, segment.velocities)
    if plan.segments:
        last = plan.segments[-1]
        note(last, len(last.time) - 1, last.velocities[-1:])
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
        for index, arm in enumerate(ARMS):
            columns = slice(6 * index, 6 * index + 6)
            if arm not in segment.movers:
                drift = np.abs(segment.positions[:, columns] - segment.positions[0, columns])
                finding.note_all(
                    settings.join - drift,
                    lambda i, j, s=segment, f=6 * index: f"{s.place(i)}: {JOINT_NAMES[f + j]} is no mover",
                )
    return finding.check()


def _stacked(plan: PlanView, name: str) -> Array:
    return np.concatenate([getattr(arm, name) for arm in (plan.arms[arm] for arm in ARMS)])


def _limit_checks(plan: PlanView, settings: CertifySettings) -> list[Check]:
    low, high = _stacked(plan, "position_min"), _stacked(plan, "position_max")
    fastest, hardest = (_stacked(plan, "velocity_max"), _stacked(plan, "acceleration_max"))
    slack = settings.limit_slack
    position = Finding("joint_positions", "rad")
    velocity = Finding("joint_velocities", "rad/s")
    acceleration = Finding("joint_accelerations", "rad/s^2")
    for segment in plan.segments:
        curve = HermiteCurve(segment.time, segment.positions, segment.velocities)
        lowest, highest = curve.position_extremes()

        def after(i: int, j: int, s: SegmentView = segment) -> str:
            return f"{s.place(i)} and the curve after it: {JOINT_NAMES[j]}"

        position.note_all(lowest - low + slack * np.abs(low) + _ROUNDING, after)
        position.note_all(high + slack * np.abs(high) - highest + _ROUNDING, after)
        velocity.note_all((1 + slack) * fastest - curve.velocity_peak, after)
        acceleration.note_all((1 + slack) * hardest - np.abs(segment.accelerations), after)
        acceleration.note_all((1 + slack) * hardest - curve.acceleration_peak, after)
    return [position.check(), velocity.check(), acceleration.check()]


def _consistency(plan: PlanView, settings: CertifySettings) -> Check:
    finding = Finding("velocity_consistency", "rad/s")
    for segment in plan.segments:
        rate = np.diff(segment.positions, axis=0) / np.diff(segment.time)[:, None]
        mean = (segment.velocities[:-1] + segment.velocities[1:]) / 2
        finding.note_all(
            settings.velocity_consistency - np.abs(rate - mean),
            lambda i, j, s=segment: f"{s.place(i)} and the next: {JOINT_NAMES[j]}",
        )
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
        finding.note_all(
            tolerance - np.maximum(outside, 0.0),
            lambda i, j, s=segment: f"{s.place(i)} and the next: {JOINT_NAMES[j]}",
        )
    return finding.check()


def kind_check(motions: list[SegmentMotion], rules: KindRules, settings: CertifySettings) -> Check:
    """Check what moves in segments of each kind: bodies in transfers only, fingers alone in grips and releases."""
    finding = Finding("kinds", "1")
    for motion in motions:
        segment, where = motion.segment, motion.segment.place()
        finding.require(segment.kind in rules.kinds, where, f"has no place in a {rules.plan}")
        if segment.kind in rules.bodies_rest:
            for name, poses in segment.body_poses.items():
                still = float(np.ptp(poses, axis=0).max()) <= settings.join
                finding.require(still, where, f"{name} moves")
        if segment.kind in _FINGERS:
            change = _FINGERS[segment.kind] * np.array([w[-1] - w[0] for w in segment.widths.values()])
            finding.require(change.max(initial=0.0) > settings.join, where, "no fingers move as the kind says")
            finding.require(change.min(initial=0.0) >= -settings.join, where, "fingers move the other way")
        if segment.kind in rules.joints_rest:
            still = float(np.ptp(segment.positions, axis=0).max()) <= settings.join
            finding.require(still, where, "joints move with the fingers" if segment.kind in _FINGERS else "joints move")
    return finding.check()


def join_checks(
    plan: PlanView, motions: list[SegmentMotion], start: Array | None, settings: CertifySettings
) -> list[Check]:
    """Check that segments meet, and that the first starts with the joints where they should; None is anywhere."""
    return [_joins(plan, motions, settings), _start_check(plan, start, settings)]


def _joins(plan: PlanView, motions: list[SegmentMotion], settings: CertifySettings) -> Check:
    finding = Finding("joins", "s, rad, rad/s, m")
    for before, after in zip(plan.segments[:-1], plan.segments[1:], strict=True):
        where = f"{after.place(0)}"
        finding.note(settings.join - abs(float(after.time[0] - before.time[-1])), f"{where}: time")
        for name in ("positions", "velocities"):
            jump = np.abs(getattr(after, name)[0] - getattr(before, name)[-1])
            finding.note_all(settings.join - jump, lambda j, w=where, n=name: f"{w}: {n} of {JOINT_NAMES[j]}")
        for arm, widths in after.widths.items():
            jump = abs(float(widths[0] - before.widths[arm][-1]))
            finding.note(settings.join - jump, f"{where}: opening of the {arm} gripper")
    last = {name: body.T_world_start for name, body in plan.bodies.items()}
    for motion in motions:
        for name, poses in motion.segment.body_poses.items():
            jump = float(np.abs(poses[0] - last[name]).max())
            finding.note(settings.join - jump, f"{motion.segment.place(0)}: pose of {name}")
            last[name] = poses[-1]
    return finding.check()


def _start_check(plan: PlanView, start: Array | None, settings: CertifySettings) -> Check:
    finding = Finding("start", "rad")
    if plan.segments and start is not None:
        distance = np.abs(plan.segments[0].positions[0] - start)
        finding.note_all(settings.join - distance, lambda j: f"{plan.segments[0].place(0)}: {JOINT_NAMES[j]}")
    return finding.check()
