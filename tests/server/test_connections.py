"""Who holds connections open keeps nobody out, and the process keeps to what it may open."""

from __future__ import annotations

import errno
import json
import resource
import socket
import subprocess
import sys
import time
from asyncio import new_event_loop
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from structlog.testing import capture_logs
from support.service import FAKE_SOLVER, ROOT, wait_for
from support.serving import served

from app.server.connections import AcceptFailures, connections_within
from app.settings import ServiceSettings

MOST = 16
HEAD_SECONDS = 0.5


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, int]]:
    limits = {"max_connections": MOST, "head_seconds": HEAD_SECONDS, "solver_command": FAKE_SOLVER}
    settings = ServiceSettings.model_validate({"data_dir": tmp_path_factory.mktemp("data"), **limits})
    with served(settings, with_worker=False) as address:
        parts = urlsplit(address)
        assert parts.hostname
        assert parts.port
        yield parts.hostname, parts.port


def is_closed(connection: socket.socket) -> bool:
    connection.settimeout(0.02)
    try:
        return connection.recv(1000) == b""
    except TimeoutError:
        return False
    except ConnectionError:
        return True


def test_whoever_holds_all_connections_open_keeps_nobody_out(service: tuple[str, int]) -> None:
    with ExitStack() as held:
        idle = [held.enter_context(socket.create_connection(service)) for _ in range(3 * MOST)]
        for _ in range(3):
            assert httpx.get(f"http://{service[0]}:{service[1]}/livez", timeout=2.0).status_code == 200
        wait_for(lambda: sum(map(is_closed, idle)) >= 2 * MOST, 5.0)


@pytest.mark.parametrize("begun", [b"", b"GET /livez HTTP/1.1\r\nHost: localhost\r\n", b"GET"])
def test_a_head_that_does_not_come_is_not_waited_for(service: tuple[str, int], begun: bytes) -> None:
    with socket.create_connection(service) as connection:
        connection.sendall(begun)
        wait_for(lambda: is_closed(connection), 5.0 * HEAD_SECONDS)


def test_a_second_head_is_not_waited_for_either_and_drops_do_not_keep_it_alive(service: tuple[str, int]) -> None:
    with socket.create_connection(service) as connection:
        connection.sendall(b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert connection.recv(4096).startswith(b"HTTP/1.1 200")
        begun, closed = time.monotonic(), False
        for letter in b"GET /livez HTTP/1.1\r\nX: " + 200 * b"a":
            connection.settimeout(0.05)
            try:
                connection.sendall(bytes([letter]))
                closed = connection.recv(100) == b""
            except TimeoutError:
                continue
            except ConnectionError:
                closed = True
            if closed:
                break
        assert closed
        assert time.monotonic() - begun < 5.0 * HEAD_SECONDS


def test_a_request_that_is_answered_for_longer_than_a_head_may_take_is_not_cut_off(tmp_path: Path) -> None:
    """Its body comes late: a head that is there has no deadline any more."""
    settings = ServiceSettings(data_dir=tmp_path, solver_command=FAKE_SOLVER, head_seconds=0.2)
    with served(settings, with_worker=False) as address, httpx.Client(base_url=address) as client:

        def slow() -> Iterator[bytes]:
            yield b"{"
            time.sleep(0.6)
            yield b"}"

        answer = client.post("/v1/tasks/check", content=slow(), headers={"Content-Type": "application/json"})
        assert answer.status_code == 200


def test_the_soft_limit_of_files_is_raised_to_the_hard_one_and_connections_keep_within_half_of_it() -> None:
    program = (
        "import resource\nfrom app.server.connections import raise_file_limit\n"
        "print(raise_file_limit(), *resource.getrlimit(resource.RLIMIT_NOFILE))"
    )

    def lower() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (256, 512))

    command = [sys.executable, "-c", program]
    told = subprocess.run(command, cwd=ROOT, preexec_fn=lower, capture_output=True, text=True, check=True).stdout
    assert told.split() == ["512"] * 3
    assert connections_within(1000, 512) == 256
    assert connections_within(1000, 65_536) == 1000


def test_a_machine_without_descriptors_is_told_once_and_not_for_every_try() -> None:
    loop = new_event_loop()
    handler = AcceptFailures()
    context = {"message": "", "exception": OSError(errno.EMFILE, "Too many open files"), "socket": None}
    with capture_logs() as told:
        for _ in range(1000):
            handler(loop, context)
    loop.close()
    assert json.dumps(told).count("out of resources") == 1
