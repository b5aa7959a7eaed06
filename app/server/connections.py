"""Connections as they come in: no more than the process can hold, and none that says nothing for long."""

from __future__ import annotations

import asyncio
import resource
import socket
from dataclasses import dataclass
from errno import EMFILE, ENFILE, ENOBUFS, ENOMEM
from typing import Any

import h11
import structlog
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import Server, ServerState

MOST_DESCRIPTORS = 65_536
"""No more file descriptors are asked for: some programs that are started look at each that there could be [1]."""
DESCRIPTORS_EACH = 2
"""A connection takes one; another is kept for what its request opens: the database, a scene that it is relayed to."""
FEWEST_CONNECTIONS = 16
TELL_SECONDS = 10.0
"""What happens with every connection is told no more often than this [s]."""

log = structlog.get_logger(__name__)


class Occasional:
    """Tells of what happens again and again once in a while, with how often it has happened."""

    def __init__(self, event: str) -> None:
        self._event, self._times, self._told_at = event, 0, float("-inf")

    def happened(self, now: float, **fields: object) -> None:
        """Count it, and log it if that is due at a time [s]."""
        self._times += 1
        if now - self._told_at >= TELL_SECONDS:
            log.warning(self._event, times=self._times, **fields)
            self._times, self._told_at = 0, now


@dataclass(frozen=True)
class ConnectionLimits:
    """What connections may take together and each."""

    most: int
    """So many at once [1]."""
    head_seconds: float
    """So long the head of a request may take to come [s]."""


def raise_file_limit() -> int:
    """Let this process, and what it starts, open as many files as it may; return how many that are [1]."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, MOST_DESCRIPTORS)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        return wanted
    return MOST_DESCRIPTORS if soft == resource.RLIM_INFINITY else soft


def connections_within(most: int, descriptors: int) -> int:
    """Return how many connections there may be, of `most` that are wished for, with so many file descriptors."""
    return max(FEWEST_CONNECTIONS, min(most, descriptors // DESCRIPTORS_EACH))


def guarded(limits: ConnectionLimits) -> type[asyncio.Protocol]:
    """Return the protocol of one server, whose connections are counted together."""

    class Guarded(GuardedProtocol):
        pass

    Guarded.limits, Guarded.refused = limits, Occasional("too many connections: the new one is closed")
    return Guarded


class GuardedProtocol(H11Protocol):
    """HTTP/1.1 on one connection that may have to make room for another.

    Where there are too many, the one that has waited longest for a request of its client's goes, so that whoever holds
    connections open keeps nobody out; a new one is refused only while all others are being answered.
    """

    limits: ConnectionLimits
    refused: Occasional

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._head_timer: asyncio.TimerHandle | None = None
        self._quiet_since = self.loop.time()

    @property
    def quiet(self) -> bool:
        """Whether no request is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, and make room for it if there are too many."""
        super().connection_made(transport)
        self._await_head()
        if len(self.connections) <= self.limits.most:
            return
        waiting = [
            each
            for each in self.connections
            if isinstance(each, GuardedProtocol) and each is not self and each.quiet and not each.transport.is_closing()
        ]
        if waiting:
            min(waiting, key=lambda each: each._quiet_since).transport.abort()
        elif sum(not each.transport.is_closing() for each in self.connections) > self.limits.most:
            self.refused.happened(self.loop.time(), most=self.limits.most)
            transport.abort()

    def data_received(self, data: bytes) -> None:
        """Take what has come; whoever has begun a request is to finish its head soon."""
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._stop_head_timer()
        elif self._head_timer is None:
            self._await_head()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._quiet_since = self.loop.time()
        super().on_response_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._stop_head_timer()
        super().connection_lost(exc)

    def _await_head(self) -> None:
        self._head_timer = self.loop.call_later(self.limits.head_seconds, self.transport.close)

    def _stop_head_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None


class GuardedServer(Server):
    """Tells once in a while, and no more often, that no connection can be taken."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen."""
        asyncio.get_running_loop().set_exception_handler(AcceptFailures())
        await super().startup(sockets)


class AcceptFailures:
    """Exception handler of an event loop: a machine that is out of resources is told once in a while.

    The loop tries to accept as often as its backlog is long, and would tell of each failure.
    """

    def __init__(self) -> None:
        self._failed = Occasional("no connection can be taken: the machine is out of resources")

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Handle what nobody has caught."""
        error = context.get("exception")
        if isinstance(error, OSError) and error.errno in (EMFILE, ENFILE, ENOBUFS, ENOMEM) and "socket" in context:
            self._failed.happened(loop.time(), error=error.strerror)
        else:
            loop.default_exception_handler(context)
