"""The things a plan goes through: TaskSpec, scene, plan, certificate, simulation, document."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Self

import numpy as np

from planners.cell.cell import Cell, known_cells, load_cell
from planners.certify import CellReference, Certificate, RobotSurfaces, certify, load_surfaces
from planners.contract.task_spec import read_task
from planners.errors import LiftwrightError
from planners.geometry.pose import to_pose7
from planners.geometry.solid_mesh import SolidMesh
from planners.plan.plan import Plan
from planners.plan.simulation import Simulation
from planners.plan.verdicts import Check
from planners.planning import HandoverSource, plan
from planners.progress import Progress, silent
from planners.regrasp.grasps.handovers import find_handovers
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.scene import build_scene
from planners.scene.shape_source import Uploads
from planners.scene.suction_tool import SuctionTool, load_tools, tool_descriptions
from workers.simulation.simulate import simulate_plan
from workers.software import describe_software
from workers.solver.handover_store import HandoverStore
from workers.solver.protocol import REJECTED_VARIABLE, Answer, Request

REFERENCE_TASK = "ab1.json"
"""Planning it once compiles every kernel that a plate lift needs."""
REFERENCE_TOOL_TASKS = ("domino_pile.json", "can_stack.json")
"""Planning the first object of each compiles what suction-tool tasks need beyond that: flat facets and curved ones."""
FEW_HOLDS = {"hold_density": 0.25, "simulate": False}
"""With so few holds the reference task is answered soon, and nearly all kernels are loaded."""


class CertificateFailed(LiftwrightError):
    """A plan was found and did not stand its independent re-check. The fault is ours."""

    def __init__(self, checks: Sequence[Check]) -> None:
        failed = [f"{check.name} (margin {check.margin} {check.unit} at {check.where})" for check in checks]
        super().__init__(f"the plan that was found failed its certificate: {'; '.join(failed)}")


@dataclass(frozen=True, eq=False)
class Pipeline:
    """What one process needs for solving any task."""

    cells: Mapping[str, Cell]
    surfaces: RobotSurfaces
    """The robots' meshes, which the certificate checks against."""
    tools: Mapping[str, SuctionTool]
    plan: Callable[..., Plan] = plan
    certify: Callable[..., Certificate | None] = certify
    simulate: Callable[..., Simulation] = simulate_plan
    clock: Callable[[], float] = time.perf_counter
    """[s]"""
    handovers: HandoverSource = find_handovers

    @classmethod
    def load(cls, handovers_dir: Path | None = None) -> Self:
        """Load the cells, tools and meshes that are shipped.

        Args:
            handovers_dir: where handover databases are kept; None: each is computed for its one task.
        """
        handovers = find_handovers if handovers_dir is None else HandoverStore(handovers_dir).get
        cells = {name: load_cell(name) for name in known_cells()}
        return cls(cells, load_surfaces(), load_tools(), handovers=handovers)

    def warm_up(self) -> Self:
        """Load nearly all kernels into this process, in a fraction of a second if they are compiled."""
        self.solve({"id": "warm-up", "task": {**reference_task(), "options": FEW_HOLDS}}, silent)
        return self

    def compile(self) -> None:
        """Compile every kernel that is not compiled yet, and compute the handovers of every shipped tool.

        Takes minutes the first time, seconds after that.
        """
        self.solve({"id": "compile", "task": reference_task()}, silent)
        tasks = reference_tool_tasks()
        for task in tasks:
            self.solve({"id": "compile", "task": task}, silent)
        standing = ToolPlannerSettings()
        for tool in self.tools.values():
            for settings in (standing, standing.with_fingertips()):
                self.handovers(self.cells[tasks[0]["cell"]], tool, settings.handovers, silent)

    def answer(self, request: Request, progress: Progress) -> Answer:
        """Return what `solve` finds as it is sent."""
        plan = self.solve(request, progress)
        seconds: dict[str, float] = {}
        for name, each in plan.statistics.times:
            seconds[name] = seconds.get(name, 0.0) + each
        return Answer(plan.outcome, plan.write(), seconds)

    def solve(self, request: Request, progress: Progress) -> Plan:
        """Return the certified and simulated plan of a task, or the one that says why there is none.

        That nothing was found is no claim: such a plan has the certificate None.

        Raises:
            SceneError, pydantic.ValidationError: The task is not one that can be planned.
            CertificateFailed: The plan must not be delivered.
        """
        begun = self.clock()
        progress("scene", 0, 1)
        task = read_task(request["task"])
        scene = build_scene(task, self.cells, uploads=_uploads(request), tools=self.tools)
        progress("scene", 1, 1)
        built = self.clock()
        found = self.plan(task, scene, progress, self.clock, self.handovers)
        found = found.model_copy(update={"id": request["id"], "software": describe_software()})
        planned = self.clock()
        progress("certify", 0, 1)
        certificate = self.certify(found.write(), self.surfaces, _reference(self.cells[found.cell.name]))
        found = found.model_copy(update={"certificate": certificate})
        progress("certify", 1, 1)
        _require_passed(found)
        certified = self.clock()
        stages = [("scene", built - begun), *found.statistics.times, ("certify", certified - planned)]
        if found.outcome == "solved" and task.options.simulate:
            simulation = self.simulate(found, scene, progress, task.seed)
            found = found.model_copy(update={"simulation": simulation})
            stages.append(("simulate", self.clock() - certified))
        return found.model_copy(update={"statistics": found.statistics.taking(stages, self.clock() - begun)})


def reference_task() -> dict[str, Any]:
    """Return the body of the plate lift that is used to warm up."""
    return _shipped_task(REFERENCE_TASK)


def reference_tool_tasks() -> list[dict[str, Any]]:
    """Return bodies of suction-tool tasks with one object each: a flat one and a round one; the first is simulated."""
    flat, curved = (_shipped_task(name) for name in REFERENCE_TOOL_TASKS)
    return [
        {**flat, "objects": flat["objects"][:1]},
        {**curved, "objects": curved["objects"][:1], "options": {"simulate": False}},
    ]


def _shipped_task(name: str) -> dict[str, Any]:
    return json.loads(resources.files("assets").joinpath("tasks", name).read_text())


def _uploads(request: Request) -> Uploads:
    """Return how the scene finds the meshes that came with a request."""
    documents = request.get("meshes", {})
    return lambda upload: SolidMesh.from_document(documents[upload]) if upload in documents else None


def _reference(cell: Cell) -> CellReference:
    """Return what the certificate may take for known about a cell."""
    home = np.concatenate([cell.arms[arm].home for arm in ("left", "right")])
    rest = None if cell.tool_rest is None else to_pose7(cell.tool_rest.T_world_tool)
    return CellReference(cell.document(), cell.body_documents(), home, rest, tool_descriptions())


def _require_passed(plan: Plan) -> None:
    if plan.certificate is None or plan.certificate.passed:
        return
    directory = os.environ.get(REJECTED_VARIABLE)
    if directory:
        path = Path(directory) / f"{plan.id}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(plan.write())
    raise CertificateFailed(plan.certificate.failures)
