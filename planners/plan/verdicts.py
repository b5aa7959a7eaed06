"""What came out: the explanation, the certificate, and what it cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from pydantic import Field, JsonValue

from planners.contract.arrays import Finite
from planners.contract.strict_model import StrictModel
from planners.contract.task_change import PatchOperation
from planners.plan.considered import Considered

_MOST_DIGITS = 15
"""A float has no more that say anything."""


def is_shortage(needed: float, available: float, unit: str) -> bool:
    """Tell whether figures say what is short: in a unit that can be measured, more is needed than there is.

    What is needed is never less than nothing; of what is available only a length can be: a finger below the table.
    """
    measurable = bool(unit) and unit != "1" and math.isfinite(needed) and math.isfinite(available)
    return measurable and needed >= 0.0 and available < needed and (available >= 0.0 or unit == "m")


def shortage_words(needed: float, available: float, unit: str | None) -> str:
    """Return what was needed and what there was, or how much was missing, for a person: lengths in millimetres.

    Where nothing, or less than nothing, is said to be available, the figures are a shortfall: how far the nearest try
    was from a limit.
    """
    if unit == "m":
        needed, available, unit = 1e3 * needed, 1e3 * available, "mm"
    of = f" {unit}" if unit else ""
    if available > 0.0:
        more, less = told_apart(needed, available)
        return f"needed {more}{of}, available {less}{of}"
    return f"short by {needed - available:.4g}{of}"


def told_apart(one: float, other: float, digits: int = 4, kind: Literal["f", "g"] = "g") -> tuple[str, str]:
    """Return two figures with as many digits as it takes to see that they differ, and with so many at least.

    Args:
        one: of the figures.
        other: likewise.
        digits: how many there are at least: significant ones, or behind the point.
        kind: "g": significant digits are counted; "f": those behind the point.
    """
    told = f"{one:.{digits}{kind}}", f"{other:.{digits}{kind}}"
    return told if told[0] != told[1] or digits >= _MOST_DIGITS else told_apart(one, other, digits + 1, kind)


class PlanningOutcome(StrEnum):
    """How planning ended. The value is its name in the plan document."""

    SOLVED = "solved"
    INFEASIBLE = "infeasible"
    """Proven: no plan exists."""
    NOT_FOUND = "not_found"
    """No plan among the poses, holds, suction poses and motions that were tried."""


@dataclass(frozen=True)
class Feasibility:
    """Whether held poses of a lift lead from the support into the air; the motion of the arms is not asked for."""

    kept: float | None
    """Share of every limit that such a way keeps back: what the task asks for, else 0 [1]; None: there is no way."""
    why: str | None = None
    """Where it is proven that there is none, whatever holds are tried: the proof, in a sentence."""


class Software(StrictModel):
    """What made the plan."""

    name: str
    version: str
    commit: str | None


class Cause(StrictModel):
    """One reason why there is no plan, in numbers: what is needed is more than what is available.

    The numbers are all there or none is; but the first documents have some of which nothing is short.
    """

    reason: str
    needed: Finite | None
    available: Finite | None
    unit: str | None
    where: JsonValue = None

    @property
    def says_what_is_short(self) -> bool:
        """Whether its numbers do; without any it is in order too."""
        needed, available, unit = self.needed, self.available, self.unit
        if needed is None or available is None or unit is None:
            return needed is available is unit
        return is_shortage(needed, available, unit)


class Remedy(StrictModel):
    """A change of the task with which there is a plan. It was planned and certified before it is told.

    Of a task whose plan failed in physics it was simulated, too.
    """

    kind: str
    """What is changed: "cup_place", "cup_force", "yaw", ... ; several remedies may be of one kind."""
    sentence: str
    """What to do, for a person, as in "Move the cup 50 mm away from the robot"."""
    patch: list[PatchOperation]
    """The change, for a machine; it fits the task as posted and as the plan states it."""
    outcome: PlanningOutcome
    """What came of planning the changed task: what is not solved is not told."""
    certified: bool
    """Whether that plan passed its certificate: likewise."""
    reserve: Finite | None
    """Share of every limit that that plan keeps back [1]; None: nothing is held."""
    largest_force: Finite | None
    """The most that a hand bears in that plan [N], see `planners.plan.loads`; None: no hand bears anything."""
    simulated: bool = False
    """Whether physics carried that plan out, too. It did, where the task has a plan that failed there."""


class ChosenCupPlace(StrictModel):
    """Where the lifter's cup sits in a plan whose task left that open. The plan's task states it, too."""

    position: tuple[float, float]
    """From the plate's origin, in plate axes [m]."""
    tried: int
    """How many places were examined; none, where it is proven that there is no plan wherever the cup sits."""
    reserve: Finite | None
    """The largest share of every limit that a way of held poses keeps back there [1]; the arms may allow less. None: at
    no place there is such a way."""
    sentence: str
    """The same for a person."""


class Explanation(StrictModel):
    """What came out, for a person."""

    summary: str
    causes: list[Cause] = Field(default_factory=list)
    remedies: list[Remedy] | None = None
    """Where there is no plan, or physics does not carry it out: what to change, the smallest change of each kind first.
    None: it was not looked for."""
    cup_place: ChosenCupPlace | None = None
    """Where the cup sits, and why there. None: the task said where."""


class Check(StrictModel):
    """One thing that was checked again on the finished document."""

    name: str
    passed: bool
    margin: Finite | None
    """What is left to the limit at the worst place, in `unit`; negative when it fails, null with nothing to check."""
    unit: str | None
    where: JsonValue = None
    """The worst place: segment, time or sample, and the joint, bodies or contact."""
    share_left: Finite | None = None
    """What is left there of the limit itself, as a share of it [1]; told of joint torques."""


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
