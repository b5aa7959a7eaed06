"""What can be wrong with a request to the planners. One root; errors are made from facts and name valid choices.

A plan that cannot be found is not an error: it is a result with reasons (`planners.graph.rejections`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import TypeVar

T = TypeVar("T")


class LiftwrightError(Exception):
    """Anything the planners refuse; the message is a sentence for a person."""


class PlanningCancelled(LiftwrightError):
    """The caller asked for the work to stop."""


class PlanningFaultError(LiftwrightError):
    """A fault of the planner itself: it would go on for ever, or contradict itself."""


@dataclass(frozen=True)
class AssetFault:
    """One thing that is wrong with the files of a cell."""

    detail: str
    file: str = ""
    """In which it is; empty: in none, or in that which is looked at."""
    pointer: str = ""
    """RFC 6901 path of the offending member of that file."""
    allowed: tuple[str, ...] = ()
    """The valid choices, where they can be listed."""

    def __str__(self) -> str:
        told = ": ".join(part for part in (self.file, self.pointer, self.detail) if part)
        return f"{told} (one of: {', '.join(self.allowed)})" if self.allowed else told


class AssetError(LiftwrightError):
    """Files of a cell are missing, unreadable or say something impossible."""

    def __init__(self, *faults: AssetFault | str) -> None:
        """A text is the detail of a fault whose file and member whoever asked for it adds."""
        self.faults = tuple(AssetFault(fault) if isinstance(fault, str) else fault for fault in faults)
        super().__init__("\n".join(map(str, self.faults)))

    def at(self, file: str, pointer: str = "") -> AssetError:
        """Return the error with a member of a file as the place of those faults that have none.

        A fault that has a pointer, but no file, keeps it, and is of this file.
        """
        return AssetError(
            *(
                fault if fault.file else replace(fault, file=file, pointer=fault.pointer or pointer)
                for fault in self.faults
            )
        )


class AssetFaults:
    """Gathers what is wrong with several members, so that all of it is told at once."""

    def __init__(self) -> None:
        self._faults: list[AssetFault] = []

    @contextmanager
    def at(self, file: str, pointer: str = "") -> Iterator[None]:
        """Gather what is raised inside; faults without a place are those of this member of this file."""
        try:
            yield
        except AssetError as error:
            self._faults += error.at(file, pointer).faults

    def add(self, detail: str, file: str = "", pointer: str = "") -> None:
        """Add one."""
        self._faults.append(AssetFault(detail, file, pointer))

    def take(self, faults: Iterable[AssetFault]) -> None:
        """Add several as they are."""
        self._faults += faults

    @property
    def found(self) -> tuple[AssetFault, ...]:
        """All that were gathered, each once."""
        return tuple(dict.fromkeys(self._faults))

    def raise_any(self) -> None:
        """Raise an error of all that were gathered, each once; do nothing if there are none.

        Raises:
            AssetError: There are some.
        """
        if self._faults:
            raise AssetError(*self.found)


def nearest(name: str, choices: Iterable[str]) -> str:
    """Ask whether the valid choice that is nearest to a name was meant, to end a sentence; empty if none is near."""
    near = get_close_matches(name, list(choices), n=1)
    return f"; did you mean {near[0]}?" if near else ""


class SceneError(LiftwrightError):
    """The things a task names cannot stand as it says.

    `pointer` is the RFC 6901 path of the offending member in the TaskSpec, `allowed` its valid choices, if any;
    `pointers` are all of them where several members do not go together.
    """

    def __init__(
        self, pointer: str, detail: str, allowed: list[str] | None = None, *, others: Iterable[str] = ()
    ) -> None:
        self.pointer, self.detail, self.allowed = pointer, detail, allowed
        self.pointers = (pointer, *others)
        self.more: tuple[SceneError, ...] = ()
        """What else cannot stand."""
        super().__init__(f"{pointer or '/'}: {detail}")

    @property
    def all(self) -> tuple[SceneError, ...]:
        """Everything that cannot stand, in the order in which it was found."""
        return (self, *self.more)


class SceneFaults:
    """Gathers what cannot stand as a task says, so that all of it is told at once."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, ...], SceneError] = {}
        """By all members that an error points at, of which it is told once: an arm that is in a box is so with many
        links."""

    def add(self, error: SceneError) -> None:
        """Add what an error tells of, unless as much is known of the same members, or one of them must change anyway.

        Whatever a cup touches that is beside its plate, nobody wants to know.
        """
        for each in error.all:
            if not any((pointer,) in self._found for pointer in each.pointers):
                self._found.setdefault(each.pointers, each)

    def __len__(self) -> int:
        """Return how much is known so far."""
        return len(self._found)

    def tells_of(self, *pointers: str | None) -> bool:
        """Whether it is known of these members, in this order, that they do not go together."""
        return pointers in self._found

    def tried(self, make: Callable[[], T]) -> T | None:
        """Return what is made; None if it cannot stand, which is added."""
        try:
            return make()
        except SceneError as error:
            self.add(error)
            return None

    def raise_any(self) -> None:
        """Raise an error of all that were gathered; do nothing if there are none.

        Raises:
            SceneError: There are some.
        """
        if self._found:
            raise self.error()

    def error(self) -> SceneError:
        """Return an error of all that were gathered, of which there is one at least."""
        first, *others = self._found.values()
        first.more = tuple(others)
        return first
