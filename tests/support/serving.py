"""The service in a thread of the test itself: what really goes over the wire, with settings of the test's own."""

from __future__ import annotations

import faulthandler
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from starlette.types import ASGIApp

from app.create_app import create_app
from app.server.configuration import server_configuration
from app.server.connections import GuardedServer
from app.settings import ServiceSettings


@contextmanager
def served(settings: ServiceSettings, *, with_worker: bool = True) -> Iterator[str]:
    """Serve on a free port for as long as the context is open, and yield the address.

    Not for longer than needed: the job engine draws random numbers, which tests of properties must not see.
    """
    with answering(create_app(settings, with_worker=with_worker), settings) as address:
        yield address


@contextmanager
def answering(app: ASGIApp, settings: ServiceSettings) -> Iterator[str]:
    """Answer with an application on a free port for as long as the context is open, and yield the address."""
    config = server_configuration(app, settings.model_copy(update={"port": 0}), goodbye_seconds=1)
    server = GuardedServer(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        assert thread.is_alive()
        time.sleep(0.02)
    try:
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(timeout=30)
        if thread.is_alive():
            # What it still waits for.
            faulthandler.dump_traceback(2)
        assert not thread.is_alive()
