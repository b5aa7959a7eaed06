"""Which solids can hit one another, and which may touch."""

from __future__ import annotations

from collections.abc import Sequence

from planners.certify.document_view import PlanView, SegmentView
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


class TouchRule:
    """Which pairs may touch during one segment.

    Pads and fingers a held body, the tip a pushed one, resting bodies their support, the cup its plate.
    """

    def __init__(self, plan: PlanView, segment: SegmentView) -> None:
        self._plan = plan
        around = [segment]
        # While a hand is taking hold or letting go, the hold stands in the segment after or before.
        if segment.kind in ("grip", "approach") and segment.index + 1 < len(plan.segments):
            around.append(plan.segments[segment.index + 1])
        if segment.kind in ("release", "retreat") and segment.index > 0:
            around.append(plan.segments[segment.index - 1])
        self._held = {(s.grip.arm, s.grip.body) for s in around if s.grip is not None}
        self._pushed = {(s.push.arm, s.push.body) for s in around if s.push is not None}

    def allows(self, a: Solid, b: Solid) -> bool:
        """Whether the two may touch."""
        if a.arm is not None and b.arm is not None:
            return False
        if a.arm is None and b.arm is None:
            return self._rests(a, b) or self._rests(b, a) or {a.group, b.group} == {"cup", "plate"}
        robot, body = (a, b) if a.arm is not None else (b, a)
        key = (robot.frame.owner, body.frame.owner)
        if robot.group in ("pad", "finger"):
            return key in self._held
        return robot.group == "tip" and key in self._pushed

    def _rests(self, a: Solid, b: Solid) -> bool:
        if a.group == "plate":
            return b.frame.owner == self._plan.support
        return a.group in ("object", "tool") and b.group in ("table", "support")
