"""Who holds connections open keeps nobody out, and the process keeps to what it may open."""

from __future__ import annotations

import errno
import json
import resource
import select
import socket
import subprocess
import sys
import time
from asyncio import new_event_loop
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send
from structlog.testing import capture_logs

from app.server.connections import AcceptFailures, connections_within
from app.settings import ServiceSettings
from tests.support.service import FAKE_SOLVER, ROOT, wait_for
from tests.support.serving import answering, served

MOST = 16
HEAD_SECONDS = 0.5
WRITE_SECONDS = 0.6
SMALL_BUFFER = 2048
LARGE_ANSWER = b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n"
MORE_THAN_KERNELS_HOLD = 40
"""So many of these answers, of some 300 kB each, are more than buffers of the system take [1]."""


@contextmanager
def limited_service(folder: Path, **limits: float) -> Iterator[tuple[str, int]]:
    settings = ServiceSettings.model_validate(
        {"data_dir": folder, "max_connections": MOST, "solver_command": FAKE_SOLVER, **limits}
    )
    with served(settings, with_worker=False) as address:
        parts = urlsplit(address)
        assert parts.hostname
        assert parts.port
        yield parts.hostname, parts.port


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, int]]:
    with limited_service(tmp_path_factory.mktemp("data"), head_seconds=HEAD_SECONDS) as address:
        yield address


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


def small_reader(service: tuple[str, int], requests: bytes) -> socket.socket:
    """Return a connection that asks, and whose client's machine holds little of the answers."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL_BUFFER)
    connection.connect(service)
    connection.setblocking(False)
    # What the service does not read any more, it has been asked often enough for.
    with suppress(BlockingIOError):
        connection.sendall(requests)
    return connection


def is_aborted(connection: socket.socket) -> bool:
    """Tell whether the other end has dropped a connection of which nothing is read."""
    poll = select.poll()
    poll.register(connection, select.POLLRDHUP)
    return bool(poll.poll(20))


WAITED_FOR = {
    "to take an answer": LARGE_ANSWER * MORE_THAN_KERNELS_HOLD,
    "to take the last one": LARGE_ANSWER * MORE_THAN_KERNELS_HOLD
    + LARGE_ANSWER.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n"),
    "for a body": b"POST /v1/tasks/check HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    b"Content-Length: 100\r\n\r\n{",
}


@pytest.mark.parametrize("what", WAITED_FOR)
@pytest.mark.slow
def test_whoever_is_waited_for_keeps_nobody_out(tmp_path: Path, what: str) -> None:
    """Long before its time is up, and again and again."""

    def answered() -> bool:
        try:
            return httpx.get(f"http://{service[0]}:{service[1]}/livez", timeout=2.0).status_code == 200
        except httpx.TransportError:
            return False

    with limited_service(tmp_path, body_stall_seconds=100.0) as service, ExitStack() as held:
        readers = [held.enter_context(small_reader(service, WAITED_FOR[what])) for _ in range(2 * MOST)]
        # While they are being answered the service has its hands full.
        wait_for(answered, 15.0)
        assert all(answered() for _ in range(3))
        assert sum(map(is_aborted, readers)) > MOST


@pytest.mark.slow
def test_an_answer_of_which_nothing_is_taken_is_not_held_for_long(tmp_path: Path) -> None:
    with limited_service(tmp_path, write_seconds=WRITE_SECONDS) as service:
        with small_reader(service, LARGE_ANSWER * MORE_THAN_KERNELS_HOLD) as connection:
            time.sleep(WRITE_SECONDS / 2)
            assert not is_aborted(connection)
            wait_for(lambda: is_aborted(connection), 6.0 * WRITE_SECONDS)


@pytest.mark.slow
def test_an_answer_of_which_little_is_taken_at_a_time_is_sent_to_its_end(tmp_path: Path) -> None:
    """For several times as long as nothing may be taken of it."""
    with limited_service(tmp_path, write_seconds=WRITE_SECONDS) as service:
        with small_reader(service, LARGE_ANSWER * MORE_THAN_KERNELS_HOLD) as connection:
            deadline, taken = time.monotonic() + 4.0 * WRITE_SECONDS, 0
            while time.monotonic() < deadline:
                with suppress(BlockingIOError):
                    taken += len(connection.recv(SMALL_BUFFER))
                time.sleep(WRITE_SECONDS / 20)
            assert not is_aborted(connection)
        assert taken > SMALL_BUFFER


UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)


async def flood(scope: Scope, receive: Receive, send: Send) -> None:
    """Send without end to whoever opens a websocket; answer others shortly."""
    if scope["type"] != "websocket":
        await PlainTextResponse("")(scope, receive, send)
        return
    await receive()
    await send({"type": "websocket.accept"})
    while True:
        await send({"type": "websocket.send", "bytes": bytes(10**6)})


@pytest.mark.parametrize("before", [b"", b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"])
@pytest.mark.slow
def test_a_websocket_of_which_nothing_is_taken_is_not_held_for_long(tmp_path: Path, before: bytes) -> None:
    """Also one that was a connection of requests before."""
    settings = ServiceSettings(data_dir=tmp_path, write_seconds=WRITE_SECONDS)
    with answering(flood, settings) as address:
        parts = urlsplit(address)
        assert parts.hostname
        assert parts.port
        with small_reader((parts.hostname, parts.port), before + UPGRADE) as connection:
            wait_for(lambda: is_aborted(connection), 10.0 * WRITE_SECONDS)


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


@pytest.mark.slow
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
