"""A worker that loses its connections while it starts tries again, and says so, instead of ending."""

from __future__ import annotations

import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.support.postgres import needs_postgres, running_postgres
from tests.support.service import FAKE_SOLVER, finished, running_service, task, wait_for
from tests.support.worker import WorkerProcess

pytestmark = needs_postgres


class CuttingRelay:
    """Leads to a server, and cuts the connection at every n-th thing that is asked through it, so many times."""

    def __init__(self, port: int, every: int, cuts: int) -> None:
        self._server, self._every, self.cuts = port, every, cuts
        self._asked, self._lock = 0, threading.Lock()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listening.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near = self._listening.accept()[0]
                far = socket.create_connection(("127.0.0.1", self._server))
                threading.Thread(target=self._relay, args=(near, far, True), daemon=True).start()
                threading.Thread(target=self._relay, args=(far, near, False), daemon=True).start()

    def _relay(self, source: socket.socket, target: socket.socket, asking: bool) -> None:
        with suppress(OSError):
            while (content := source.recv(2**16)) and not (asking and self._cut()):
                target.sendall(content)
        for each in (source, target):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
        # The other one is closed by whoever reads from it.
        source.close()

    def _cut(self) -> bool:
        with self._lock:
            self._asked += 1
            cut = self.cuts > 0 and self._asked % self._every == 0
            self.cuts -= cut
            return cut


@contextmanager
def cutting_relay(port: int, every: int, cuts: int) -> Iterator[CuttingRelay]:
    relay = CuttingRelay(port, every, cuts)
    try:
        yield relay
    finally:
        relay.close()


@pytest.mark.slow
@pytest.mark.parametrize("every", [5, 11, 23])
def test_a_worker_whose_connections_are_cut_while_it_starts_tries_again_and_works(every: int, tmp_path: Path) -> None:
    with running_postgres() as server:
        with running_service(tmp_path / "api", FAKE_SOLVER, command="api", database_url=server.url) as api:
            with cutting_relay(server.port, every, cuts=6) as relay:
                url = server.url.replace(str(server.port), str(relay.port))
                worker = WorkerProcess("cut", tmp_path / "worker", FAKE_SOLVER, worker_slots=1, database_url=url)
                try:
                    worker.start()
                    wait_for(lambda: relay.cuts == 0)
                    with api.client() as client:
                        plan = client.post("/v1/plans", json=task(external_id="now")).raise_for_status().json()
                        assert finished(client, plan)["outcome"] == "solved"
                finally:
                    worker.end(signal.SIGTERM)
                assert "Traceback" not in worker.log
                assert "waiting for the database" in worker.log
