"""A point of a study that was examined is kept, however long the database is away meanwhile."""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

from planners.contract.shapes import named_uploads
from planners.study.study import Study
from planners.study.study_map import StudyPoint
from tests.support.service import task
from workers.engine.study_runner import StudyRunner
from workers.settings import WorkerSettings
from workers.solver.protocol import StudyRequest
from workers.stores.study_store import StudyRecord
from workers.stores.task_parts import TaskParts

SECONDS = 0.2
"""A solver may take so long."""


class SlowStore:
    """Stands for a store whose database is away for longer than a solver may take."""

    def __init__(self) -> None:
        self.kept: list[StudyPoint] = []

    def add_point(self, _study_id: str, point: StudyPoint) -> bool:
        time.sleep(2.0 * SECONDS)
        self.kept.append(point)
        return True


class PromptPool:
    """Stands for solvers that answer at once, but to the last point of a request: that they never do."""

    def __init__(self, study: Study) -> None:
        self._study = study

    async def examine(self, request: StudyRequest, keep: Any) -> None:
        for index in request.points[:-1]:
            point = StudyPoint.without_plan(self._study, index, "refused", "no such place", 0.0)
            await keep(json.loads(point.model_dump_json()))
        await asyncio.Event().wait()


class Named:
    """Stands for the stores of meshes and of cells, of which it has whatever is named."""

    def documents(self, ids: Iterable[str]) -> dict[str, str]:
        return {name: f"mesh {name}" for name in ids}

    def unpacked(self, cell: str) -> Path:
        return Path("cells") / cell


def test_whoever_examines_is_given_what_any_point_names() -> None:
    meshes, cells = ("a" * 32, "b" * 32), ("dual_ur3e_tool", "mine", "yours")
    body = task("can_stack.json")
    body["objects"][0]["shape"] = {"type": "mesh", "upload": meshes[0]}
    axes = [{"pointer": "/objects/0/shape/upload", "values": meshes}, {"pointer": "/cell", "values": cells}]
    study = Study.read({"task": body, "axes": axes})
    store, each = TaskParts(*cast(Any, (Named(), Named()))), study.with_each_value()
    # Asked again, as after a loss of the database, the same is named.
    parts = store.named_by(each)
    assert store.named_by(each) == parts
    points = [study.document_at(index) for index in range(study.count)]
    assert set(parts.meshes) == frozenset().union(*map(named_uploads, points)) == set(meshes)
    assert set(parts.cell_folders) == {str(point["cell"]) for point in points} - {"dual_ur3e_tool"}


def test_only_the_solvers_own_time_is_limited(tmp_path: Path) -> None:
    axis = {"pointer": "/cup/position/0", "min": -0.1, "max": 0.1, "count": 3}
    study = Study.read({"task": task(), "axes": [axis]})
    settings = WorkerSettings.model_validate({"data_dir": tmp_path, "solver_seconds": SECONDS})
    store = SlowStore()
    runner = StudyRunner(settings, *cast(Any, (None, store, None, PromptPool(study))))
    request = StudyRequest(study.document(), [0, 1, 2])
    record = cast(StudyRecord, type("Record", (), {"id": "s1"}))
    asyncio.run(runner._examine("s1-part-0", record, study, request, Counter()))
    assert [(point.index, point.outcome) for point in store.kept] == [(0, "refused"), (1, "refused"), (2, "failed")]
