"""What hangs on the cup, and what the hand that holds the tool carries, at every sample, shown or not.

One hand's forces on the tool are what tool and object need together: their weight and their inertia.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from planners.certify.common.cones import StatedCup, pad_margins, pad_x_axes
from planners.certify.common.contact_sets import InertialLoad
from planners.certify.common.reserve import PayloadCheck
from planners.certify.finding import Finding
from planners.certify.motion.segment_motion import SegmentMotion
from planners.certify.plan_view import PlanView, SegmentView
from planners.certify.settings import CertifySettings
from planners.certify.tool.course import CourseStep, ToolCourse
from planners.certify.tool.task import TOOL, ToolTask
from planners.geometry.pose import Array
from planners.plan.verdicts import Check

_RESTING = ("attach", "detach")
"""Kinds in which what is on the cup is still borne by what it stands on."""
_SWITCHING = ("attach", "detach")
"""Kinds in which the object stands on something: what the cup bears there is not determined."""


def carrying_check(
    plan: PlanView,
    motions: Sequence[SegmentMotion],
    steps: Sequence[CourseStep],
    limits: Mapping[str, float],
    payload: PayloadCheck,
    settings: CertifySettings,
) -> Check:
    """Check what each hand carries alone against what it may. Two hands are asked for no more than their contacts show.

    Args:
        plan: the document.
        motions: of each segment.
        steps: the course of each segment.
        limits: by arm, the net force that its hand may exert [N].
        payload: is told what the hands carry.
        settings: tolerances.
    """
    finding = Finding("carried_force", "N")
    for motion, step in zip(motions, steps, strict=True):
        if len(step.bearers) != 1:
            continue
        (arm,) = step.bearers
        carried = (TOOL, *(() if motion.segment.kind in _RESTING else step.on_cup))
        force = sum((_needed_force(plan, motion, name) for name in carried), np.zeros(3))
        nets = np.linalg.norm(force, axis=1)

        def where(i: int, m: SegmentMotion = motion, by: str = arm) -> str:
            return f"{m.segment.place(i)} by {by}"

        finding.note_all(limits[arm] + settings.cone_slack - nets, where)
        payload.note(arm, nets, where)
    return finding.check()


def _needed_force(plan: PlanView, motion: SegmentMotion, name: str) -> Array:
    """Return what must be exerted on a body, world axes: (n, 3) [N]."""
    body = plan.bodies[name]
    if body.mass is None:
        return np.zeros((motion.samples, 3))
    return -(body.mass * plan.gravity + InertialLoad.of(body, body.mass, motion).forces)


class CupHold:
    """An object in the air hangs on the cup alone: its weight and inertia say what the cup exerts."""

    def __init__(self, plan: PlanView, task: ToolTask, settings: CertifySettings) -> None:
        self._plan, self._cup, self._slack = plan, task.limits(plan).cup, settings.cone_slack
        self._force, self._moment = Finding("cup_hold", "N"), Finding("cup_hold_moment", "Nm")

    def run(self, motions: Sequence[SegmentMotion], course: ToolCourse) -> list[Check]:
        """Check the cup's limits (5f)-(5h) wherever an object is on it."""
        for motion, step in zip(motions, course.steps, strict=True):
            for name, cup in self._hanging(step):
                self._segment(motion, name, cup)
        return [self._force.check(), self._moment.check()]

    def _hanging(self, step: CourseStep) -> Iterator[tuple[str, StatedCup]]:
        if step.segment.kind in _SWITCHING:
            return
        for name in sorted(step.on_cup):
            cup = self._cup or _believed(step.segment, name)
            if cup is None:
                self._force.require(False, step.segment.place(), f"nothing is known of the cup that bears {name}")
            else:
                yield name, cup

    def _segment(self, motion: SegmentMotion, name: str, cup: StatedCup) -> None:
        body, tool = self._plan.bodies[name], motion.body_poses[TOOL]
        if body.mass is None:
            return
        load = InertialLoad.of(body, body.mass, motion)
        force = -(body.mass * self._plan.gravity + load.forces)
        torque = np.cross(load.centres - tool[:, :3, 3], force) - load.moments
        outward = tool[:, :3, 2]
        x = pad_x_axes(motion.body_poses[name], -outward)
        axes = np.stack([x, np.cross(outward, x)], axis=1)
        pull, twist = _along(outward, force), _along(outward, torque)
        shear, bend = np.einsum("nkj,nj->nk", axes, force), np.einsum("nkj,nj->nk", axes, torque)
        slips, twists, peels = pad_margins(cup.mu * (cup.max_force - pull), shear, twist, bend, cup.radius, cup.kappa)

        def said(text: str) -> Callable[[int], str]:
            return lambda sample: f"{motion.segment.place(sample)}: {name} {text}"

        self._force.note_all(cup.max_force - pull + self._slack, said("is pulled off"))
        self._force.note_all(pull + self._slack, said("presses"))
        self._force.note_all(slips + self._slack, said("slips"))
        self._moment.note_all(twists + self._slack, said("twists"))
        self._moment.note_all(peels + self._slack, said("peels off"))


def _believed(segment: SegmentView, name: str) -> StatedCup | None:
    """Return the cup as the first contact with the object states it."""
    for contact in segment.contacts:
        if contact.kind == "suction" and contact.body == name:
            return StatedCup(contact.radius, contact.limit, contact.mu, contact.kappa)
    return None


def _along(axes: Array, vectors: Array) -> Array:
    return np.einsum("nj,nj->n", axes, vectors)
