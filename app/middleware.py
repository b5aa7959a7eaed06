"""What all requests to the service pass: HEAD wherever there is GET, and the log.

A request that could be read in two ways is refused here.
"""

from __future__ import annotations

import time

import anyio
import structlog
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.errors import TwoLengths, error_response
from app.metrics import REQUEST_SECONDS

UNKNOWN_ROUTE = "none"
METHODS = frozenset({"CONNECT", "DELETE", "GET", "HEAD", "OPTIONS", "PATCH", "POST", "PUT", "TRACE"})
OTHER_METHOD = "other"
"""Counts together what anybody may make up: each label is kept for as long as the process lives."""
LONGEST_METHOD = 20
"""In the log [characters]."""
LEFT = 499
"""Stands in logs and metrics where the client has gone before it was answered; it is never sent (nginx's word)."""
PROBES = ("/livez", "/readyz", "/metrics")
"""Asked every few seconds: measured, and not logged while all is well."""

log = structlog.get_logger(__name__)


class OneLength:
    """ASGI middleware: refuses a body whose end is told in two ways: a proxy could read other requests than we.

    RFC 9112, section 6.3, allows to answer it with 400 and to close the connection.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        headers = Headers(scope=scope) if scope["type"] == "http" else {}
        if "content-length" in headers and "transfer-encoding" in headers:
            await error_response(TwoLengths())(scope, receive, send)
        else:
            await self._app(scope, receive, send)


class HeadAsGet:
    """ASGI middleware; the body is not even made where it would be a stream."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        with anyio.CancelScope() as rest:

            async def send_start(message: Message) -> None:
                if message["type"] == "http.response.start":
                    await send(message)
                    await send({"type": "http.response.body", "body": b""})
                    rest.cancel()

            await self._app({**scope, "method": "GET"}, receive, send_start)


class RequestLog:
    """ASGI middleware: logs and measures each request."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun, status = time.perf_counter(), None

        async def send_noting(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, send_noting)
        except ClientDisconnect:
            # Nobody is there to be answered, and nothing is wrong with us.
            status = LEFT
        finally:
            _tell(scope, 500 if status is None else status, time.perf_counter() - begun)


def _tell(scope: Scope, status: int, seconds: float) -> None:
    route = getattr(scope.get("route"), "path", UNKNOWN_ROUTE)
    method = scope["method"] if scope["method"] in METHODS else OTHER_METHOD
    REQUEST_SECONDS.labels(method, route, str(status)).observe(seconds)
    if scope["path"] in PROBES and status < 400:
        return
    plan_id = scope.get("path_params", {}).get("plan_id")
    told = log if plan_id is None else log.bind(job_id=plan_id)
    told.info(
        "request",
        method=scope["method"][:LONGEST_METHOD],
        # Never the query: it may hold what its sender would not want to read here.
        path=scope["path"][:200],
        status=status,
        milliseconds=round(1000.0 * seconds, 1),
    )
