"""`liftwright plan FILE`: one task, planned on this machine or by a service."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from app.cli.output import BadInput, ProgressBar, refuse, written_whole
from app.cli.service_client import ServiceClient, ServiceRefused
from app.summary import summarise
from app.task_intake import NeedsScene, accept_task
from planners.contract.problems import problems_of
from planners.contract.scene_document import SceneDocument
from planners.contract.strict_json import NotJson, parse_json
from planners.errors import SceneError
from planners.geometry.solid_mesh import SolidMesh
from planners.plan.plan import Plan
from planners.progress import Report
from workers.settings import WorkerSettings
from workers.solver.pipeline import Pipeline
from workers.solver.progress import ProgressScale

SOLVED, NO_PLAN = 0, 2
JOB_FAILED = 1
HANDOVERS = "handovers"
"""Stage that is reported only where handovers are not found in the data directory."""
SCENES = "`liftwright scene --out FILE` writes one"


def plan_file(path: Path, out: Path | None, settings: WorkerSettings, scene: Path | None = None) -> int:
    """Plan the task in a file, print what came of it, and return the exit code.

    Args:
        path: of the task.
        out: where the plan document goes.
        settings: name the data directory, where handovers are kept.
        scene: of a SceneDocument that `liftwright scene` wrote; the task's objects are those perceived in it.

    Raises:
        BadInput: A file is not a task, or not a scene.
        CertificateFailed: A plan was found that must not be used.
        OSError: A file cannot be read or written.
    """
    sent = read_task_file(path)
    perceived = None if scene is None else read_scene_file(scene)
    # A command that only reads a file makes no data directory of its own.
    keeps = settings.data_dir.is_dir() or "data_dir" in settings.model_fields_set
    pipeline = Pipeline.load(settings.handovers_dir if keeps else None)
    try:
        task = _accept(sent, perceived, pipeline)
    except (ValidationError, SceneError) as error:
        return refuse(problems_of(error), str(path))
    kept = f"kept in {settings.handovers_dir}" if keeps else f"not kept: no {settings.data_dir} here, and no --data-dir"
    with written_whole(out) as file:
        plan = _solve(pipeline, path.stem, task, kept)
        if file is not None:
            json.dump(plan.document(), file, allow_nan=False)
    return _tell(plan)


def post_file(path: Path, out: Path | None, service: str) -> int:
    """Have a service plan the task in a file, print what came of it, and return the exit code.

    Raises:
        BadInput: The file is not a task.
        KeyMissing, ServiceAway, ServiceRefused, NotUnderstood: The service cannot do it, and not because of the task.
        OSError: A file cannot be read or written.
    """
    body = json.dumps(read_task_file(path)).encode()
    client = ServiceClient(service)
    with written_whole(out) as file:
        try:
            job = client.follow(client.post_plan(body))
        except ServiceRefused as error:
            if not error.is_about_the_input:
                raise
            return refuse(error.problems, str(path))
        if job["state"] != "succeeded":
            sys.stderr.write(f"liftwright: the job {job['state']}: {(job['error'] or {}).get('detail', '')}\n")
            return JOB_FAILED
        plan = client.plan(job["links"]["document"])
        if file is not None:
            json.dump(plan.document(), file, allow_nan=False)
    code = _tell(plan)
    sys.stdout.write(f"{'viewer:':<16}{client.address}{job['links']['view']}\n")
    return code


def _tell(plan: Plan) -> int:
    sys.stdout.write(summarise(plan) + "\n")
    return SOLVED if plan.outcome == "solved" else NO_PLAN


def _accept(sent: Any, scene: SceneDocument | None, pipeline: Pipeline) -> dict[str, Any]:
    """Return the task with every default filled in.

    Raises:
        pydantic.ValidationError, SceneError: What is wrong with it.
    """
    if scene is not None:
        return accept_task(
            _named(sent, scene), pipeline.solver.cells, _upload_elsewhere, lambda _: scene, pipeline.solver.tools
        )
    try:
        return accept_task(sent, pipeline.solver.cells, _upload_elsewhere, _scene_elsewhere, pipeline.solver.tools)
    except NeedsScene as error:
        detail = 'the task needs a scene: give --scene FILE, or "scene_id" in the task'
        raise SceneError(error.pointer, detail) from error


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


def _solve(pipeline: Pipeline, name: str, task: dict[str, Any], handovers_kept: str) -> Plan:
    with ProgressBar() as bar:
        scale, begun = ProgressScale.of(task), set[str]()

        def show(report: Report, /) -> None:
            if report.stage == HANDOVERS and report.stage not in begun:
                bar.say(f"liftwright: computing handovers of the tool, which takes some seconds; {handovers_kept}")
            begun.add(report.stage)
            bar.show(report.name, scale.advance(report))

        plan = pipeline.solve({"id": name, "task": task}, show)
        bar.show("done", 1.0)
    return plan


def read_task_file(path: Path) -> Any:
    """Return the JSON data of a file that may be a task.

    Raises:
        BadInput: It is not JSON, or what another command or the service has written.
        OSError: It cannot be read.
    """
    sent = _read_json(path)
    members: Mapping[str, Any] = sent if isinstance(sent, dict) else {}
    if {"segments", "certificate", "task"} <= members.keys():
        raise BadInput(f'{path} is a plan document, not a task; the one it was planned from is its member "task"')
    if {"table", "unrecognised"} <= members.keys():
        raise BadInput(
            f"{path} is a scene, not a task; give it as --scene {path}, beside a task that names its objects"
        )
    return sent


def read_scene_file(path: Path) -> SceneDocument:
    """Return the scene in a file.

    Raises:
        BadInput: There is none.
        OSError: It cannot be read.
    """
    try:
        return SceneDocument.model_validate_json(json.dumps(_read_json(path)))
    except ValidationError as error:
        first = problems_of(error)[0]
        where = f"{first['pointer']} " if first["pointer"] else ""
        raise BadInput(f"{path} is not a scene ({where}{first['detail']}); {SCENES}") from error


def _read_json(path: Path) -> Any:
    try:
        return parse_json(path.read_bytes(), "the file")
    except NotJson as error:
        raise BadInput(f"{path}: {error}") from error
