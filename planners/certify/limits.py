"""Time, joints and their limits, at the samples and on the Hermite curve between them."""

from __future__ import annotations

import numpy as np

from planners.certify.finding import Finding
from planners.certify.kinematics import HermiteCurve
from planners.certify.plan_view import PlanView, SegmentView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.scenery import ARMS, JOINT_NAMES
from planners.plan.verdicts import Check

_STANDING = ("grip", "release", "attach", "detach")
_EMPTY_MOTIONS = ("transit", "approach", "retreat")
"""Kinds whose way may have no length; then their mover rests."""
_ROUNDING = 1e-9
"""What floating point may add to a time, a position or a rate."""


def joint_checks(plan: PlanView, settings: CertifySettings) -> list[Check]:
    """Check time, rest, who moves, positions, velocities, accelerations and that they belong together."""
    return [
        _time(plan, settings),
        _rest(plan, settings),
        _movers(plan, settings),
        *_limits(plan, settings),
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
        if segment.kind in _STANDING:
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


def _limits(plan: PlanView, settings: CertifySettings) -> list[Check]:
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
