"""Plans the tasks of files on this machine."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any
from weakref import finalize

from pydantic import ValidationError

from app.cli.given_file import check_cell_path
from app.cli.output import BadInput, ProgressBar, Refused
from app.cli.plan_command import Planned
from app.cli.task_file import TaskFile
from app.task_intake import AcceptedTask, NeedsScene, accept_task
from planners.cell.cell import ShippedCells
from planners.contract.problems import problems_of
from planners.contract.scene_document import SceneDocument
from planners.contract.strict_json import NotJson, parse_json
from planners.contract.task_spec import write_task
from planners.errors import AssetError, SceneError
from planners.geometry.solid_mesh import SolidMesh
from planners.progress import Report
from planners.scene.suction_tool import load_tools
from workers.loading import loading
from workers.settings import WorkerSettings
from workers.solver.progress import ProgressScale
from workers.solver.protocol import SolverRequest

if TYPE_CHECKING:
    from workers.solver.pipeline import Pipeline

HANDOVERS = "handovers"
"""Stage that is reported only where handovers are not found in the data directory."""
SCENES = "`liftwright scene --out FILE` writes one"


class LocalPlanner:
    """Plans without a server."""

    def __init__(self, settings: WorkerSettings, scene: Path | None = None, cell: Path | None = None) -> None:
        """Load cells and tools.

        Args:
            settings: name the data directory, where handovers are kept.
            scene: of a SceneDocument that `liftwright scene` wrote; tasks' objects are those perceived in it.
            cell: folder, zip or file of a cell of one's own; tasks that name none are in it, and so is a scene of a
                cell that is not shipped.

        Raises:
            BadInput: There is no scene in that file, or something is wrong with the cell.
            OSError: It cannot be read.
        """
        self._scene = None if scene is None else read_scene_file(scene)
        self._settings, self._cells, self._tools = settings, ShippedCells(), load_tools()
        self._cell = None if cell is None else self._take_cell(cell)
        if self._scene is not None and self._cell is not None and self._scene.cell not in self._cells:
            # A service names the cell by an id, which no file of the cell tells.
            self._scene = self._scene.model_copy(update={"cell": self._cell})

    def begin(self, file: TaskFile) -> Callable[[], Planned]:
        """Accept a task, and return what plans it.

        Raises:
            Refused: It is not one that can be planned.
        """
        try:
            task = self._accept(file.task)
        except (ValidationError, SceneError) as error:
            raise Refused(problems_of(error)) from error
        return lambda: self._plan(file, task)

    def _take_cell(self, path: Path) -> str:
        """Load a cell of one's own, and return its name."""
        # Here, because what reads it takes half a second to import.
        from planners.cell.bundle import CellBundle
        from planners.survey.faults import load_checked

        check_cell_path(path)
        # Where it is unpacked is read as long as tasks are planned, and goes with who plans them.
        unpacked = Path(mkdtemp(prefix="liftwright-cell-"))
        finalize(self, rmtree, unpacked, ignore_errors=True)
        try:
            bundle = CellBundle.read(path)
            self._cell_folder = bundle.unpack(unpacked)
            cell = load_checked(bundle, unpacked)
        except AssetError as error:
            raise BadInput(f"{path}:\n{error}") from error
        if cell.name in self._cells:
            raise BadInput(f"{path}: a shipped cell is called {cell.name}; give yours another name")
        self._cells = ShippedCells({cell.name: cell})
        return cell.name

    def _accept(self, sent: Any) -> AcceptedTask:
        """Return the task with every default filled in.

        Raises:
            pydantic.ValidationError, SceneError: What is wrong with it.
        """
        scene = self._scene
        if self._cell is not None and isinstance(sent, dict):
            sent = {"cell": self._cell, **sent}
        if scene is not None:
            return accept_task(_named(sent, scene), self._cells, _upload_elsewhere, lambda _: scene, self._tools)
        try:
            return accept_task(sent, self._cells, _upload_elsewhere, _scene_elsewhere, self._tools)
        except NeedsScene as error:
            detail = 'the task needs a scene: give --scene FILE, or "scene_id" in the task'
            raise SceneError(error.pointer, detail) from error

    def _plan(self, file: TaskFile, accepted: AcceptedTask) -> Planned:
        # A command that only reads a file makes no data directory of its own.
        folder, handovers = self._settings.data_dir, self._settings.handovers_dir
        keeps = folder.is_dir() or "data_dir" in self._settings.model_fields_set
        kept = f"kept in {handovers}" if keeps else f"not kept: no {folder} here, and no --data-dir"
        pipeline = _pipeline().load(handovers if keeps else None)
        with ProgressBar(file.stem) as bar:
            task, begun = write_task(accepted), set[str]()
            scale = ProgressScale.of(task)

            def show(report: Report, /) -> None:
                if report.stage == HANDOVERS and report.stage not in begun:
                    bar.say(f"liftwright: computing handovers of the tool, which takes some seconds; {kept}")
                begun.add(report.stage)
                bar.show(report.name, scale.advance(report))

            folders = {accepted.cell: str(self._cell_folder)} if accepted.cell == self._cell else None
            plan = pipeline.solve(SolverRequest(file.stem, task, cell_folders=folders), show)
            bar.show("done", 1.0)
        return Planned(plan)


def read_scene_file(path: Path) -> SceneDocument:
    """Return the scene in a file.

    Raises:
        BadInput: There is none.
        OSError: It cannot be read.
    """
    try:
        return SceneDocument.model_validate(parse_json(path.read_bytes(), "the file"))
    except NotJson as error:
        raise BadInput(f"{path}: {error}") from error
    except ValidationError as error:
        first = problems_of(error)[0]
        where = f"{first.pointer} " if first.pointer else ""
        raise BadInput(f"{path} is not a scene ({where}{first.detail}); {SCENES}") from error


def _scene_elsewhere(scene_id: str) -> SceneDocument | None:
    detail = (
        f"the scene {scene_id} is kept by a service, not here; plan with --service http://…, "
        "or give what `liftwright scene --out` wrote as --scene"
    )
    raise SceneError("/scene_id", detail)


def _upload_elsewhere(upload: str) -> SolidMesh | None:
    raise SceneError("", f"the upload {upload} is kept by a service, not here; plan with --service http://…")


def _named(sent: Any, scene: SceneDocument) -> dict[str, Any]:
    """Return a task that names a scene, if it did not before.

    Raises:
        SceneError: Tasks of this kind have none.
    """
    if not isinstance(sent, dict) or sent.get("kind") != "suction_tool":
        raise SceneError("/kind", "only tasks of suction tools take their objects from a scene", ["suction_tool"])
    name = hashlib.sha256(scene.model_dump_json().encode()).hexdigest()[:32]
    return {**sent, "scene_id": sent.get("scene_id") or name}


@cache
def _pipeline() -> type[Pipeline]:
    """Import what plans, once: that takes longer than it takes to refuse a task."""
    with loading():
        from workers.solver.pipeline import Pipeline

        return Pipeline
