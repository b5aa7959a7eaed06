"""What came out: the explanation, the certificate, and what it cost."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

from pydantic import Field, JsonValue

from planners.contract.arrays import Finite
from planners.contract.strict_model import StrictModel
from planners.plan.considered import Considered


class PlanningOutcome(StrEnum):
    """How planning ended. The value is its name in the plan document."""

    SOLVED = "solved"
    INFEASIBLE = "infeasible"
    """Proven: no plan exists."""
    NOT_FOUND = "not_found"
    """No plan among the poses, holds, suction poses and motions that were tried."""


class Software(StrictModel):
    """What made the plan."""

    name: str
    version: str
    commit: str | None


class Cause(StrictModel):
    """One reason why there is no plan, in numbers: what is needed is more than what is available.

    Any of the numbers may be missing, and the first documents have some of which nothing is short.
    """

    reason: str
    needed: Finite | None
    available: Finite | None
    unit: str | None
    where: JsonValue = None


class Explanation(StrictModel):
    """What came out, for a person."""

    summary: str
    causes: list[Cause] = Field(default_factory=list)


class Check(StrictModel):
    """One thing that was checked again on the finished document."""

    name: str
    passed: bool
    margin: Finite | None
    """What is left to the limit at the worst place, in `unit`; negative when it fails, null with nothing to check."""
    unit: str | None
    where: JsonValue = None
    """The worst place: segment, time or sample, and the joint, bodies or contact."""


class Certificate(StrictModel):
    """An independent second opinion."""

    passed: bool
    checks: list[Check]

    @property
    def failures(self) -> list[Check]:
        """The checks that failed."""
        return [check for check in self.checks if not check.passed]


class StageTime(StrictModel):
    """How long one stage took."""

    name: str
    seconds: Finite


class LeastReserve(StrictModel):
    """Where along a plan least of the limits is left."""

    value: Finite
    """The least of the segments' `reserve` [1]."""
    limited_by: str
    """What would give way first, in words."""
    body: str
    """What would be lost."""
    segment: int
    sample: int


class Statistics(StrictModel):
    """What the work cost and what fell by the way."""

    total_seconds: Finite | None
    stages: list[StageTime]
    graph: dict[str, JsonValue]
    search: dict[str, JsonValue]
    rejections: dict[str, int]
    reserve: LeastReserve | None = None
    """None: nothing is held, or a document of before there was any."""
    considered: Considered | None = None
    """What a suction-tool planner looked at."""

    @property
    def times(self) -> list[tuple[str, float]]:
        """Name and seconds of each stage, in order."""
        return [(stage.name, stage.seconds) for stage in self.stages]

    def taking(self, times: Sequence[tuple[str, float]], total: float) -> Statistics:
        """Return the same with other times, and seconds in all."""
        stages = [StageTime(name=name, seconds=seconds) for name, seconds in times]
        return self.model_copy(update={"stages": stages, "total_seconds": total})
