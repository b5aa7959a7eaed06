"""A job that the command line follows goes on to be followed when the service was restarted meanwhile."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from app.cli import service_client
from app.cli.service_client import JobProgress, PlanAddresses, PlanJob, ServiceAway, ServiceClient

LINKS = PlanAddresses(self="/v1/plans/p1", document="", events="/events", view="")
BEGUN = PlanJob(state="running", progress=JobProgress(fraction=0.0), error=None, links=LINKS)
ENDED = BEGUN.model_copy(update={"state": "succeeded", "progress": JobProgress(fraction=1.0)})


class Restarting(BaseHTTPRequestHandler):
    """Stands for a service: it breaks off, is not ready, and then goes on behind what was received."""

    asked: list[str | None]

    def do_GET(self) -> None:
        self.asked.append(self.headers["Last-Event-ID"])
        turn = len(self.asked)
        self.send_response(503 if turn == 2 else 200)
        self.send_header("Content-Type", "text/event-stream")
        self.end_headers()
        if turn == 1:
            self._tell(1, "progress", json.dumps({"stage": "search", "fraction": 0.5}))
        elif turn > 2:
            self._tell(2, "finished", ENDED.model_dump_json())

    def _tell(self, number: int, event: str, data: str) -> None:
        self.wfile.write(f"id: {number}\nevent: {event}\ndata: {data}\n\n".encode())

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


@contextmanager
def restarting(kind: type[Restarting] = Restarting) -> Iterator[tuple[str, list[str | None]]]:
    asked = list[str | None]()
    with ThreadingHTTPServer(("127.0.0.1", 0), type("Handler", (kind,), {"asked": asked})) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}", asked
        server.shutdown()


def test_each_event_is_received_once_though_the_service_restarts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service_client, "RETRY_SECONDS", 0.0)
    with restarting() as (address, asked):
        assert ServiceClient(address).follow(BEGUN) == ENDED
    assert asked == [None, "1", "1"]


def test_of_a_service_that_stays_away_it_is_told_where_the_job_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service_client, "RESTART_SECONDS", 0.0)
    with restarting() as (address, _), pytest.raises(ServiceAway, match=f"{address}/v1/plans/p1"):
        ServiceClient(address).follow(BEGUN)


class Waiting(Restarting):
    """Stands for a service whose proxy ends the stream of a job that waits, again and again."""

    def do_GET(self) -> None:
        self.asked.append(self.headers["Last-Event-ID"])
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.end_headers()
        if len(self.asked) < 6:
            time.sleep(0.1)
        else:
            self._tell(1, "finished", ENDED.model_dump_json())


def test_a_job_that_waits_is_followed_for_as_long_as_it_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service_client, "RETRY_SECONDS", 0.01)
    monkeypatch.setattr(service_client, "RESTART_SECONDS", 0.2)
    with restarting(Waiting) as (address, asked):
        assert ServiceClient(address).follow(BEGUN) == ENDED
    assert len(asked) == 6
