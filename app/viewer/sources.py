"""What a plan document can be played from: the plan itself, and the simulation of it if there is one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self

from app.viewer.simulated_timeline import SimulatedTimeline
from app.viewer.simulated_tool_timeline import SimulatedToolTimeline
from app.viewer.timeline import Timeline
from planners.geometry.pose import Array

SourceName = Literal["plan", "simulation"]
Simulated = SimulatedTimeline | SimulatedToolTimeline


@dataclass(frozen=True, eq=False)
class Sources:
    """Both count time from the start of the plan."""

    plan: Timeline
    simulation: Simulated | None

    @classmethod
    def of(cls, document: Mapping[str, Any], rest_positions: Array) -> Self:
        """Read a plan document; `rest_positions` are as in `Timeline`."""
        plan = Timeline(document, rest_positions)
        if document["simulation"] is None:
            return cls(plan, None)
        lifts = document["task"]["kind"] == "plate_lift"
        return cls(plan, SimulatedTimeline(document, plan) if lifts else SimulatedToolTimeline(document, plan))

    def __getitem__(self, name: SourceName) -> Timeline | Simulated:
        """Return a source; the plan stands in for a simulation that is not there."""
        return self.simulation if name == "simulation" and self.simulation is not None else self.plan

    @property
    def durations(self) -> dict[SourceName, float]:
        """How long each source that is there takes [s]."""
        there: dict[SourceName, float] = {"plan": self.plan.duration}
        if self.simulation is not None:
            there["simulation"] = self.simulation.duration
        return there
