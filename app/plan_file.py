"""`liftwright plan FILE`: one task, planned on this machine or by a service."""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from app.bad_input import refuse
from app.intake import accept_task
from app.progress_bar import ProgressBar
from app.service_client import ServiceClient, ServiceRefused
from app.settings import ServiceSettings
from app.summary import summarise
from app.whole_file import written_whole
from planners.contract.problems import Problem, problems_of
from planners.contract.scene_document import SceneDocument
from planners.contract.strict_json import NotJson, parse_json
from planners.errors import SceneError
from workers.pipeline import Pipeline
from workers.progress_scale import ProgressScale

SOLVED, NO_PLAN = 0, 2
JOB_FAILED = 1


def plan_file(path: Path, out: Path | None, scene: Path | None = None) -> int:
    """Plan the task in a file, print what came of it, and return the exit code.

    Args:
        path: of the task.
        out: where the plan document goes.
        scene: of a SceneDocument that `liftwright scene` wrote; the task's objects are those perceived in it.

    Raises:
        CertificateFailed: A plan was found that must not be used.
        OSError: A file cannot be read or written.
    """
    try:
        settings = ServiceSettings()
        # A command that only reads a file makes no data directory of its own.
        pipeline = Pipeline.load(settings.handovers_dir if settings.data_dir.is_dir() else None)
        if scene is None:
            task = accept_task(path.read_bytes(), pipeline.cells, scenes=_kept_elsewhere)
        else:
            body, perceived = _named(path.read_bytes(), scene.read_bytes())
            task = accept_task(body, pipeline.cells, scenes=lambda _: perceived)
    except NotJson as error:
        return refuse([Problem(pointer="", detail=str(error))])
    except (ValidationError, SceneError) as error:
        return refuse(problems_of(error))
    with written_whole(out) as file:
        document = _solve(pipeline, path.stem, task)
        if file is not None:
            json.dump(document, file, allow_nan=False)
    return _tell(document)


def post_file(path: Path, out: Path | None, service: str) -> int:
    """Have a service plan the task in a file, print what came of it, and return the exit code.

    Raises:
        ServiceAway, ServiceRefused: The service cannot do it, and not because of the task.
        OSError: A file cannot be read or written.
    """
    client, body = ServiceClient(service), path.read_bytes()
    with written_whole(out) as file:
        try:
            plan = client.follow(client.post_plan(body))
        except ServiceRefused as error:
            if not error.is_about_the_input:
                raise
            return refuse(error.problems)
        if plan["state"] != "succeeded":
            sys.stderr.write(f"liftwright: the job {plan['state']}: {(plan['error'] or {}).get('detail', '')}\n")
            return JOB_FAILED
        document = client.get(plan["links"]["document"])
        if file is not None:
            json.dump(document, file, allow_nan=False)
    code = _tell(document)
    sys.stdout.write(f"{'viewer:':<16}{client.address}{plan['links']['view']}\n")
    return code


def _tell(document: dict[str, Any]) -> int:
    sys.stdout.write(summarise(document) + "\n")
    return SOLVED if document["outcome"] == "solved" else NO_PLAN


def _kept_elsewhere(scene_id: str) -> SceneDocument | None:
    detail = (
        f"the scene {scene_id} is kept by a service, not here; plan with --service http://…, "
        "or give what `liftwright scene --out` wrote as --scene"
    )
    raise SceneError("/scene_id", detail)


def _named(task: bytes, scene: bytes) -> tuple[bytes, SceneDocument]:
    """Return a task that names a scene, if it did not before, and the scene.

    Raises:
        NotJson, pydantic.ValidationError, SceneError: What is wrong with the scene.
    """
    body = parse_json(task)
    if not isinstance(body, dict) or body.get("kind") != "suction_tool":
        raise SceneError("/kind", "only tasks of suction tools take their objects from a scene", ["suction_tool"])
    document = SceneDocument.model_validate_json(json.dumps(parse_json(scene)))
    name = body.get("scene_id") or hashlib.sha256(scene).hexdigest()[:32]
    return json.dumps({**body, "scene_id": name}).encode(), document


def _solve(pipeline: Pipeline, name: str, task: dict[str, Any]) -> dict[str, Any]:
    with ProgressBar() as bar:
        scale = ProgressScale.of(task)

        def show(stage: str, done: int, total: int) -> None:
            bar.show(stage, scale.advance(stage, done, total))

        document = pipeline.solve({"id": name, "task": task}, show)
        bar.show("done", 1.0)
    return document
