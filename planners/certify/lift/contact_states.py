"""The plate touches its support with the element that each segment states, and is lifted at the end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.motion.segment_motion import SegmentMotion
from planners.certify.plan_view import BodyView, PlanView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array, Transform
from planners.plan.segment import ContactState
from planners.plan.verdicts import Check

_LOWEST = 1e-9
"""Height above a body's lowest vertex at which a vertex is as low as that [m]."""
_CORNER = 1e-6
"""Distance at which a stated vertex is a corner of the body [m]."""


def support_height(plan: PlanView) -> float:
    """Return the height of the support's top [m]."""
    return plan.bodies[plan.support].top


def heights(poses: Array, points: Array) -> Array:
    """Return the heights of body points: (n, 4, 4), (k, 3) → (n, k) [m]."""
    return np.einsum("nj,kj->nk", poses[:, 2, :3], points) + poses[:, 2, 3, None]


def contact_state_checks(evidence: Evidence, goal_height: float) -> list[Check]:
    """Check the elements in contact of every segment, that nothing else touches and nothing slides, and the goal.

    Args:
        evidence: of the document.
        goal_height: of the lowest vertex above the support at the end [m].
    """
    stated, unstated = Finding("contact_states", "m"), Finding("unstated_contacts", "m")
    slip = Finding("contact_slip", "m")
    for motion in evidence.motions:
        _heights(evidence, motion, stated)
        if motion.segment.contact_state is not None:
            _unstated(evidence, motion, motion.segment.contact_state, unstated)
            _slip(evidence, motion, motion.segment.contact_state, slip)
    return [stated.check(), unstated.check(), slip.check(), *_goal(evidence, goal_height)]


def _heights(evidence: Evidence, motion: SegmentMotion, finding: Finding) -> None:
    """The stated vertices are at the support's height, no vertex is below."""
    plan, segment, poses = evidence.plan, motion.segment, motion.body_poses["plate"]
    plate, top, tolerance = plan.plate.shape.vertices, support_height(plan), evidence.settings.element_height
    finding.note_all(
        tolerance + heights(poses, plate) - top,
        lambda i, k: f"{segment.place(i)}: vertex {k} of plate is below its support",
    )
    state = segment.contact_state
    if state is None:
        if "plate" in segment.transforms and np.ptp(poses, axis=0).max() > evidence.settings.join:
            finding.require(False, segment.place(), "plate moves without a contact state")
        return
    if state.element == "none":
        return
    if state.with_ != plan.support:
        finding.require(False, segment.place(), f"plate touches {state.with_}, it rests on {plan.support}")
    to_corner = np.linalg.norm(state.vertices[:, None] - plate[None], axis=2).min(axis=1)
    finding.note_all(_CORNER - to_corner, lambda k: f"{segment.place()}: contact vertex {k} is no corner of plate")
    finding.note_all(
        tolerance - np.abs(heights(poses, state.vertices) - top),
        lambda i, k: f"{segment.place(i)}: contact vertex {k} of plate is off its support",
    )


def _unstated(evidence: Evidence, motion: SegmentMotion, state: ContactState, finding: Finding) -> None:
    """No other vertex touches the support, but near the ends of a motion, where the contact may still be the last one.

    Near an end no vertex of the plate is farther from its place there than `end_distance`, or `end_fraction` of the
    longest way that one is taken from there, whichever is more. A plate that rests has no such ends.
    """
    plan, settings, segment, poses = evidence.plan, evidence.settings, motion.segment, motion.body_poses["plate"]
    plate = plan.plate.shape.vertices
    to_stated = np.linalg.norm(plate[:, None] - state.vertices[None], axis=2).min(axis=1, initial=np.inf)
    others = np.flatnonzero(to_stated > _CORNER)
    if np.ptp(poses, axis=0).max() <= settings.join:
        poses, between = poses[:1], np.ones(1, dtype=bool)
    else:
        between = _far_from(poses, poses[0], plate, settings) & _far_from(poses, poses[-1], plate, settings)
    samples = np.flatnonzero(between)
    finding.note_all(
        heights(poses[samples], plate[others]) - support_height(plan) - settings.vertex_touch,
        lambda i, k: f"{segment.place(int(samples[i]))}: vertex {others[k]} of plate touches, which is not stated",
    )


def _far_from(poses: Array, end: Transform, vertices: Array, settings: CertifySettings) -> NDArray[np.bool_]:
    """Return at which samples the plate is no longer, or not yet, near one end of a segment."""
    moved = np.einsum("nij,kj->nki", poses[:, :3, :3] - end[:3, :3], vertices) + (poses[:, :3, 3] - end[:3, 3])[:, None]
    ways = np.linalg.norm(moved, axis=2).max(axis=1)
    return ways > max(settings.end_distance, settings.end_fraction * float(ways.max()))


def _slip(evidence: Evidence, motion: SegmentMotion, state: ContactState, finding: Finding) -> None:
    """The vertices in contact stay where they are: nothing balances a plate that slides."""
    settings, segment, poses = evidence.settings, motion.segment, motion.body_poses["plate"]
    if np.ptp(poses, axis=0).max() <= settings.join:
        poses = poses[:1]
    places = np.einsum("nij,kj->nki", poses[:, :2, :3], state.vertices) + poses[:, None, :2, 3]
    finding.note_all(
        settings.contact_slip - np.linalg.norm(places - places[0], axis=2),
        lambda i, k: f"{segment.place(i)}: contact vertex {k} of plate slides",
    )


def _goal(evidence: Evidence, goal_height: float) -> list[Check]:
    height, hold, plan = Finding("goal_height", "m"), Finding("goal_hold", "1"), evidence.plan
    motion = evidence.motions[-1]
    segment, last = motion.segment, motion.samples - 1
    lowest = float(heights(motion.body_poses["plate"][-1:], plan.plate.shape.vertices).min())
    height.note(lowest - support_height(plan) - goal_height + evidence.settings.goal_slack, segment.place(last))
    where = segment.place(last)
    gripped = segment.grip is not None and segment.grip.body == "plate" and segment.kind != "release"
    pushed = segment.push is not None and segment.push.body == "plate" and segment.kind != "retreat"
    kinds = {c.kind for c in segment.contacts if c.sample == last and c.body == "plate"}
    hold.require(gripped, where, "plate is not gripped")
    hold.require(pushed, where, "plate is not pushed")
    hold.require(bool(kinds), where, "no contact set of plate")
    hold.require("environment" not in kinds, where, "plate still touches its surroundings")
    return [height.check(), hold.check()]


def needs_sets(evidence: Evidence, motion: SegmentMotion, body: BodyView) -> bool:
    """Whether the body is in a hand for all of the segment, or off its rest."""
    segment = motion.segment
    grip, push = segment.grip, segment.push
    gripped = grip is not None and grip.body == body.name and segment.kind not in ("grip", "release")
    pushed = push is not None and push.body == body.name
    if push is not None and segment.kind in ("approach", "retreat"):
        pushed = pushed and push.arm not in segment.movers
    return gripped or pushed or not _rests_flat(evidence, motion, body)


def _rests_flat(evidence: Evidence, motion: SegmentMotion, body: BodyView) -> bool:
    low = body.shape.vertices[:, 2] <= body.shape.vertices[:, 2].min() + _LOWEST
    above = heights(motion.body_poses[body.name], body.shape.vertices[low]) - support_height(evidence.plan)
    return bool(np.abs(above).max() <= evidence.settings.element_height)
