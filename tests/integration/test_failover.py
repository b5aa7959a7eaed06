"""A standby takes the place of the primary under load: what was accepted is there, runs, and ends once."""

from __future__ import annotations

import signal
import threading
import time
from collections import Counter
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import pytest
from sqlalchemy.exc import OperationalError

from tests.support.accepted import accept
from tests.support.postgres import needs_postgres, running_postgres
from tests.support.service import FAKE_SOLVER, finished, running_service, task, wait_for
from tests.support.worker import WorkerProcess
from workers.settings import WorkerSettings
from workers.stores.database import open_database
from workers.stores.job_queue import JobQueue
from workers.stores.plan_store import PlanStore

pytestmark = [needs_postgres, pytest.mark.slow]
SETTINGS = {"worker_slots": 2, "watch_seconds": 0.5, "patience_seconds": 3.0}
POSTS = 120


class Poster(threading.Thread):
    """Posts tasks one after the other, each again under its key until it is accepted."""

    def __init__(self, address: str) -> None:
        super().__init__(daemon=True)
        self._address = address
        self.accepted: list[dict] = []
        self.refused = Counter[int]()

    def run(self) -> None:
        with httpx.Client(base_url=self._address, timeout=60.0) as client:
            for number in range(POSTS):
                body = task(external_id="steps-10" if number % 4 else "now")
                while True:
                    answer = client.post("/v1/plans", json=body, headers={"Idempotency-Key": f"order-{number}"})
                    if answer.status_code in (200, 202):
                        self.accepted.append(answer.json())
                        break
                    self.refused[answer.status_code] += 1
                    time.sleep(0.2)


def test_a_request_that_is_made_again_is_answered_once_the_standby_has_what_it_made(tmp_path: Path) -> None:
    """A primary that was killed while it waited for its standby shows afterwards what the standby has not got."""
    with ExitStack() as stack:
        primary = stack.enter_context(running_postgres())
        database = open_database(WorkerSettings.model_validate({"data_dir": tmp_path, "database_url": primary.url}))
        stack.callback(database.close)
        queue = JobQueue(database)
        stack.callback(queue.close)
        store = PlanStore(database)
        standby = stack.enter_context(primary.with_standby())
        standby.stop()
        answered: list[str] = []

        def post() -> None:
            with suppress(OperationalError):
                answered.append(accept(store, task(), "order", queue).id)

        first = threading.Thread(target=post)
        first.start()
        first.join(2.0)
        assert first.is_alive(), "it waits for the standby"
        primary.kill()
        first.join()
        primary.start()
        wait_for(lambda: bool(store.newest(1, None)), 30.0)
        found: list[str] = []

        def look() -> None:
            known = store.by_key("order")
            assert known is not None
            found.append(known.id)

        again = [threading.Thread(target=each) for each in (post, look)]
        for each in again:
            each.start()
        for each in again:
            each.join(2.0)
        assert not answered
        assert not found
        standby.start()
        for each in again:
            each.join(30.0)
        primary.kill()
        standby.promote()
        taken_over = {"data_dir": tmp_path, "database_url": standby.url}
        promoted = open_database(WorkerSettings.model_validate(taken_over))
        stack.callback(promoted.close)
        assert [plan.id for plan in PlanStore(promoted).newest(9, None)] == answered == found
        assert len(answered) == 1


@pytest.mark.parametrize("killed", [True, False], ids=["killed", "shut down"])
def test_nothing_that_was_accepted_is_lost_when_a_standby_takes_over(killed: bool, tmp_path: Path) -> None:
    with ExitStack() as stack:
        primary = stack.enter_context(running_postgres())
        standby = stack.enter_context(primary.with_standby())
        hosts = "&".join(f"host=127.0.0.1:{server.port}" for server in (primary, standby))
        url = f"postgresql://liftwright@/liftwright?{hosts}&target_session_attrs=read-write"
        settings = {**SETTINGS, "database_url": url}
        api = stack.enter_context(running_service(tmp_path / "api", FAKE_SOLVER, command="api", **settings))
        for name in ("first", "second"):
            worker = WorkerProcess(name, tmp_path / name, FAKE_SOLVER, **settings).start()
            stack.callback(worker.end, signal.SIGTERM)
        poster = Poster(api.address)
        poster.start()
        wait_for(lambda: len(poster.accepted) > POSTS // 3, 60.0)
        primary.kill() if killed else primary.stop()
        before = len(poster.accepted)
        standby.promote()
        poster.join(timeout=240.0)
        assert not poster.is_alive()
        # Some came after it, and whoever asked in between was told to ask again.
        assert before < POSTS
        assert set(poster.refused) <= {503}
        with api.client() as client:
            for plan in poster.accepted:
                assert finished(client, plan)["outcome"] == "solved"
            listed = client.get("/v1/plans", params={"page_size": 200}).json()["plans"]
            assert client.get("/readyz").status_code == 200
        # One plan for each key: an answer that was lost on its way is given again.
        ids = [plan["id"] for plan in poster.accepted]
        assert len(set(ids)) == POSTS
        assert sorted(each["id"] for each in listed) == sorted(ids)
