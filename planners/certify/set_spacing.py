"""Contact sets stand where a segment begins and ends, and close enough together along the way of the body."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from planners.certify.balances import ContactSet
from planners.certify.finding import Finding
from planners.certify.motion import SegmentMotion, turns_between
from planners.certify.plan_view import BodyView, PlanView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.verdicts import Check

_ROUNDING = 1e-6
"""Relative excess of the spacing that floating point may cause."""
_STILL = 1e-9
"""Motion of a sample that counts as none [m]."""


def spacing_check(
    plan: PlanView,
    motions: Sequence[SegmentMotion],
    sets: Sequence[Sequence[ContactSet]],
    needs_sets: Callable[[SegmentMotion, BodyView], bool],
    settings: CertifySettings,
) -> Check:
    """Check the spacing of contact sets.

    What a body turns and goes from one set to the next is added up over the samples in between: a way there and back
    is as long as both ways.

    Args:
        plan: the document.
        motions: of each segment.
        sets: of each segment.
        needs_sets: whether a body's contacts must be shown in a segment.
        settings: tolerances.
    """
    finding = Finding("contact_sets", "1")
    for motion, group in zip(motions, sets, strict=True):
        for body in plan.bodies.values():
            if body.mass is None or body.static or not needs_sets(motion, body):
                continue
            samples = sorted({one.sample for one in group if one.body == body.name})
            _ends(motion, body, samples, finding)
            _between(motion, body, samples, finding, settings)
    return finding.check()


def _ends(motion: SegmentMotion, body: BodyView, samples: list[int], finding: Finding) -> None:
    segment = motion.segment
    for end, name in ((0, "first"), (motion.samples - 1, "last")):
        finding.require(end in samples, segment.place(end), f"no contact set of {body.name} at the {name} sample")


def _between(
    motion: SegmentMotion, body: BodyView, samples: list[int], finding: Finding, settings: CertifySettings
) -> None:
    segment, poses = motion.segment, motion.body_poses[body.name]
    way = _added_up(np.linalg.norm(np.diff(body.centres(poses), axis=0), axis=1))
    turn = _added_up(turns_between(poses))
    still = np.abs(np.diff(poses, axis=0)).max(axis=(1, 2), initial=0.0) <= _STILL
    for before, after in pairwise(samples):
        rest = _longest_rest(segment.time[before : after + 1], still[before:after])
        used = max(
            (turn[after] - turn[before]) / settings.set_angle,
            (way[after] - way[before]) / settings.set_distance,
            rest / settings.set_time,
        )
        finding.note(1.0 + _ROUNDING - used, f"{segment.place(before)} to sample {after}: {body.name}")


def _added_up(steps: Array) -> Array:
    """Return how far it is to each sample: (n - 1,) → (n,)."""
    return np.concatenate([[0.0], np.cumsum(steps)])


def _longest_rest(time: Array, still: Array) -> float:
    """Return the longest time without motion among consecutive samples [s]."""
    longest = start = 0.0
    resting = False
    for index, at_rest in enumerate(still):
        if at_rest and not resting:
            start = float(time[index])
        resting = bool(at_rest)
        if resting:
            longest = max(longest, float(time[index + 1]) - start)
    return longest
