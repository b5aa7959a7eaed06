"""A point of a study that was examined is kept, however long the database is away meanwhile."""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from pathlib import Path
from typing import Any, cast

from planners.study.study import Study
from planners.study.study_map import StudyPoint
from tests.support.service import task
from workers.engine.study_runner import StudyRunner
from workers.settings import WorkerSettings
from workers.solver.protocol import StudyRequest
from workers.stores.study_store import StudyRecord

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
