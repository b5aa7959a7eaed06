"""Plans that several tests look at: each is made once in a run, by whichever test needs it first.

As a program, it is a solver process that takes what is there from the shelf and puts there what is not.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planners.cell.cell import Cell
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask, read_task, write_task
from planners.plan.plan import Plan
from planners.progress import Progress, silent
from planners.regrasp.grasps.handovers import HandoverDatabase, HandoverSettings, handover_key
from planners.scene.scene import build_scene, with_centres
from planners.scene.suction_tool import SuctionTool
from workers.settings import HANDOVERS_FOLDER, WorkerSettings
from workers.solver.process import COMPILE, main
from workers.solver.protocol import Answer, SolverRequest
from workers.solver.warm_up import is_warm
from workers.stores.handover_store import HandoverStore

from .document_solver import told_physics
from .service import ROOT

if TYPE_CHECKING:
    from workers.solver.pipeline import Pipeline

NOBODY = "shelved-" + "0" * 24
"""The id of documents on the shelf, in place of which each reader has one's own."""


class PlanShelf:
    """A folder with one document for each task, and a lock beside it. Processes of one run share it; no two runs do.

    Tasks name no uploaded meshes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def drawings(self) -> Path:
        """Where services find the robots' drawings that others have made."""
        folder = self._folder.with_name("drawings")
        folder.mkdir(exist_ok=True)
        return folder

    def handovers(
        self, cell: Cell, tool: SuctionTool, settings: HandoverSettings, progress: Progress = silent
    ) -> HandoverDatabase:
        """Return the handovers of a tool: those of the setup if it had today's sources, else found once in a run.

        Where another process is finding them, wait for that.
        """
        key = handover_key(cell, tool, settings)
        found = self._set_up.load(key) if self._set_up else None
        if found is not None:
            return found
        with (self._folder / f"{key}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return HandoverStore(self._folder / HANDOVERS_FOLDER).get(cell, tool, settings, progress)

    @property
    def solver(self) -> tuple[str, ...]:
        """The command of a solver that shares this shelf."""
        return (sys.executable, "-m", "tests.support.plan_shelf", str(self._folder))

    def document(self, task: Mapping[str, Any]) -> dict[str, Any]:
        """Return what comes of a task by all that the product does, certificate and simulation too."""
        return json.loads(self.take(SolverRequest(NOBODY, dict(task)), silent))

    def plan(self, task: PlateLiftTask | SuctionToolTask) -> Plan:
        """Return the plan of a task as `planners.solve` returns it, and simulated unless the task wants none."""
        return Plan.read(self.take(SolverRequest(NOBODY, write_task(task)), silent))

    def take(self, request: SolverRequest, progress: Progress) -> bytes:
        """Return the document of a request; where another process is making it, wait for that."""
        # A service passes a task on with all that it left to defaults.
        task = read_task(request.task)
        stated = with_centres(task, build_scene(task)).model_dump_json()
        name = hashlib.sha256(stated.encode()).hexdigest()
        path = self._folder / f"{name}.json"
        with (self._folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                path.write_bytes(self._pipeline.answer(replace(request, id=NOBODY), progress).document)
        return path.read_bytes().replace(NOBODY.encode(), request.id.encode())

    def answer(self, request: SolverRequest, progress: Progress, _: Callable[[Answer], bool]) -> Answer:
        """Answer as a solver."""
        document = self.take(request, progress)
        told = json.loads(document)
        return Answer(told["outcome"], document, physics=told_physics(told))

    @cached_property
    def _set_up(self) -> HandoverStore | None:
        settings = WorkerSettings(data_dir=ROOT / "data")
        return HandoverStore(settings.handovers_dir) if is_warm(settings) else None

    @cached_property
    def _pipeline(self) -> Pipeline:
        # What is on the shelf already needs none of it.
        from workers.solver.pipeline import Pipeline

        return Pipeline.load(ROOT / "data" / HANDOVERS_FOLDER)


if __name__ == "__main__":
    if COMPILE not in sys.argv:
        main(lambda: PlanShelf(Path(sys.argv[1])).answer)
