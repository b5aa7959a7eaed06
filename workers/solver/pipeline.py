"""The things a plan goes through: TaskSpec, scene, plan, certificate, simulation, document."""

from __future__ import annotations

import base64
import gzip
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, Self

import numpy as np

from planners.cell.cell import Cell, ShippedCells, load_cells
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask, read_task, write_task
from planners.plan.plan import Plan
from planners.plan.simulation import physics_of
from planners.planning import CertificateFailed, TaskSolver
from planners.progress import Progress, silent
from planners.regrasp.grasps.handovers import HandoverSettings, find_handovers
from planners.regrasp.motion.upright_postures import UprightPostures
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.suction_tool import SuctionTool, load_tools
from planners.survey.reach_map import map_reach
from workers.simulation.simulate import simulate_plan
from workers.software import describe_software
from workers.solver.protocol import REJECTED_VARIABLE, Answer, AnyRequest, SolverRequest, uploads_of
from workers.stores.handover_store import HandoverStore

REFERENCE_TASK = "ab1.json"
"""Planning it once compiles every kernel that a plate lift needs."""
REFERENCE_TOOL_TASKS = ("domino_pile.json", "can_stack.json")
"""Planning the first object of each compiles what suction-tool tasks need beyond that: flat facets and curved ones."""
PREPARED_TOOLS = ("long_symmetric", "short_asymmetric")
"""Those of paper A that stand in its cell's rest."""


@dataclass(frozen=True, eq=False)
class Pipeline:
    """What one process needs for solving any task."""

    solver: TaskSolver

    @classmethod
    def load(cls, handovers_dir: Path | None = None) -> Self:
        """Load the tools that are shipped; a cell is loaded when it is first asked for.

        Args:
            handovers_dir: where handover databases are kept; None: each is computed for its one task.
        """
        handovers = find_handovers if handovers_dir is None else HandoverStore(handovers_dir).get
        return cls(
            TaskSolver(ShippedCells(), load_tools(), handovers, simulate=simulate_plan, software=describe_software())
        )

    def warm_up(self) -> Self:
        """Load all cells and nearly all kernels into this process, in some seconds if they are compiled."""
        load_cells()
        self.solve(SolverRequest("warm-up", write_task(reference_task(simulate=False))), silent)
        return self

    def compile(self, *kinds: str) -> None:
        """Compile every kernel for tasks of these kinds that is not compiled yet.

        For suction-tool tasks, compute the handovers of paper A's tools too. Takes a minute the first time, seconds
        after that.
        """
        if "plate_lift" in kinds:
            self.solve(SolverRequest("compile", write_task(reference_task())), silent)
        if "suction_tool" in kinds:
            for task in reference_tool_tasks():
                self.solve(SolverRequest("compile", write_task(task)), silent)
            for cell, tool, settings in self.shipped_handovers():
                self.solver.handovers(cell, tool, settings, silent)
            # Those may have been kept since before the kernels changed, and tools of one's own have theirs found.
            cell, tool, settings = next(self.shipped_handovers())
            find_handovers(cell, tool, replace(settings, axis_rolls=1, grasps=replace(settings.grasps, most=100)))
            cell = self.solver.cells[reference_tool_tasks()[0].cell]
            # Asked for where a search for a way with a load finds none, which these tasks need not have.
            for arm in cell.arms.values():
                UprightPostures(arm, np.eye(4), 0.0).drawn(arm.home, arm.home[None], np.random.default_rng(0))
            # Whoever asks the service what a cell can do does not wait for a compiler.
            map_reach(cell)

    def shipped_handovers(self) -> Iterator[tuple[Cell, SuctionTool, HandoverSettings]]:
        """Yield what handovers are asked for in tasks of paper A: of each tool standing, and lying.

        Those of other tools and cells are computed for the first task that asks for them, and kept.
        """
        cell = self.solver.cells[reference_tool_tasks()[0].cell]
        standing = ToolPlannerSettings().in_cell(cell)
        for name in PREPARED_TOOLS:
            tool = self.solver.tools[name]
            for settings in (standing, standing.with_fingertips()):
                yield cell, tool, settings.handovers

    def answer(
        self, request: SolverRequest, progress: Progress, certified: Callable[[Answer], bool] = lambda _: False
    ) -> Answer:
        """Return what `solve` finds as it is sent; `certified` gets it before, as it does there."""
        return _answer(self.solve(request, progress, lambda plan: certified(_answer(plan))))

    def solve(
        self, request: SolverRequest, progress: Progress, certified: Callable[[Plan], bool] = lambda _: False
    ) -> Plan:
        """Return the certified and simulated plan of a task, or the one that says why there is none and what to change.

        That nothing was found is no claim: such a plan has the certificate None. What is certified, and is going to be
        simulated or to be given remedies, is handed to `certified` before, which says whether to stop there.

        Raises:
            SceneError, pydantic.ValidationError: The task is not one that can be planned.
            CertificateFailed: The plan must not be delivered.
        """
        task, uploads = read_task(request.task), uploads_of(request)
        solver = replace(self.solver, cells=cells_of(request, self.solver.cells))
        if request.certified is not None:
            plan = Plan.read(gzip.decompress(base64.b64decode(request.certified)))
            return solver.completed(plan, uploads, progress)
        try:
            return solver.solve(task, request.id, uploads, progress, certified)
        except CertificateFailed as failure:
            _keep_rejected(failure.plan)
            raise


def _answer(plan: Plan) -> Answer:
    """Return a plan as it is sent."""
    objects = () if plan.task.kind == "plate_lift" else tuple(f" {each.name}" for each in plan.task.objects)
    # Callers choose the names of objects: they would fill the metrics, and are longer than a label.
    stages = tuple(
        (next((name.removesuffix(suffix) for suffix in objects if name.endswith(suffix)), name), seconds)
        for name, seconds in plan.statistics.times
    )
    return Answer(plan.outcome, plan.write(), stages, physics_of(plan.simulation))


def cells_of(request: AnyRequest, shipped: Mapping[str, Cell]) -> Mapping[str, Cell]:
    """Return the cells that a request may name: the shipped ones, and those that came with it."""
    if not request.cell_folders:
        return shipped
    return ShippedCells({name: _unpacked_cell(folder) for name, folder in request.cell_folders.items()})


@lru_cache(maxsize=8)
def _unpacked_cell(folder: str) -> Cell:
    # Here, because what reads bundles takes half a second to import, and most tasks are in shipped cells.
    from planners.cell.bundle import load_unpacked

    return load_unpacked(Path(folder))


def reference_task(**options: float) -> PlateLiftTask:
    """Return the plate lift that is used to warm up, with other options than its own."""
    task = PlateLiftTask.model_validate(_shipped_task(REFERENCE_TASK))
    return task.model_copy(update={"options": task.options.model_copy(update=options)})


def reference_tool_tasks() -> list[SuctionToolTask]:
    """Return suction-tool tasks with one object each: a flat one and a round one; the first is simulated."""
    flat, curved = (SuctionToolTask.model_validate(_shipped_task(name)) for name in REFERENCE_TOOL_TASKS)
    unsimulated = curved.options.model_copy(update={"simulate": False})
    return [
        flat.model_copy(update={"objects": flat.objects[:1]}),
        curved.model_copy(update={"objects": curved.objects[:1], "options": unsimulated}),
    ]


def _shipped_task(name: str) -> Any:
    return json.loads(resources.files("assets").joinpath("tasks", name).read_bytes())


def _keep_rejected(plan: Plan) -> None:
    """Keep a plan that must not be used, if a directory is named for such, to find out why."""
    directory = os.environ.get(REJECTED_VARIABLE)
    if directory:
        path = Path(directory) / f"{plan.id}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(plan.write())
