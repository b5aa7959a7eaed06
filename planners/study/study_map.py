"""What a study found: an outcome with figures at every point, and which point is best."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Literal, Self

from pydantic import JsonValue

from planners.contract.arrays import Finite
from planners.contract.strict_model import StrictModel
from planners.plan.loads import largest_load
from planners.plan.plan import Plan
from planners.study.study import Study

PointOutcome = Literal["solved", "infeasible", "not_found", "refused", "failed"]
OUTCOMES: tuple[PointOutcome, ...] = ("solved", "infeasible", "not_found", "refused", "failed")
SCHEMA_VERSION = "1.0"


class StudyPoint(StrictModel):
    """What came of the task at one point."""

    index: int
    """Its number, from 0; values of the last axis vary fastest."""
    at: tuple[int, ...]
    """Which value of each axis it has, from 0."""
    outcome: PointOutcome
    """Of planning it, as of plans; or refused: there can be no such task, as where the cup sticks out over the edge; or
    failed: the fault is ours."""
    examined: Literal["searched", "planned"] | None
    """searched: holds, balances and the arms' motion were planned, with the densities of the task alone: where that is
    not_found, a plan of the point is searched more densely and may be solved. planned: as a plan is. None: neither."""
    certified: bool = False
    """Whether a certificate of it passed; searched points have none, until they are planned."""
    reserve: Finite | None = None
    """The share of every force limit that is kept back all along, if solved [1]."""
    limited_by: str | None = None
    """Of what least is left."""
    largest_force: Finite | None = None
    """The most that a hand bears, if solved [N]."""
    seconds: Finite
    """How long it took."""
    summary: str
    """In a sentence: what happens, or why not."""

    @classmethod
    def of_plan(
        cls, study: Study, index: int, plan: Plan, examined: Literal["searched", "planned"], seconds: float
    ) -> Self:
        """Return what a plan of a point's task tells of it."""
        solved, reserve = plan.outcome == "solved", plan.statistics.reserve
        return cls(
            index=index,
            at=study.at(index),
            outcome=plan.outcome,
            examined=examined,
            certified=plan.certificate is not None and plan.certificate.passed,
            reserve=reserve.value if solved and reserve is not None else None,
            limited_by=reserve.limited_by if solved and reserve is not None else None,
            largest_force=largest_load(plan)[0] if solved else None,
            seconds=seconds,
            summary=plan.explanation.summary,
        )

    @classmethod
    def without_plan(
        cls, study: Study, index: int, outcome: Literal["refused", "failed"], why: str, seconds: float
    ) -> Self:
        """Return what is told of a point that could not be planned."""
        return cls(index=index, at=study.at(index), outcome=outcome, examined=None, seconds=seconds, summary=why)


class BestPoint(StrictModel):
    """The point to take, of those that are known."""

    index: int
    values: list[JsonValue]
    """Of the axes there."""
    why: str


class MapAxis(StrictModel):
    """One axis of a map."""

    pointer: str
    part: Literal["value", "yaw"]
    values: list[JsonValue]


class StudyMap(StrictModel):
    """What a study found so far."""

    schema_version: str
    task: dict[str, JsonValue]
    """With every default but those that take the scene; what is varied has its value in the axes."""
    axes: list[MapAxis]
    certify: bool
    count: int
    """How many points there are."""
    done: int
    """How many of them are known."""
    outcomes: dict[str, int]
    """How many of these have which outcome."""
    best: BestPoint | None
    """None: none is solved."""
    points: list[StudyPoint]
    """Those that are known, by number."""

    @classmethod
    def of(cls, study: Study, points: Iterable[StudyPoint]) -> Self:
        """Return the map of the points that are known."""
        known = sorted(points, key=lambda point: point.index)
        counts = Counter(point.outcome for point in known)
        axes = [MapAxis(pointer=axis.pointer, part=axis.part, values=list(axis.places)) for axis in study.axes]
        return cls(
            schema_version=SCHEMA_VERSION,
            task=study.spec.task,
            axes=axes,
            certify=study.spec.certify,
            count=study.count,
            done=len(known),
            outcomes={outcome: counts[outcome] for outcome in OUTCOMES},
            best=_best(axes, known),
            points=known,
        )


def best_of(points: Iterable[StudyPoint]) -> StudyPoint | None:
    """Return the solved point that keeps most back, of equal ones that with the least force; None if none is solved."""
    solved = [point for point in points if point.outcome == "solved"]
    return min(solved, key=_rank, default=None)


def _rank(point: StudyPoint) -> tuple[float, float, int]:
    reserve, force = point.reserve, point.largest_force
    # Figures that differ less are the same to a person, and to the solver's tolerance.
    return -round(reserve or 0.0, 4), round(force or 0.0, 2), point.index


def _best(axes: list[MapAxis], known: list[StudyPoint]) -> BestPoint | None:
    point = best_of(known)
    if point is None:
        return None
    values = [axis.values[place] for axis, place in zip(axes, point.at, strict=True)]
    count = sum(each.outcome == "solved" for each in known)
    of = "the only solved point" if count == 1 else f"of {count} solved points the one that keeps most back"
    kept = "" if point.reserve is None else f": {100 * point.reserve:.1f} % of every limit"
    limit = "" if not point.limited_by else f", least of {point.limited_by}"
    force = "" if point.largest_force is None else f"; no hand bears more than {point.largest_force:.1f} N"
    return BestPoint(index=point.index, values=values, why=f"{of}{kept}{limit}{force}")
