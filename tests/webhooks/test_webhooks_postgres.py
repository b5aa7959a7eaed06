"""A fleet on PostgreSQL tells webhooks as one process on SQLite does: the API takes them, a worker sends."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
from standardwebhooks.webhooks import Webhook

from tests.support.postgres import needs_postgres, running_postgres
from tests.support.receiver import running_receiver
from tests.support.service import FAKE_SOLVER, running_service, task, wait_for
from tests.support.worker import WorkerProcess


@pytest.mark.slow
@needs_postgres
def test_a_worker_tells_the_end_of_a_job_again_until_it_is_taken_even_if_it_dies_meanwhile(tmp_path: Path) -> None:
    with running_postgres() as server, running_receiver() as receiver:
        settings = {
            "database_url": server.url,
            "webhook_networks": json.dumps(["127.0.0.0/8"]),
            "webhook_retry_seconds": json.dumps([0.2, 2.0, 0.2]),
            "watch_seconds": 0.5,
        }
        worker = WorkerProcess("only", tmp_path / "only", FAKE_SOLVER, **settings)
        with (
            running_service(tmp_path / "api", FAKE_SOLVER, command="api", **settings) as api,
            api.client() as client,
        ):
            body = {"url": f"{receiver.address}/later", "plans": "all"}
            webhook = client.post("/v1/webhooks", json=body).raise_for_status().json()
            worker.start()
            try:
                plan = client.post("/v1/plans", json=task(external_id="now")).raise_for_status().json()
                wait_for(lambda: len(receiver.at("/later")) >= 2)
                worker.end(signal.SIGKILL)
                worker.start()

                def delivery() -> dict:
                    return client.get(webhook["links"]["deliveries"]).json()["deliveries"][0]

                wait_for(lambda: delivery()["state"] == "delivered")
                assert delivery()["plan_id"] == plan["id"]
            finally:
                worker.end(signal.SIGTERM)
        sent = receiver.at("/later")
        assert len({(headers["webhook-id"], body) for headers, body in sent}) == 1
        message = Webhook(webhook["secret"]).verify(sent[-1][1], sent[-1][0])
        assert (message["type"], message["data"]["id"]) == ("plan.succeeded", plan["id"])
