"""What happened while one object was planned."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum

from planners.graph.rejections import Rejections
from planners.regrasp.regrasp_figures import RegraspFigures
from planners.regrasp.tool_plan import ConsideredSuction, RegraspStep


class Stopover(StrEnum):
    """Why an object is put down on its way; the value is what a summary says of it."""

    ASIDE = "put aside first, out of the way of others"
    TAKEN_ANEW = "put down on the way, to be taken at another place"


@dataclass(eq=False)
class ObjectReport:
    """Filled while an object is planned, and read when the plan is told."""

    name: str
    stopover: Stopover | None = None
    """Why the object was only to be put down on its way; None where it was to go to its goal."""
    suctions: list[ConsideredSuction] = field(default_factory=list)
    steps: list[RegraspStep] = field(default_factory=list)
    rejections: Rejections = field(default_factory=Rejections)
    counts: Counter[str] = field(default_factory=Counter)
    figures: RegraspFigures | None = None
    """None where no regrasp graph was made."""
