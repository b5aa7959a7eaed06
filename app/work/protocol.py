"""What processes of a workbench answer. They are of this service, so that what they say is read as it is."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import Any, Self

from planners.errors import LiftwrightError

LENGTH_BYTES = 8
"""An answer begins with how long it is, so that one that was cut off is known."""
LONGEST_NAME = 4096
"""Of a module [bytes]."""


@dataclass(frozen=True)
class WorkDone:
    """The work was done."""

    result: Any


@dataclass(frozen=True)
class WorkRefused:
    """What is wrong with what was given, as the work said it.

    An error is made from facts, of which its message alone does not tell.
    """

    kind: type[LiftwrightError]
    said: tuple[Any, ...]
    members: dict[str, Any]

    @classmethod
    def of(cls, error: LiftwrightError) -> Self:
        """Return what an error says."""
        return cls(type(error), error.args, error.__dict__)

    def error(self) -> LiftwrightError:
        """Return the error as it was raised."""
        made = self.kind.__new__(self.kind, *self.said)
        made.__dict__.update(self.members)
        return made


@dataclass(frozen=True)
class WorkOutgrown:
    """The work took more memory than it may."""


@dataclass(frozen=True)
class WorkFailed:
    """The work met an error of its own."""

    error: str
    traceback: str


WorkAnswer = WorkDone | WorkRefused | WorkOutgrown | WorkFailed


def packed(thing: object) -> bytes:
    """Return bytes from which `unpacked` makes an equal thing in another process of this service."""
    return pickle.dumps(thing, pickle.HIGHEST_PROTOCOL)


def unpacked(content: bytes | bytearray) -> Any:
    """Return what was packed by a process of this service: nothing else comes to where this is called."""
    return pickle.loads(content)  # noqa: S301 - over a socket that nobody else has
