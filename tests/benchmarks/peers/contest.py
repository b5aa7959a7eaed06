"""The same cases given to us and to what a user would pick instead, and how each fared."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from time import process_time
from typing import TypeVar

import numpy as np

from planners.geometry.pose import Array

Samples = tuple[Array, Array, Array, Array]
"""Of a motion: times (n,), positions, velocities and accelerations (n, k)."""
Case = TypeVar("Case")
Answer = TypeVar("Answer")

LARGEST_CAUSE = 160
"""Characters of an error that are told."""


@dataclass(frozen=True)
class PeersEffort:
    """How many cases are given to all."""

    motions: int = 40
    """Of each arm."""
    poses: int = 2000
    iterated: int = 200
    """Of the poses, by iteration."""
    programs: int = 100
    handovers: int = 5
    """How often the handover is planned; 0: not at all."""


@dataclass(frozen=True)
class Entry:
    """How one library fared on the cases of a contest, in their order."""

    name: str
    seconds: Sequence[float]
    """CPU time of each case, those without an answer included."""
    solved: Sequence[bool]
    """Whether there is an answer that our own check lets pass."""
    sizes: Sequence[float] = ()
    """Of the answers: a length, a duration or a number; NaN where there is none. Empty: answers have no size."""
    claimed: Sequence[bool] = ()
    """Whether there is an answer at all. Empty: as `solved`."""

    @property
    def success(self) -> float:
        """Share of the cases that are solved."""
        return float(np.mean(self.solved))

    @property
    def refused(self) -> int:
        """Number of answers that our own check does not let pass."""
        return sum(self.claimed) - sum(self.solved) if self.claimed else 0

    @property
    def median_size(self) -> float | None:
        """Median of the sizes there are, if any."""
        sizes = np.array(self.sizes)
        known = sizes[np.isfinite(sizes)]
        return float(np.median(known)) if known.size else None

    def milliseconds(self, percentile: float) -> float:
        """Return a percentile of the times."""
        return 1e3 * float(np.percentile(self.seconds, percentile))

    def of(self, cases: Sequence[int]) -> Entry:
        """Return what became of some of the cases."""
        members = (self.seconds, self.solved, self.sizes, self.claimed)
        return Entry(self.name, *([each[i] for i in cases] if each else () for each in members))


@dataclass(frozen=True)
class NotMeasured:
    """A library that could not be measured."""

    name: str
    reason: str


Peer = Entry | NotMeasured


@dataclass(frozen=True)
class Contest:
    """We and others on the same cases."""

    what: str
    ours: Entry
    peers: Sequence[Peer]
    size: str = ""
    """What `Entry.sizes` are, with their unit; nothing if there are none."""
    less_is_better: bool = True
    """Whether a small size is a good one."""
    text: str = ""
    """How the peers were used, and what the size of an answer is."""

    @property
    def measured(self) -> list[Entry]:
        """The peers that were."""
        return [peer for peer in self.peers if isinstance(peer, Entry)]

    def time_ratio(self, peer: Entry) -> float:
        """Return its median time over ours."""
        return peer.milliseconds(50) / self.ours.milliseconds(50)

    def size_ratio(self, peer: Entry) -> float | None:
        """Return the median of its size over ours where both have one; None where there is no such case."""
        if not (peer.sizes and self.ours.sizes):
            return None
        ratios = np.array(peer.sizes) / np.array(self.ours.sizes)
        both = np.isfinite(ratios)
        return float(np.median(ratios[both])) if both.any() else None


def answers_of(run: Callable[[Case], Answer], cases: Iterable[Case]) -> tuple[list[Answer], list[float]]:
    """Return the answer to each case, and the CPU time that it took [s]."""
    answers, seconds = [], []
    for case in cases:
        begun = process_time()
        answers.append(run(case))
        seconds.append(process_time() - begun)
    return answers, seconds


def tried(name: str, run: Callable[[], Entry]) -> Peer:
    """Return how a library fared, or that it is not installed. `run` imports it."""
    try:
        return run()
    except ImportError as error:
        return NotMeasured(name, f"it cannot be imported ({told(error)}); the extra `peers` has it")


def told(error: Exception) -> str:
    """Return an error in one short line."""
    lines = str(error).strip().splitlines()
    return lines[-1][:LARGEST_CAUSE].replace("|", "/") if lines else type(error).__name__
