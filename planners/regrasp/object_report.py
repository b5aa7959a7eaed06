"""What happened while one object was planned."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from planners.graph.rejections import Rejections
from planners.regrasp.regrasp_figures import RegraspFigures
from planners.regrasp.tool_plan import ConsideredSuction, RegraspStep


@dataclass(eq=False)
class ObjectReport:
    """Filled while an object is planned, and read when the plan is told."""

    name: str
    aside: bool = False
    """Whether the object was only to be put aside."""
    suctions: list[ConsideredSuction] = field(default_factory=list)
    steps: list[RegraspStep] = field(default_factory=list)
    rejections: Rejections = field(default_factory=Rejections)
    counts: Counter[str] = field(default_factory=Counter)
    figures: RegraspFigures | None = None
    """None where no regrasp graph was made."""
