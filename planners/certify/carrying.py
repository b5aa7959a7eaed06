"""What the hand that holds the tool carries, at every sample and not only where contacts are shown.

One hand's forces on the tool are what tool and object need together: their weight and their inertia.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from planners.certify.finding import Finding
from planners.certify.inertia import InertialLoad
from planners.certify.motion import SegmentMotion
from planners.certify.payload import PayloadCheck
from planners.certify.plan_view import PlanView
from planners.certify.settings import CertifySettings
from planners.certify.tool_course import CourseStep
from planners.certify.tool_task import TOOL
from planners.geometry.pose import Array
from planners.plan.verdicts import Check

_RESTING = ("attach", "detach")
"""Kinds in which what is on the cup is still borne by what it stands on."""


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
