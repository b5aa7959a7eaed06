"""The five things a plan goes through: TaskSpec, scene, plan, certificate, document."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from planners.certify import certify
from planners.contract.task_spec import read_task
from planners.errors import LiftwrightError
from planners.plan import plan
from planners.progress import Progress, silent
from planners.scene.scene import build_scene
from workers.software import describe_software
from workers.solver_protocol import REJECTED_VARIABLE, Request

REFERENCE_TASK = "ab1.json"
"""Planning it once compiles, or loads, every kernel a job needs."""

Plan = Callable[..., dict[str, Any]]


class CertificateFailed(LiftwrightError):
    """A plan was found and did not stand its independent re-check. The fault is ours."""

    def __init__(self, checks: list[Mapping[str, Any]]) -> None:
        failed = [f"{check['name']} (margin {check['margin']} {check['unit']} at {check['where']})" for check in checks]
        super().__init__(f"the plan that was found failed its certificate: {'; '.join(failed)}")


def solve(
    request: Request, progress: Progress, *, plan: Plan = plan, clock: Callable[[], float] = time.perf_counter
) -> dict[str, Any]:
    """Return the certified plan document of a task, or the document that says why there is no plan.

    Raises:
        SceneError, pydantic.ValidationError: The task is not one that can be planned.
        CertificateFailed: The plan must not be delivered.
    """
    begun = clock()
    progress("scene", 0, 1)
    task = read_task(request["task"])
    scene = build_scene(task)
    progress("scene", 1, 1)
    built = clock()
    document = plan(task, scene, progress, clock)
    document = {**document, "id": request["id"], "software": describe_software()}
    certifying = clock()
    if document["segments"]:
        progress("certify", 0, 1)
        document["certificate"] = certify(document).to_document()
        progress("certify", 1, 1)
        _require_passed(document)
    ended = clock()
    statistics = document["statistics"]
    statistics["stages"] = [
        {"name": "scene", "seconds": built - begun},
        *statistics["stages"],
        {"name": "certify", "seconds": ended - certifying},
    ]
    statistics["total_seconds"] = ended - begun
    return document


def prepare() -> None:
    """Load every compiled kernel that solving needs, by solving the reference task."""
    solve({"id": "warm-up", "task": reference_task()}, silent)


def reference_task() -> dict[str, Any]:
    """Return the body of the task that is used to warm up."""
    return json.loads(resources.files("assets").joinpath("tasks", REFERENCE_TASK).read_text())


def _require_passed(document: dict[str, Any]) -> None:
    certificate = document["certificate"]
    if certificate["passed"]:
        return
    directory = os.environ.get(REJECTED_VARIABLE)
    if directory:
        path = Path(directory) / f"{document['id']}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(document))
    raise CertificateFailed([check for check in certificate["checks"] if not check["passed"]])
