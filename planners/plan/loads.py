"""What hands bear along a plan."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np

from planners.geometry.pose import Array
from planners.plan.plan import Plan
from planners.plan.segment import Segment


def largest_load(plan: Plan) -> tuple[float, str]:
    """Return the most that a hand bears [N], and which arm's it is; without any, 0 N and no arm.

    Of a gripper it is the net force of both fingers, which its squeeze cancels in; of a stick its normal force.
    """
    return max(chain.from_iterable(loads_of(segment, plan) for segment in plan.segments), default=(0.0, ""))


def loads_of(segment: Segment, plan: Plan) -> Iterator[tuple[float, str]]:
    """Yield what hands bear in a segment of a plan [N], each time with the arm, as `largest_load` counts it."""
    nets: dict[tuple[str, str, int], Array] = {}
    for contact in segment.contacts:
        arm, force = contact.by, contact.wrench[:3]
        if arm is None or arm not in plan.cell.arms:
            continue
        if contact.kind == "point":
            yield float(force @ contact.normal), arm
        else:
            key = arm, contact.body, contact.sample
            nets[key] = nets.get(key, 0.0) + force
    for (arm, _, _), net in nets.items():
        yield float(np.linalg.norm(net)), arm
