"""Posts one task again and again, as fast as it is accepted, at little cost of its own.

A client library takes as long for a request as the service does, and would measure itself on a machine of two cores.
Run as a program it is told on standard input what to post, and tells on standard output what came of it.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from subprocess import PIPE
from typing import Any
from urllib.parse import urlsplit

from tests.benchmarks.machine import ROOT

ACCEPTED = 202


@dataclass(frozen=True)
class Posted:
    """What came of many posts."""

    accepted: int
    seconds: float
    """From the first request to the last answer."""
    cpu: float
    """Of the process that posts, meanwhile [s]."""
    waits: Sequence[float]
    """From each request to its answer [s]."""


def post_apart(address: str, task: dict[str, Any], keys: Sequence[str], connections: int, posts: int) -> Posted:
    """Post a task so often from a process of its own, over connections that are kept, each with one of the keys."""
    told = json.dumps([address, task, keys, connections, posts])
    command = [sys.executable, "-m", "tests.benchmarks.load_sender"]
    return Posted(**json.loads(subprocess.run(command, input=told.encode(), stdout=PIPE, cwd=ROOT, check=True).stdout))


async def _post_all(address: str, task: dict[str, Any], keys: Sequence[str], connections: int, posts: int) -> Posted:
    where = urlsplit(address)
    loop, left = asyncio.get_running_loop(), iter(range(posts))
    told = [_request(where.netloc, task, keys[n % len(keys)]) for n in range(connections)]
    begun, cpu = time.perf_counter(), time.process_time()
    opened = [
        await loop.create_connection(lambda request=request: _Connection(request, left), where.hostname, where.port)
        for request in told
    ]
    done = await asyncio.gather(*(connection.done for _, connection in opened))
    seconds, cpu = time.perf_counter() - begun, time.process_time() - cpu
    accepted = sum(number for number, _ in done)
    return Posted(accepted, seconds, cpu, [wait for _, waits in done for wait in waits])


def _request(host: str, task: dict[str, Any], key: str) -> bytes:
    body = json.dumps(task).encode()
    head = [
        "POST /v1/plans HTTP/1.1",
        f"Host: {host}",
        f"Authorization: Bearer {key}",
        "Content-Type: application/json",
        f"Content-Length: {len(body)}",
    ]
    return "\r\n".join([*head, "", ""]).encode() + body


class _Connection(asyncio.Protocol):
    """Sends one request after the other, each when the last is answered."""

    def __init__(self, request: bytes, left: Iterator[int]) -> None:
        self._request, self._left = request, left
        self._answer, self._accepted, self._waits = bytearray(), 0, list[float]()
        self.done: asyncio.Future[tuple[int, list[float]]] = asyncio.get_running_loop().create_future()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.WriteTransport)
        self._transport = transport
        self._ask()

    def data_received(self, data: bytes) -> None:
        self._answer += data
        head, end, body = self._answer.partition(b"\r\n\r\n")
        if not end or len(body) < _length(head):
            return
        self._waits.append(time.perf_counter() - self._asked)
        self._accepted += int(head.split(b" ", 2)[1]) == ACCEPTED
        self._answer.clear()
        self._ask()

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.done.done():
            self.done.set_exception(exc or ConnectionResetError("the service has closed a connection"))

    def _ask(self) -> None:
        if next(self._left, None) is None:
            self.done.set_result((self._accepted, self._waits))
            self._transport.close()
            return
        self._asked = time.perf_counter()
        self._transport.write(self._request)


def _length(head: bytearray) -> int:
    """Return how many bytes the body of an answer has."""
    _, _, rest = head.lower().partition(b"content-length:")
    return int(rest.partition(b"\r\n")[0])


if __name__ == "__main__":
    sys.stdout.write(json.dumps(vars(asyncio.run(_post_all(*json.loads(sys.stdin.read()))))))
