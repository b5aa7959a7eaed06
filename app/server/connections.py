"""Connections as they come in: no more than the process can hold, and none that says or takes nothing for long."""

from __future__ import annotations

import asyncio
import resource
import socket
from dataclasses import dataclass
from errno import EMFILE, ENFILE, ENOBUFS, ENOMEM
from http import HTTPStatus
from typing import Any

import h11
import structlog
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import Server, ServerState

from app.server.answer_headers import BROWSER_HEADERS, AnswerHeaders
from app.server.unsent import Unsent

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
    write_seconds: float
    """So long a client may take nothing of what is to be sent to it [s]."""


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


def guarded(limits: ConnectionLimits) -> tuple[type[asyncio.Protocol], type[asyncio.Protocol]]:
    """Return the protocols of one server, for HTTP and for websockets; its connections are counted together."""

    class Guarded(GuardedProtocol):
        pass

    class GuardedSocket(GuardedWebSocket):
        pass

    Guarded.limits, Guarded.refused = limits, Occasional("too many connections: the new one is closed")
    GuardedSocket.limits = limits
    return Guarded, GuardedSocket


class WatchedWriting(asyncio.Protocol):
    """What a protocol tells of bytes that have to wait for its client; before the one that it is added to."""

    unsent: Unsent

    def pause_writing(self) -> None:
        """Wait for the client."""
        super().pause_writing()
        self.unsent.begin()

    def resume_writing(self) -> None:
        """Go on."""
        super().resume_writing()
        self.unsent.end()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self.unsent.end()
        super().connection_lost(exc)


class GuardedWebSocket(WatchedWriting, WebSocketsSansIOProtocol):
    """A websocket that is closed when its client takes nothing of it for long."""

    limits: ConnectionLimits

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take over a connection on which answers may still have to be sent."""
        super().connection_made(transport)
        self.unsent = Unsent(transport, self.loop, self.limits.write_seconds)
        if transport.get_write_buffer_size():
            self.pause_writing()


class GuardedProtocol(WatchedWriting, H11Protocol):
    """HTTP/1.1 on one connection that may have to make room for another.

    Where there are too many, the one whose client has been waited for longest goes, be it for a request, for the body
    of one or to take an answer, so that whoever holds connections open keeps nobody out; a new one is refused only
    while all others are being answered.
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
        self._quiet_since = self._heard_at = self.loop.time()

    @property
    def waits_since(self) -> float | None:
        """Since when its client is waited for, by the clock of the loop; None: what comes next is ours to do [s]."""
        if self.unsent.since is not None:
            return self.unsent.since
        if self.cycle is None or self.cycle.response_complete:
            return self._quiet_since
        # Where we do not read, or have not said that we will, it is we who are waited for.
        ours = self.flow.read_paused or self.cycle.waiting_for_100_continue
        return self._heard_at if self.cycle.more_body and not ours else None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, and make room for it if there are too many."""
        super().connection_made(transport)
        self.unsent = Unsent(transport, self.loop, self.limits.write_seconds)
        self._await_head()
        if len(self.connections) > self.limits.most:
            self._make_room()

    def _make_room(self) -> None:
        # What is closed and still has something to send takes a place as well.
        there = [each for each in self.connections if not _is_gone(each)]
        if len(there) <= self.limits.most:
            return
        guarded_ones = [each for each in there if isinstance(each, GuardedProtocol) and each is not self]
        waiting = [(since, each) for each in guarded_ones if (since := each.waits_since) is not None]
        if waiting:
            min(waiting, key=lambda pair: pair[0])[1].unsent.abort()
        else:
            self.refused.happened(self.loop.time(), most=self.limits.most)
            self.unsent.abort()

    def data_received(self, data: bytes) -> None:
        """Take what has come; whoever has begun a request is to finish its head soon."""
        self._heard_at = self.loop.time()
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._stop_head_timer()
        elif self._head_timer is None:
            self._await_head()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._quiet_since = self.loop.time()
        super().on_response_complete()

    def send_400_response(self, msg: str) -> None:
        """Answer what is no request of HTTP, and close."""
        if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            # In the middle of an answer to a request before it; another one would be read as its rest.
            self.transport.close()
            return
        told = {"Content-Type": "text/plain; charset=utf-8", "Connection": "close", **BROWSER_HEADERS}
        events = [
            h11.Response(status_code=HTTPStatus.BAD_REQUEST, headers=list(told.items()), reason="Bad Request"),
            h11.Data(data=msg.encode()),
            h11.EndOfMessage(),
        ]
        self.transport.write(b"".join(self.conn.send(event) or b"" for event in events))
        self.transport.close()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand the connection over."""
        self.unsent.end()
        super().handle_websocket_upgrade(event)

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


def _is_gone(connection: asyncio.Protocol) -> bool:
    """Tell whether a connection of a server takes no place any more."""
    return isinstance(connection, GuardedProtocol | GuardedWebSocket) and connection.unsent.gone


class GuardedServer(Server):
    """Tells once in a while, and no more often, that no connection can be taken; tells requests that it stops."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen."""
        asyncio.get_running_loop().set_exception_handler(AcceptFailures())
        await super().startup(sockets)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop, once those who wait in requests for long have been told."""
        if isinstance(self.config.app, AnswerHeaders):
            self.config.app.leaving.set()
        await super().shutdown(sockets)


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
