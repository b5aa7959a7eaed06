"""Attached bodies stay where they are attached, and what is attached to nothing stays where it is."""

from __future__ import annotations

from collections.abc import Callable, Set

import numpy as np

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.motion.segment_motion import relative, rotation_angles
from planners.certify.plan_view import NumberedSegment
from planners.plan.scenery import ARMS
from planners.plan.verdicts import Check


def drift_checks(evidence: Evidence) -> list[Check]:
    """Check drift and turn of attached bodies."""
    place, turn, settings = Finding("attachments", "m"), Finding("attachment_angles", "rad"), evidence.settings
    for motion in evidence.motions:
        for body, ride in motion.segment.rides:
            holder = motion.frames[ride.to][:, 6] if ride.to in ARMS else motion.body_poses[ride.to]
            poses = relative(holder, motion.body_poses[body])
            distance = np.linalg.norm(poses[:, :3, 3] - ride.T_to_body[:3, 3], axis=1)
            text, turned = f"{body} on {ride.to}", rotation_angles(poses, ride.T_to_body)
            place.note_samples(motion.segment, settings.attachment_distance - distance, text)
            turn.note_samples(motion.segment, settings.attachment_angle - turned, text)
    return [place.check(), turn.check()]


def resting_check(evidence: Evidence, carried: Callable[[NumberedSegment], Set[str]]) -> Check:
    """Check that bodies move only where they are carried; `carried` names those of a segment."""
    finding = Finding("resting_bodies", "m")
    for segment in evidence.plan.segments:
        free = carried(segment)
        for name, poses in segment.transforms.items():
            if name not in free:
                moved = np.abs(poses - poses[0]).max(axis=(1, 2))
                finding.note_samples(segment, evidence.settings.join - moved, f"{name} moves, held by nothing")
            if evidence.plan.bodies[name].static:
                finding.require(False, segment.place(), f"{name} is static and has poses")
    return finding.check()
