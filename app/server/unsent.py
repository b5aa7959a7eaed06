"""What a client has not taken yet of its answers, and for how long it has taken nothing of it."""

from __future__ import annotations

import asyncio
import fcntl
import socket
import struct
import termios
from asyncio.trsock import TransportSocket
from contextlib import suppress

LOOK_SECONDS = 1.0
"""How often it is looked whether a client takes anything [s]."""
LOOKS = 4
"""So often at least before it is let go [1]."""


class Unsent:
    """Watches what is to be sent on a connection, and aborts it when its client takes nothing of that for too long.

    Whoever takes little is waited for: an answer of some megabytes may take minutes on a slow line.
    """

    def __init__(self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop, most_seconds: float) -> None:
        self._transport, self._loop, self._most = transport, loop, most_seconds
        self._look_seconds = min(LOOK_SECONDS, most_seconds / LOOKS)
        self._left, self._since = 0, 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._aborted = False
        # Its protocol is told of the first byte that has to wait: also the last ones of an answer may do so for ever.
        transport.set_write_buffer_limits(high=0)

    @property
    def since(self) -> float | None:
        """Since when, by the clock of the loop, nothing was taken of what is to be sent; None: nothing is [s]."""
        return None if self._timer is None else self._since

    @property
    def gone(self) -> bool:
        """Whether the connection is closed, or will be without anything of its client's."""
        return self._aborted or (self._transport.is_closing() and self._timer is None)

    def begin(self) -> None:
        """Watch from now on: something has to wait."""
        if self._timer is None:
            self._left, self._since = self._bytes_left(), self._loop.time()
            self._timer = self._loop.call_later(self._look_seconds, self._look)

    def end(self) -> None:
        """Watch no longer: all is sent, or nobody is there any more."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def abort(self) -> None:
        """Close the connection at once, whatever is still to be sent."""
        self._aborted = True
        self.end()
        with suppress(OSError):
            # Else the kernel would keep for minutes what nobody takes.
            self._socket().setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._transport.abort()

    def _look(self) -> None:
        left, now = self._bytes_left(), self._loop.time()
        if left < self._left:
            self._since = now
        elif now - self._since >= self._most:
            self.abort()
            return
        self._left = left
        self._timer = self._loop.call_later(self._look_seconds, self._look)

    def _bytes_left(self) -> int:
        """Return how much the client's machine has not confirmed: what we hold, and what our kernel holds [bytes]."""
        ours = self._transport.get_write_buffer_size()
        try:
            held = fcntl.ioctl(self._socket().fileno(), termios.TIOCOUTQ, struct.pack("i", 0))
        except OSError:
            # It has been closed, or is no TCP connection.
            return ours
        return ours + struct.unpack("i", held)[0]

    def _socket(self) -> TransportSocket:
        return self._transport.get_extra_info("socket")
