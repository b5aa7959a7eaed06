"""RTDE, protocol version 2, as Universal Robots' guide to the Real-Time Data Exchange describes it.

A package is its length (with this head), one letter that tells what it is, and what it carries; all big-endian.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

HEAD = struct.Struct(">HB")
VERSION = (5, 12, 0, 0)
"""Of the controller: an e-Series' PolyScope."""
FORMATS = {
    "VECTOR6D": "6d", "VECTOR3D": "3d", "DOUBLE": "d", "INT32": "i", "UINT32": "I", "UINT64": "Q", "UINT8": "B",
    "BOOL": "?", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
Value = float | int | tuple[float, ...]


@dataclass(frozen=True)
class Variable:
    """One output: its RTDE type, and what reads it."""

    type: str
    read: Callable[[], Value]


class RtdeSession:
    """One client that is connected: what it wants to be sent, what it may set."""

    def __init__(
        self,
        connection: socket.socket,
        outputs: Mapping[str, Variable],
        input_types: Mapping[str, str],
        write: Callable[[str, Value], None],
        rate: float,
    ) -> None:
        self.connection = connection
        self._outputs, self._input_types, self._write, self._rate = outputs, input_types, write, rate
        self._received = b""
        self._recipes: list[list[tuple[str, struct.Struct]]] = []
        self._sent: list[Variable] = []
        self._format = struct.Struct(">B")
        self._every, self._cycle = 1, 0
        self._last = b""
        self.started = False

    def take(self, data: bytes) -> None:
        """Answer every whole package of what came.

        Raises:
            ValueError: this is not RTDE.
        """
        self._received += data
        while len(self._received) >= HEAD.size:
            size, letter = HEAD.unpack_from(self._received)
            if size < HEAD.size:
                raise ValueError("a package is at least its head")
            if len(self._received) < size:
                return
            body, self._received = self._received[HEAD.size : size], self._received[size:]
            self._answer(chr(letter), body)

    def cycle_ended(self) -> bytes | None:
        """Return the package that is wanted; None: its turn has not come."""
        self._cycle += 1
        if not self.started or not self._sent or self._cycle % self._every:
            return None
        values: list[float | int] = []
        for variable in self._sent:
            value = variable.read()
            if isinstance(value, tuple):
                values += value
            else:
                values.append(value)
        return _package("U", self._format.pack(1, *values))

    def send(self, package: bytes) -> None:
        """Send a package.

        Raises:
            BlockingIOError: the client does not read.
        """
        if self.connection.send(package) != len(package):
            raise BlockingIOError("the client does not read")
        if package[2:3] == b"U":
            self._last = package

    def repeat(self) -> None:
        """Send once more what was told last, if anything was."""
        if self._last:
            self.send(self._last)

    def _send(self, letter: str, body: bytes) -> None:
        self.send(_package(letter, body))

    def _answer(self, letter: str, body: bytes) -> None:
        if letter == "V":
            self._send("V", bytes([body == b"\x00\x02"]))
        elif letter == "v":
            self._send("v", struct.pack(">IIII", *VERSION))
        elif letter == "O":
            self._send("O", self._setup_outputs(body))
        elif letter == "I":
            self._send("I", self._setup_inputs(body))
        elif letter in "SP":
            self.started = letter == "S"
            self._send(letter, b"\x01")
        elif letter == "U":
            self._set(body)
        elif letter != "M":
            raise ValueError(f"RTDE has no package {letter!r}")

    def _setup_outputs(self, body: bytes) -> bytes:
        (frequency,) = struct.unpack_from(">d", body)
        names = [name for name in body[8:].decode().split(",") if name]
        types = [self._outputs[name].type if name in self._outputs else "NOT_FOUND" for name in names]
        if "NOT_FOUND" not in types:
            self._sent = [self._outputs[name] for name in names]
            self._format = struct.Struct(">B" + "".join(FORMATS[kind] for kind in types))
            self._every = max(1, round(self._rate / frequency)) if frequency > 0 else 1
        return b"\x01" + ",".join(types).encode()

    def _setup_inputs(self, body: bytes) -> bytes:
        names = [name for name in body.decode().split(",") if name]
        types = [self._input_types.get(name, "NOT_FOUND") for name in names]
        if "NOT_FOUND" in types:
            return b"\x00" + ",".join(types).encode()
        self._recipes.append(
            [(name, struct.Struct(">" + FORMATS[kind])) for name, kind in zip(names, types, strict=True)]
        )
        return bytes([len(self._recipes)]) + ",".join(types).encode()

    def _set(self, body: bytes) -> None:
        if not 1 <= body[0] <= len(self._recipes):
            raise ValueError(f"there is no recipe {body[0]}")
        at = 1
        for name, form in self._recipes[body[0] - 1]:
            values = form.unpack_from(body, at)
            at += form.size
            self._write(name, values[0] if len(values) == 1 else values)


def _package(letter: str, body: bytes) -> bytes:
    return HEAD.pack(HEAD.size + len(body), ord(letter)) + body


@dataclass
class LineSession:
    """A client that sends lines, or scripts, and may get lines back."""

    connection: socket.socket
    received: bytes = b""
    replies: list[str] = field(default_factory=list)
