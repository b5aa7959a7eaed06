"""Attached bodies stay where they are attached, and what is attached to nothing stays where it is."""

from __future__ import annotations

from collections.abc import Callable, Set

import numpy as np

from planners.certify.finding import Finding
from planners.certify.motion.segment_motion import SegmentMotion, relative
from planners.certify.plan_view import PlanView, SegmentView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.scenery import ARMS
from planners.plan.verdicts import Check


def rotation_angles(poses: Array, T: Array) -> Array:
    """Return the angles between orientations of (n, 4, 4) poses and of one pose [rad]."""
    chord = np.linalg.norm(poses[:, :3, :3] - T[:3, :3], axis=(1, 2)) / np.sqrt(2.0)
    return 2 * np.arcsin(np.clip(chord / 2, 0.0, 1.0))


def drift_checks(motions: list[SegmentMotion], settings: CertifySettings) -> list[Check]:
    """Check drift and turn of attached bodies."""
    place, turn = Finding("attachments", "m"), Finding("attachment_angles", "rad")
    for motion in motions:
        for attachment in motion.segment.attached:
            to = attachment.to
            holder = motion.frames[to][:, 6] if to in ARMS else motion.body_poses[to]
            poses = relative(holder, motion.body_poses[attachment.body])
            distance = np.linalg.norm(poses[:, :3, 3] - attachment.T_to_body[:3, 3], axis=1)

            def where(i: int, m: SegmentMotion = motion, text: str = f"{attachment.body} on {to}") -> str:
                return f"{m.segment.place(i)}: {text}"

            place.note_all(settings.attachment_distance - distance, where)
            turn.note_all(settings.attachment_angle - rotation_angles(poses, attachment.T_to_body), where)
    return [place.check(), turn.check()]


def resting_check(
    plan: PlanView,
    motions: list[SegmentMotion],
    carried: Callable[[SegmentView], Set[str]],
    settings: CertifySettings,
) -> Check:
    """Check that bodies move only where they are carried; `carried` names those of a segment."""
    finding = Finding("resting_bodies", "m")
    for segment in (motion.segment for motion in motions):
        free = carried(segment)
        for name, poses in segment.body_poses.items():
            if name not in free:
                moved = np.abs(poses - poses[0]).max(axis=(1, 2))
                finding.note_all(
                    settings.join - moved, lambda i, s=segment, n=name: f"{s.place(i)}: {n} moves, held by nothing"
                )
            if plan.bodies[name].static:
                finding.require(False, segment.place(), f"{name} is static and has poses")
    return finding.check()
