"""What hands, cup and support exert on the plate by a lift's plan, and what hands and lifter are told to exert."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array
from planners.plan.contacts import Contact
from planners.plan.segment import Segment, SegmentKind

LEAD = 0.3
"""So long hands and lifter take to change what they bear where the plan has it change at once [s]."""


def planned_wrenches(segments: Sequence[Segment], name: str) -> Array:
    """Return what one bearer exerts on the plate at all samples of a plan, linear in time between its contact sets.

    Args:
        segments: of the plan of a lift.
        name: "left", "right", "cup", or "support" for whatever the plate rests on.

    Returns:
        (n, 6) about the middle of the contacts, world axes [N, Nm]; NaN where it touches nothing, but 0 of the cup.
    """
    return np.concatenate([_of_segment(segment, name) for segment in segments])


def told_wrenches(segments: Sequence[Segment], planned: Array) -> Array:
    """Return what a bearer is told to exert: what it changes from one segment to the next begins to change before.

    Both wrenches balance the plate as it is at the border, so all that lies between them does: friction cones are
    convex. Where a hand comes to the plate, which bears nothing of it before, the change begins at the border.

    Args:
        segments: of the plan of a lift.
        planned: (n, 6) see `planned_wrenches`.
    """
    time = np.concatenate([segment.time for segment in segments])
    borders: NDArray[np.int64] = np.cumsum([len(segment.time) for segment in segments])[:-1]
    result = planned.copy()
    for segment, border in zip(segments, borders, strict=False):
        # Who touches nothing bears nothing: a hand that leaves has given all of it over by then.
        jump = np.nan_to_num(planned[border]) - np.nan_to_num(planned[border - 1])
        if segment.kind in (SegmentKind.GRIP, SegmentKind.APPROACH):
            left = np.clip(1.0 - (time[border:] - time[border]) / LEAD, 0.0, 1.0)
            result[border:] -= left[:, None] * jump
            continue
        part = np.clip((time[:border] - (time[border] - LEAD)) / LEAD, 0.0, 1.0)
        result[:border] += part[:, None] * jump
    return result


def _of_segment(segment: Segment, name: str) -> Array:
    absent = np.full(6, 0.0 if name == "cup" else np.nan)
    sets: defaultdict[int, list[Contact]] = defaultdict(list)
    for contact in segment.contacts:
        if contact.kind != "inertia" and (contact.by == name or (name, contact.kind) == ("support", "environment")):
            sets[contact.sample].append(contact)
    if not sets:
        return np.repeat(absent[None], len(segment.time), axis=0)
    samples = sorted({contact.sample for contact in segment.contacts})
    totals = np.array([_total(sets[sample]) if sample in sets else absent for sample in samples])
    if _leaves_a_stronger_contact(segment):
        # The first set still counts on the contact that the motion gives up at once.
        totals[0] = totals[1]
    return np.column_stack([np.interp(segment.time, segment.time[samples], totals[:, k]) for k in range(6)])


def _leaves_a_stronger_contact(segment: Segment) -> bool:
    counts: dict[int, int] = {}
    for contact in segment.contacts:
        counts[contact.sample] = counts.get(contact.sample, 0) + (contact.kind == "environment")
    samples = sorted(counts)
    return segment.kind is SegmentKind.TRANSFER and len(samples) > 1 and counts[samples[0]] > counts[samples[1]]


def _total(contacts: Sequence[Contact]) -> Array:
    """Return the (6,) sum of wrenches about the middle of their points."""
    points = np.array([contact.point for contact in contacts])
    wrenches = np.array([contact.wrench for contact in contacts])
    total = wrenches.sum(axis=0)
    total[3:] += np.cross(points - points.mean(axis=0), wrenches[:, :3]).sum(axis=0)
    return total
