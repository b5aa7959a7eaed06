"""What hangs on the cup, and what the hand that holds the tool carries, at every sample, shown or not.

One hand's forces on the tool are what tool and object need together: their weight and their inertia.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from planners.certify.common.cones import StatedCup, pad_margins, pad_x_axes
from planners.certify.common.contact_sets import InertialLoad
from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.motion.segment_motion import SegmentMotion
from planners.certify.plan_view import NumberedSegment, PlanView
from planners.certify.tool.task import TOOL
from planners.certify.tool.tool_states import StateChange
from planners.geometry.pose import Array
from planners.plan.verdicts import Check

_SWITCHING = ("attach", "detach")
"""Kinds in which what is on the cup is still borne by what it stands on: what the cup bears is not determined."""


def carried_forces(evidence: Evidence, steps: Sequence[StateChange]) -> Iterator[tuple[NumberedSegment, str, Array]]:
    """Yield what each hand carries alone: segment, arm and (n,) net forces [N].

    Two hands are asked for no more than their contacts show.
    """
    for motion, step in zip(evidence.motions, steps, strict=True):
        if len(step.bearers) != 1:
            continue
        (arm,) = step.bearers
        carried = (TOOL, *(() if motion.segment.kind in _SWITCHING else step.on_cup))
        force = sum((_needed_force(evidence.plan, motion, name) for name in carried), np.zeros(3))
        yield motion.segment, arm, np.linalg.norm(force, axis=1)


def carrying_check(
    evidence: Evidence, carried: Sequence[tuple[NumberedSegment, str, Array]], limits: Mapping[str, float]
) -> Check:
    """Check what each hand carries, as of `carried_forces`, against the net force that it may exert, by arm [N]."""
    finding = Finding("carried_force", "N")
    for segment, arm, nets in carried:
        margins = limits[arm] + evidence.settings.cone_slack - nets
        finding.note_all(margins, lambda i, s=segment, by=arm: f"{s.place(i)} by {by}")
    return finding.check()


def _needed_force(plan: PlanView, motion: SegmentMotion, name: str) -> Array:
    """Return what must be exerted on a body, world axes: (n, 3) [N]."""
    body = plan.bodies[name]
    if body.mass is None:
        return np.zeros((motion.samples, 3))
    return -(body.mass * plan.cell.gravity + InertialLoad.of(body, body.mass, motion).forces)


def cup_hold_checks(evidence: Evidence, steps: Sequence[StateChange], known: StatedCup | None) -> list[Check]:
    """Check the cup's limits (5f)-(5h) wherever an object is on it.

    An object in the air hangs on the cup alone: its weight and inertia say what the cup exerts.

    Args:
        evidence: of the document.
        steps: the states before and after each segment.
        known: the cup; None: believed as the first contact with an object states it.
    """
    force, moment = Finding("cup_hold", "N"), Finding("cup_hold_moment", "Nm")
    for motion, step in zip(evidence.motions, steps, strict=True):
        for name in () if step.segment.kind in _SWITCHING else sorted(step.on_cup):
            cup = known or _believed(step.segment, name)
            if cup is None:
                force.require(False, step.segment.place(), f"nothing is known of the cup that bears {name}")
            else:
                _hanging(evidence, motion, name, cup, force, moment)
    return [force.check(), moment.check()]


def _hanging(
    evidence: Evidence, motion: SegmentMotion, name: str, cup: StatedCup, on_force: Finding, on_moment: Finding
) -> None:
    body, tool, slack = evidence.plan.bodies[name], motion.body_poses[TOOL], evidence.settings.cone_slack
    if body.mass is None:
        return
    load = InertialLoad.of(body, body.mass, motion)
    force = -(body.mass * evidence.plan.cell.gravity + load.forces)
    torque = np.cross(load.centres - tool[:, :3, 3], force) - load.moments
    outward = tool[:, :3, 2]
    x = pad_x_axes(motion.body_poses[name], -outward)
    axes = np.stack([x, np.cross(outward, x)], axis=1)
    pull, twist = _along(outward, force), _along(outward, torque)
    shear, bend = np.einsum("nkj,nj->nk", axes, force), np.einsum("nkj,nj->nk", axes, torque)
    slips, twists, peels = pad_margins(cup.mu * (cup.max_force - pull), shear, twist, bend, cup.radius, cup.kappa)
    on_force.note_samples(motion.segment, cup.max_force - pull + slack, f"{name} is pulled off")
    on_force.note_samples(motion.segment, pull + slack, f"{name} presses")
    on_force.note_samples(motion.segment, slips + slack, f"{name} slips")
    on_moment.note_samples(motion.segment, twists + slack, f"{name} twists")
    on_moment.note_samples(motion.segment, peels + slack, f"{name} peels off")


def _believed(segment: NumberedSegment, name: str) -> StatedCup | None:
    """Return the cup as the first contact with the object states it."""
    for contact in segment.contacts:
        if contact.kind == "suction" and contact.body == name:
            return StatedCup(contact.radius, contact.limit, contact.mu, contact.kappa)
    return None


def _along(axes: Array, vectors: Array) -> Array:
    return np.einsum("nj,nj->n", axes, vectors)
