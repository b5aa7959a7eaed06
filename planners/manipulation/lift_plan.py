"""What comes out of planning a plate lift."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from planners.graph.rejections import Rejection, Rejections
from planners.manipulation.lift_segment import LiftSegment
from planners.manipulation.statics.reserves import ReservedSegments
from planners.plan.verdicts import LeastReserve, PlanningOutcome


@dataclass(frozen=True)
class SequenceStep:
    """One node of the sequence found, for reports."""

    pose: int
    contact: str
    hands: tuple[int | None, int | None]
    force: float
    """Largest contact normal of the hands [N]."""


@dataclass(frozen=True, eq=False)
class LiftPlan:
    """What came out of planning a plate lift, and what it cost."""

    outcome: PlanningOutcome
    summary: str
    causes: tuple[Rejection, ...]
    rejections: Rejections
    graph: Mapping[str, int | Mapping[str, Mapping[str, int]]]
    search: dict[str, int | float | None] = field(default_factory=dict)
    segments: tuple[LiftSegment, ...] = ()
    steps: tuple[SequenceStep, ...] = ()
    reserves: ReservedSegments | None = None
    """How much of every limit it leaves; None where there is no plan."""
    rises: bool = False
    """Whether the plan ends where the lift can go on straight up."""

    @property
    def reserve(self) -> LeastReserve | None:
        """Where along the plan least of the limits is left."""
        return None if self.reserves is None else self.reserves.least
