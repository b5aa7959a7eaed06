"""Posts one task again and again, as fast as it is accepted, at little cost of its own.

A client library takes as long for a request as the service does, and would measure itself on a machine of two cores.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any
from urllib.parse import urlsplit

ACCEPTED = 202


@dataclass(frozen=True)
class Posted:
    """What came of many posts."""

    accepted: int
    seconds: float
    """From the first request to the last answer."""
    cpu: float
    """Of this process meanwhile [s]."""
    waits: Sequence[float]
    """From each request to its answer [s]."""


def post_apart(address: str, task: dict[str, Any], keys: Sequence[str], connections: int, posts: int) -> Posted:
    """Post from a process of its own, in which nothing else takes time; as `post_all` does."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(post_all, address, task, keys, connections, posts).result()


def post_all(address: str, task: dict[str, Any], keys: Sequence[str], connections: int, posts: int) -> Posted:
    """Post a task so often, over connections that are kept, each with one of the keys; none: without a key."""
    return asyncio.run(_post_all(address, task, keys, connections, posts))


async def _post_all(address: str, task: dict[str, Any], keys: Sequence[str], connections: int, posts: int) -> Posted:
    where = urlsplit(address)
    loop, left = asyncio.get_running_loop(), iter(range(posts))
    told = [_request(where.netloc, task, keys[n % len(keys)] if keys else None) for n in range(connections)]
    begun, cpu = time.perf_counter(), time.process_time()
    opened = [
        await loop.create_connection(lambda request=request: _Connection(request, left), where.hostname, where.port)
        for request in told
    ]
    done = await asyncio.gather(*(connection.done for _, connection in opened))
    seconds, cpu = time.perf_counter() - begun, time.process_time() - cpu
    accepted = sum(number for number, _ in done)
    return Posted(accepted, seconds, cpu, [wait for _, waits in done for wait in waits])


def _request(host: str, task: dict[str, Any], key: str | None) -> bytes:
    body = json.dumps(task).encode()
    head = [
        f"POST /v1/plans HTTP/1.1\r\nHost: {host}",
        "Content-Type: application/json",
        f"Content-Length: {len(body)}",
    ]
    if key is not None:
        head.append(f"Authorization: Bearer {key}")
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
