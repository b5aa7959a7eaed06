"""The address that the service listens on, taken before anything that takes time."""

from __future__ import annotations

import socket
from contextlib import ExitStack
from errno import EADDRINUSE

from planners.errors import LiftwrightError


class CannotListen(LiftwrightError):
    """An address cannot be had."""

    def __init__(self, host: str, port: int, error: OSError) -> None:
        if error.errno == EADDRINUSE:
            why = "is taken by another program; choose another with --port"
        else:
            why = f"cannot be listened on: {error.strerror}; choose another with --host or --port"
        super().__init__(f"{host}:{port} {why}")


def bind(host: str, port: int) -> list[socket.socket]:
    """Return a socket for each address of a host, bound and not listening yet: who connects is refused until it is.

    Args:
        host: name or address.
        port: 0: any free one, the same for all addresses.

    Raises:
        CannotListen: Another program listens there, or nobody can.
    """
    with ExitStack() as bound:
        sockets: list[socket.socket] = []
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
            for family, kind, protocol, _, address in dict.fromkeys(found):
                each = bound.enter_context(socket.socket(family, kind, protocol))
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    each.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                each.bind((address[0], port, *address[2:]))
                port = each.getsockname()[1]
                sockets.append(each)
        except OSError as error:
            raise CannotListen(host, port, error) from error
        bound.pop_all()
        return sockets
