"""Whoever webhooks lead to: keeps what it is sent, and answers by the path."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


@dataclass(eq=False)
class Receiver:
    """An MES: keeps what it is sent, and answers by the path."""

    address: str = ""
    got: list[tuple[str, dict[str, str], bytes]] = field(default_factory=list)

    def at(self, path: str) -> list[tuple[dict[str, str], bytes]]:
        """Headers and bodies of what came to a path."""
        return [(headers, body) for where, headers, body in self.got if where == path]


@contextmanager
def running_receiver() -> Iterator[Receiver]:
    """Listen on a free port for as long as the context is open."""
    receiver = Receiver()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            earlier = len(receiver.at(self.path))
            receiver.got.append((self.path, {name.lower(): value for name, value in self.headers.items()}, body))
            status = {"/gone": 410, "/elsewhere": 302, "/never": 500, "/later": 503 if earlier < 2 else 204}
            self.send_response(status.get(self.path, 204))
            if self.path == "/elsewhere":
                self.send_header("Location", f"{receiver.address}/trap")
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            return

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    receiver.address = f"http://127.0.0.1:{server.server_port}"
    yield receiver
    server.shutdown()
    thread.join()
    server.server_close()
