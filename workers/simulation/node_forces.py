"""Forces at the plan's nodes, planned and simulated."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array
from planners.plan.simulation import NodeComparison
from workers.simulation.reference import LEAD, Moment

_MEAN_TIME = 0.06
"""Forces are means over so long [s]."""


@dataclass(frozen=True, eq=False)
class NodeForces:
    """Forces at the end of one of the plan's motions, planned and simulated; means over the last moments."""

    segment: int
    time: float
    planned: dict[str, Array]
    simulated: dict[str, Array]
    """By "left", "right", "cup", "support": (3,) on the plate, world axes [N]."""

    def largest_difference(self) -> float:
        """Return the largest norm of a difference [N]."""
        return max(float(np.linalg.norm(self.simulated[name] - force)) for name, force in self.planned.items())

    def stated(self) -> NodeComparison:
        """Return the entry of a plan."""
        return NodeComparison(
            segment=self.segment,
            time=self.time,
            planned={name: np.round(force, 3) for name, force in self.planned.items()},
            simulated={name: np.round(force, 3) for name, force in self.simulated.items()},
            largest_difference=round(self.largest_difference(), 3),
        )


class NodeForcesRecorder:
    """Compares at the end of each motion of the plate, before the lifter prepares for what comes next."""

    def __init__(self, step: float) -> None:
        """Prepare for moments `step` apart [s]."""
        self.nodes: list[NodeForces] = []
        self._step = step
        self._recent: deque[Mapping[str, Array]] = deque(maxlen=max(1, round(_MEAN_TIME / step)))

    def due(self, time: float, moment: Moment) -> bool:
        """Say whether the forces now count."""
        end = self._end(moment)
        return moment.stage.kind == "transfer" and end - _MEAN_TIME < time <= end + self._step

    def take(self, time: float, moment: Moment, forces: Mapping[str, Array]) -> None:
        """Take in the forces (3,) on the plate by who exerts them, when they are due [N]."""
        self._recent.append(forces)
        if time + self._step <= self._end(moment):
            return
        number = int(moment.reference.segment_of[moment.low])
        if not self.nodes or self.nodes[-1].segment != number:
            planned = moment.planned_forces()
            simulated = {name: np.mean([row[name] for row in self._recent], axis=0) for name in planned}
            self.nodes.append(NodeForces(number, time, planned, simulated))
        self._recent.clear()

    def _end(self, moment: Moment) -> float:
        stage = moment.stage
        last = stage is moment.reference.stages[-1]
        return stage.end - (0.0 if last else min(LEAD, 0.5 * (stage.end - stage.begin)))
