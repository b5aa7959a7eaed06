"""An upgrade in the middle of a queue: what the first version accepted and had begun, the newest one finishes."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.support.old_tables import back_to_the_first_version
from tests.support.postgres import needs_postgres, running_postgres
from tests.support.service import FAKE_SOLVER, ServiceProcess, finished, task, wait_for
from workers.settings import WorkerSettings
from workers.stores.database import open_database


@pytest.mark.parametrize(
    "postgres",
    [pytest.param(False), pytest.param(True, marks=[needs_postgres, pytest.mark.slow])],
    ids=["sqlite", "postgres"],
)
@pytest.mark.slow
def test_jobs_that_wait_and_run_while_the_software_is_replaced_all_end(postgres: bool, tmp_path: Path) -> None:
    with ExitStack() as stack:
        place = {"database_url": stack.enter_context(running_postgres()).url} if postgres else {}
        service = ServiceProcess(tmp_path, FAKE_SOLVER, worker_slots=1, worker_name="only", **place).start()
        stack.callback(service.stop)
        client = stack.enter_context(service.client())
        wishes = ("steps-5", "steps-40", "steps-3", "now")
        plans = [client.post("/v1/plans", json=task(external_id=wish)).json() for wish in wishes]
        done = finished(client, plans[0])
        wait_for(lambda: client.get(plans[1]["links"]["self"]).json()["state"] == "running")
        document = client.get(done["links"]["document"]).content
        service.kill()
        database = open_database(WorkerSettings(data_dir=tmp_path, **place))
        back_to_the_first_version(database.engine)
        database.close()
        service.start()
        ended = [finished(client, plan) for plan in plans]
        assert [(plan["outcome"], plan["external_id"]) for plan in ended] == [("solved", wish) for wish in wishes]
        # The first version did not note when a plan was certified.
        assert ended[0] == {**done, "certified_at": None}
        assert client.get(done["links"]["document"]).content == document
        found = client.get("/v1/plans", params={"external_id": "steps-40", "outcome": "solved"}).json()["plans"]
        assert found == [ended[1]]
