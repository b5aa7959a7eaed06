"""Segments follow one another without a jump, from the start that the task states."""

from __future__ import annotations

import numpy as np

from planners.certify.finding import Finding
from planners.certify.motion import SegmentMotion
from planners.certify.plan_view import PlanView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.scenery import JOINT_NAMES
from planners.plan.verdicts import Check


def join_checks(
    plan: PlanView, motions: list[SegmentMotion], start: Array | None, settings: CertifySettings
) -> list[Check]:
    """Check that segments meet, and that the first starts with the joints where they should; None is anywhere."""
    return [_joins(plan, motions, settings), _start(plan, start, settings)]


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


def _start(plan: PlanView, start: Array | None, settings: CertifySettings) -> Check:
    finding = Finding("start", "rad")
    if plan.segments and start is not None:
        distance = np.abs(plan.segments[0].positions[0] - start)
        finding.note_all(settings.join - distance, lambda j: f"{plan.segments[0].place(0)}: {JOINT_NAMES[j]}")
    return finding.check()
