"""Whether a lift that is being changed has a way left, asked of a graph that is kept from question to question.

Forces leave poses, holds and reach as they are, and so does the cup's place but for what the cup itself meets: such a
question takes a tenth of a plan. Where the plate, an obstacle or the sampling has changed, the graph is made anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from planners.cell.cell import Cell
from planners.contract.task_spec import PlateLiftTask, without
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.statics.path_forces import FORCES
from planners.plan.verdicts import Feasibility
from planners.planning import lift_settings
from planners.progress import silent
from planners.scene.lift_scene import build_lift_scene
from planners.scene.shape_source import Uploads, no_uploads

_NOT_THE_GRAPH = (
    *(*FORCES, "/plate/com_tolerance", "/seed", "/external_id"),
    *(f"/options/{name}" for name in ("reserve", "minimise", "search", "remedies", "simulate")),
)
"""Members of a plate lift that change neither poses nor holds nor reach."""


class FeasibilityExaminer:
    """Keeps the graph of the lift that it was asked about last. Not for two threads at once."""

    def __init__(self) -> None:
        self._kept: tuple[dict[str, Any], PlateLiftPlanner] | None = None

    def ask(
        self, task: PlateLiftTask, cells: Mapping[str, Cell] | None = None, uploads: Uploads = no_uploads
    ) -> Feasibility | None:
        """Say whether a lift has a way left among the poses and holds that are tried first.

        Args:
            task: with a place of the cup; what the cup meets at another place than that of the lift asked about first
                is left to whoever plans it.
            cells: by name, as the task says it; None: the shipped ones.
            uploads: finds the meshes that the task names as uploads.

        Returns:
            None where the graph does not fit into memory.

        Raises:
            SceneError: There is no such lift.
        """
        scene = build_lift_scene(task, cells, uploads)
        moves = without(task, _NOT_THE_GRAPH)
        if self._kept is None or self._kept[0] != moves:
            # Two graphs at a time may be more than fit.
            self._kept = None
            settings = replace(lift_settings(task.options), reserve=0.0, most_reserve=False, full=False)
            planner = PlateLiftPlanner(scene, settings, silent)
        else:
            # The last one knows the way that was found last, which most likely is one still.
            planner = self._kept[1].with_limits(scene)
        self._kept = moves, planner
        proof = planner.proof(explained=False)
        if proof is not None:
            return Feasibility(None, proof.summary)
        if not planner.fits:
            return None
        if not planner.may_keep(0.0, low=True):
            # Where a search ends is seldom what decides; what helps is told by remedies, which take longer.
            return Feasibility(None)
        asked = task.options.reserve
        return Feasibility(asked if planner.may_keep(asked, low=True) else 0.0)
