"""What every answer says, whoever makes it: how browsers are to treat it, and the id of its request."""

from __future__ import annotations

import asyncio
import re
import uuid

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.server.leaving import EXTENSION

REQUEST_ID = "X-Request-ID"
BROWSER_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'self'",
    "X-Frame-Options": "SAMEORIGIN",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
}
"""Of every answer that says nothing else: what is no page loads nothing, and no other site frames or guesses it."""
_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


class AnswerHeaders:
    """ASGI middleware around all others: takes the caller's request id, or makes one, and answers with it.

    Also what is answered where nothing else is any more, or not yet, passes here: errors of ours, and a start. Requests
    learn here that their server stops.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self.leaving = asyncio.Event()
        """Set by a server that stops."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        scope = {**scope, "extensions": {**scope.get("extensions", {}), EXTENSION: self.leaving}}
        given = Headers(scope=scope).get(REQUEST_ID, "")
        request_id = given if _ID.fullmatch(given) else uuid.uuid4().hex

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers[REQUEST_ID] = request_id
                for name, value in BROWSER_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        with structlog.contextvars.bound_contextvars(request_id=request_id):
            await self._app(scope, receive, send_with_headers)
