"""How the HTTP server is set up, for the service as for its tests."""

from __future__ import annotations

import uvicorn
from starlette.types import ASGIApp

from app.server.answer_headers import AnswerHeaders
from app.server.connections import ConnectionLimits, connections_within, guarded, raise_file_limit
from app.settings import ServiceSettings

LONGEST_GOODBYE_SECONDS = 3
"""So long open event streams may hold up a stop [s]."""
LARGEST_WATCHER_MESSAGE_BYTES = 1 << 20
"""What a viewer's page sends are clicks and camera poses."""
BACKLOG = 128
"""Connections that the kernel holds until they are accepted [1]: as many tries the loop makes in a row."""


def server_configuration(
    app: ASGIApp, settings: ServiceSettings, goodbye_seconds: int = LONGEST_GOODBYE_SECONDS
) -> uvicorn.Config:
    """Return how a server answers with `app`; this process may open as many files as it may from now on."""
    most = connections_within(settings.max_connections, raise_file_limit())
    http, websockets = guarded(ConnectionLimits(most, settings.head_seconds, settings.write_seconds))
    return uvicorn.Config(
        AnswerHeaders(app),
        host=settings.host,
        port=settings.port,
        # The standard library's, which our handler of failed accepts knows.
        loop="asyncio",
        http=http,
        ws=websockets,
        ws_max_size=LARGEST_WATCHER_MESSAGE_BYTES,
        backlog=BACKLOG,
        # Its own would write text to stderr, whatever the logs of this process are.
        log_config=None,
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=bool(settings.trusted_proxies),
        forwarded_allow_ips=[str(network) for network in settings.trusted_proxies],
        timeout_graceful_shutdown=goodbye_seconds,
    )
