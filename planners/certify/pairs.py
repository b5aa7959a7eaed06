"""Which solids can hit one another, and which may touch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from planners.certify.plan_view import PlanView, SegmentView
from planners.certify.solids import Solid


def can_meet(a: Solid, b: Solid, static: frozenset[str]) -> bool:
    """Whether a pair of solids has to be looked at.

    Left out: solids of one arm at most one joint apart, hands counting as their flange (they can only turn about a
    common axis, and their hulls overlap there by design); the base links and the frame they are bolted to; two static
    bodies; parts of one body; and the cable with anything but arms.
    """
    if a.arm is not None and b.arm is not None:
        return a.arm != b.arm or abs(a.frame.link - b.frame.link) > 1
    if a.arm is None and b.arm is None:
        if a.frame.owner == b.frame.owner or "cable" in (a.group, b.group):
            return False
        return not (a.frame.owner in static and b.frame.owner in static)
    robot, body = (a, b) if a.arm is not None else (b, a)
    return not (robot.frame.link == 0 and body.group == "frame")


def pairs_of(solids: Sequence[Solid], static: frozenset[str]) -> list[tuple[int, int]]:
    """Return the index pairs (i < j) of the solids that can meet."""
    return [
        (i, j) for i in range(len(solids)) for j in range(i + 1, len(solids)) if can_meet(solids[i], solids[j], static)
    ]


class TouchRule(ABC):
    """Which pairs may touch during one segment."""

    def allows(self, a: Solid, b: Solid) -> bool:
        """Whether the two may touch; no two parts of the robot may."""
        if a.arm is not None and b.arm is not None:
            return False
        if a.arm is None and b.arm is None:
            return self._bodies(a, b)
        return self._hand(a, b) if a.arm is not None else self._hand(b, a)

    @abstractmethod
    def _hand(self, part: Solid, body: Solid) -> bool:
        """Whether a part of the robot may touch a body."""

    @abstractmethod
    def _bodies(self, a: Solid, b: Solid) -> bool:
        """Whether two bodies may touch."""


def holds_around(plan: PlanView, segment: SegmentView) -> list[SegmentView]:
    """Return the segments whose holds count: also the next while a hand comes, and the last while it leaves."""
    around = [segment]
    if segment.kind in ("grip", "approach") and segment.index + 1 < len(plan.segments):
        around.append(plan.segments[segment.index + 1])
    if segment.kind in ("release", "retreat") and segment.index > 0:
        around.append(plan.segments[segment.index - 1])
    return around
