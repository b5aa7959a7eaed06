"""Each worker takes as many jobs as its own settings say, whatever others of its fleet were started with."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path

import httpx
import pytest

from app.settings import ServiceSettings
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER, task, wait_for
from tests.support.serving import served
from workers.engine.worker import _engine
from workers.stores.database import open_database
from workers.stores.job_queue import DELIVERY_QUEUE, STUDY_QUEUE, JobQueue, queue_looks

LOOK_SECONDS = 0.05


@pytest.mark.slow
def test_a_worker_that_starts_later_with_more_slots_changes_nothing_for_the_others(tmp_path: Path) -> None:
    settings = ServiceSettings(
        data_dir=tmp_path,
        solver_command=FAKE_SOLVER,
        study_command=FAKE_EXAMINER,
        worker_slots=1,
        poll_seconds=LOOK_SECONDS,
    )
    with served(settings) as address, closing(open_database(settings)) as database:
        queue = JobQueue(database)
        # What the start of another one does.
        queue.open(queue_looks(8, 8, LOOK_SECONDS))
        with closing(queue), httpx.Client(base_url=address, timeout=30.0) as client:
            time.sleep(3 * LOOK_SECONDS)
            for _ in range(3):
                client.post("/v1/plans", json=task(external_id="hang")).raise_for_status()
            wait_for(lambda: queue.depth(10).running)
            time.sleep(10 * LOOK_SECONDS)
            assert (queue.depth(10).running, queue.depth(10).queued) == (1, 2)


@pytest.mark.slow
def test_a_worker_asks_the_database_once_how_to_look_at_a_queue(tmp_path: Path) -> None:
    settings = ServiceSettings(
        data_dir=tmp_path, solver_command=FAKE_SOLVER, study_command=FAKE_EXAMINER, poll_seconds=LOOK_SECONDS
    )
    with served(settings):
        engine = _engine()
        assert engine.get_queue(STUDY_QUEUE) is engine.get_queue(STUDY_QUEUE)
        assert engine.get_queue("no such queue") is None


@pytest.mark.parametrize("name", [STUDY_QUEUE, DELIVERY_QUEUE])
def test_what_may_wait_is_looked_for_less_often_than_jobs_unless_both_are_seldom(name: str) -> None:
    assert queue_looks(1, 2, 0.1)[name].seconds == 0.5
    assert queue_looks(1, 2, 2.0)[name].seconds == 2.0
