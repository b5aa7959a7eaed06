"""The plate touches its support with the element that each segment states, and is lifted at the end."""

from __future__ import annotations

import numpy as np

from planners.certify.certificate import Check, Finding
from planners.certify.document_view import PlanView
from planners.certify.lift_task import LiftTask
from planners.certify.motion import SegmentMotion
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array

_CORNER = 1e-6
"""Distance at which a stated vertex is a corner of the body [m]."""


def support_height(plan: PlanView) -> float:
    """Return the height of the support's top [m]."""
    return plan.bodies[plan.support].top


def heights(poses: Array, points: Array) -> Array:
    """Return the heights of body points: (n, 4, 4), (k, 3) → (n, k) [m]."""
    return np.einsum("nj,kj->nk", poses[:, 2, :3], points) + poses[:, 2, 3, None]


def contact_state_checks(
    plan: PlanView, motions: list[SegmentMotion], task: LiftTask, settings: CertifySettings
) -> list[Check]:
    """Check the elements in contact of every segment, and the goal."""
    finding = Finding("contact_states", "m")
    top, plate = support_height(plan), plan.bodies["plate"].shape.vertices
    for motion in motions:
        segment, poses = motion.segment, motion.body_poses["plate"]
        tolerance = settings.element_height
        finding.note_all(
            tolerance + heights(poses, plate) - top,
            lambda i, k, s=segment: f"{s.place(i)}: vertex {k} of plate is below its support",
        )
        state = segment.contact_state
        if state is None:
            if "plate" in segment.body_poses and np.ptp(poses, axis=0).max() > settings.join:
                finding.require(False, segment.place(), "plate moves without a contact state")
            continue
        if state.element == "none":
            continue
        if state.other != plan.support:
            finding.require(False, segment.place(), f"plate touches {state.other}, it rests on {plan.support}")
        to_corner = np.linalg.norm(state.vertices[:, None] - plate[None], axis=2).min(axis=1)
        finding.note_all(
            _CORNER - to_corner, lambda k, s=segment: f"{s.place()}: contact vertex {k} is no corner of plate"
        )
        finding.note_all(
            tolerance - np.abs(heights(poses, state.vertices) - top),
            lambda i, k, s=segment: f"{s.place(i)}: contact vertex {k} of plate is off its support",
        )
    return [finding.check(), *_goal(plan, motions, task, settings)]


def _goal(plan: PlanView, motions: list[SegmentMotion], task: LiftTask, settings: CertifySettings) -> list[Check]:
    height, hold = Finding("goal_height", "m"), Finding("goal_hold", "1")
    motion = motions[-1]
    segment, last = motion.segment, len(motion.segment.time) - 1
    lowest = float(heights(motion.body_poses["plate"][-1:], plan.bodies["plate"].shape.vertices).min())
    height.note(lowest - support_height(plan) - task.goal_height + settings.goal_slack, segment.place(last))
    where = segment.place(last)
    gripped = segment.grip is not None and segment.grip.body == "plate" and segment.kind != "release"
    pushed = segment.push is not None and segment.push.body == "plate" and segment.kind != "retreat"
    kinds = {c.kind for c in segment.contacts if c.sample == last and c.body == "plate"}
    hold.require(gripped, where, "plate is not gripped")
    hold.require(pushed, where, "plate is not pushed")
    hold.require(bool(kinds), where, "no contact set of plate")
    hold.require("environment" not in kinds, where, "plate still touches its surroundings")
    return [height.check(), hold.check()]
