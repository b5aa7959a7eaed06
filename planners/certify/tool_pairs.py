"""What may touch in a suction-tool plan."""

from __future__ import annotations

from collections.abc import Mapping

from planners.certify.pairs import TouchRule, holds_around
from planners.certify.plan_view import PlanView
from planners.certify.solids import Solid
from planners.certify.tool_course import CourseStep, ToolCourse
from planners.certify.tool_task import TOOL


class ToolTouchRule(TouchRule):
    """Pads and fingers may touch the tool that they hold, the cup its object, bodies at rest what carries them.

    In the motion before the vacuum goes on, and after it went off, the cup comes to the object or leaves it. A body
    that is taken off what carries it, or put down, touches it in the motion after or before.
    """

    def __init__(self, plan: PlanView, course: ToolCourse, index: int) -> None:
        steps, step = course.steps, course.steps[index]
        around = holds_around(plan, step.segment)
        self._held = {(grip.arm, grip.body) for segment in around for grip in segment.grips}
        self._on_cup = set(step.on_cup)
        supports = [step.before.supports, step.after.supports]
        if index + 1 < len(steps) and step.segment.kind == "transfer":
            following = steps[index + 1]
            self._on_cup |= following.on_cup if following.segment.kind == "attach" else set()
            if following.segment.kind in ("detach", "release"):
                supports.append(following.after.supports)
        if index > 0 and step.segment.kind == "transfer":
            self._on_cup |= steps[index - 1].on_cup if steps[index - 1].segment.kind == "detach" else set()
            supports += self._left(steps[index - 1])
        self._rests = {
            frozenset((name, other)) for known in supports for name, below in known.items() for other in below
        }

    @staticmethod
    def _left(before: CourseStep) -> list[Mapping[str, frozenset[str]]]:
        """Return what carried bodies until the segment before this one took them off."""
        return [before.before.supports] if before.segment.kind in ("attach", "grip") else []

    def _hand(self, part: Solid, body: Solid) -> bool:
        return part.group in ("pad", "finger") and (part.frame.owner, body.frame.owner) in self._held

    def _bodies(self, a: Solid, b: Solid) -> bool:
        names = {a.frame.owner, b.frame.owner}
        if TOOL in names and names & self._on_cup:
            return True
        return frozenset(names) in self._rests
