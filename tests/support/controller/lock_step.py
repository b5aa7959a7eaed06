"""One clock for a whole cell, on which nobody runs away from whoever is late.

Whoever waits on this clock has both controllers go on, a control cycle at a time: each first takes all that it was
sent, then its cycle passes, and what it tells is waited for until `ur-rtde` has it. So a busy machine makes tests take
longer, and changes nothing of what happens in them; what is late is late by a test's wish, see `Faults`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from planners.contract.arrays import ArmName
from planners.plan.scenery import ARMS
from planners.program.schedule import Schedule
from workers.robot.arm_link import ArmLink

from .site import CYCLE, configurations
from .stand_in import StandIn, hosts, stand_ins

Told = Mapping[ArmName, Mapping[str, Any]]
"""What each controller said at the end of a cycle, see `StandIn.tell`."""
PATIENCE = 60.0
"""For `ur-rtde` to take what a controller told, on the wall's clock [s]."""
LOOK = 2e-5
"""Between two looks whether it has [s]."""


class LockStep:
    """The clock of two controllers, and whatever else goes by it; a `workers.robot.clock.Clock`."""

    def __init__(self, stand_ins: Mapping[ArmName, StandIn]) -> None:
        self.stand_ins = stand_ins
        self.physics: Callable[[float, Told], Mapping[ArmName, Mapping[str, Any]]] | None = None
        """Given the time and what controllers told, returns what it does to them in the next cycle."""
        self.told: Mapping[ArmName, float] = {}
        """Of which time what each controller told last was."""
        self._time = time.monotonic()
        self._done: Mapping[ArmName, Mapping[str, Any]] = {}
        self._planned: list[tuple[float, Callable[[], None]]] = []
        self._links: dict[ArmName, ArmLink] = {}

    def now(self) -> float:
        return self._time

    def sleep(self, seconds: float) -> None:
        for _ in range(round(seconds / CYCLE)):
            self._cycle_passes()

    def at(self, moment: float, act: Callable[[], None]) -> None:
        """Have something done as soon as the clock shows a time [s]; from any thread."""
        self._planned.append((moment, act))

    def connect(self, host: str) -> ArmLink:
        """Return a link to a controller that goes by this clock; connecting takes none of its time."""
        arm = next(arm for arm in ARMS if hosts()[arm] == host)
        with self.let_go():
            self._links[arm] = _Link(host, clock=self)
        return self._links[arm]

    def forget(self, link: ArmLink) -> None:
        """Wait for this link no more."""
        self._links = {arm: each for arm, each in self._links.items() if each is not link}

    @contextmanager
    def let_go(self) -> Iterator[None]:
        """Have controllers go by the wall's clock until the block ends, as clients do while they connect or leave."""
        for arm in self._alive:
            self.stand_ins[arm].tell(held=False)
        try:
            yield
        finally:
            self.hold()

    def hold(self) -> None:
        """Have controllers wait for this clock from now on."""
        answers = [self.stand_ins[arm].tell(held=True) for arm in self._alive]
        self._time = max([self._time, *(each["time"] for each in answers)])
        for arm in self._alive:
            self.stand_ins[arm].tell(held=True, time=self._time)

    def close(self) -> None:
        """Let go of the links: controllers answer them while they leave."""
        for arm in self._alive:
            self.stand_ins[arm].tell(held=False, silent=False, delay=0.0, jitter=0.0, loss=0.0)
        for link in list(self._links.values()):
            link.close()

    @property
    def _alive(self) -> list[ArmName]:
        return [arm for arm in ARMS if self.stand_ins[arm].is_alive]

    def _cycle_passes(self) -> None:
        self._time += CYCLE
        due = [each for each in self._planned if each[0] <= self._time]
        for each in due:
            self._planned.remove(each)
            each[1]()
        alive = self._alive
        for arm in alive:
            self.stand_ins[arm].order(cycle=True, **self._done.get(arm, {}))
        told = {arm: self.stand_ins[arm].answer() for arm in alive}
        self.told = {arm: each["told"] for arm, each in told.items()}
        wait_for(self._links, self.told)
        if self.physics is not None:
            self._done = self.physics(self._time, told)


class _Link(ArmLink):
    """A link whose controller goes by the wall's clock while it leaves, as it waits for that."""

    clock: LockStep

    def close(self) -> None:
        self.clock.forget(self)
        with self.clock.let_go():
            super().close()


def wait_for(links: Mapping[ArmName, ArmLink], told: Mapping[ArmName, float]) -> None:
    """Return once links have what each controller told last, as of its own time."""
    until = time.monotonic() + PATIENCE
    for arm, link in links.items():
        while arm in told and link.timestamp < told[arm]:
            assert time.monotonic() < until, "ur-rtde does not take what it is told"
            time.sleep(LOOK)


@contextmanager
def lock_step(schedule: Schedule) -> Iterator[LockStep]:
    """Have controllers that stand where a schedule begins, and their clock, until the block ends."""
    with stand_ins(*configurations(schedule)) as controllers:
        clock = LockStep(dict(zip(ARMS, controllers, strict=True)))
        clock.hold()
        try:
            yield clock
        finally:
            clock.close()
