"""What may touch during a plate lift."""

from __future__ import annotations

from planners.certify.pairs import TouchRule, holds_around
from planners.certify.plan_view import PlanView, SegmentView
from planners.certify.solids import Solid


class LiftTouchRule(TouchRule):
    """Pads and fingers may touch a held body, the tip a pushed one, the plate its support, the cup the plate."""

    def __init__(self, plan: PlanView, segment: SegmentView) -> None:
        self._support = plan.support
        around = holds_around(plan, segment)
        self._held = {(grip.arm, grip.body) for s in around for grip in s.grips}
        self._pushed = {(s.push.arm, s.push.body) for s in around if s.push is not None}

    def _hand(self, part: Solid, body: Solid) -> bool:
        key = (part.frame.owner, body.frame.owner)
        if part.group in ("pad", "finger"):
            return key in self._held
        return part.group == "tip" and key in self._pushed

    def _bodies(self, a: Solid, b: Solid) -> bool:
        return self._rests(a, b) or self._rests(b, a) or {a.group, b.group} == {"cup", "plate"}

    def _rests(self, a: Solid, b: Solid) -> bool:
        return a.group == "plate" and b.frame.owner == self._support
