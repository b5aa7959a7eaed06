"""Which lifters the hands can follow: every task lifted behind slow, fast and sudden ones, until it fails."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import Pipe, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from time import process_time
from typing import Self

import numpy as np

from planners.contract.task_spec import PlateLiftTask, read_task
from planners.plan.plan import Plan
from planners.planning import plan
from planners.progress import silent
from planners.scene.scene import build_scene
from tests.benchmarks.attempt_file import AttemptFile, repeated
from tests.benchmarks.certified_plan import BROKEN
from tests.benchmarks.tasks import SOLVABLE, Note, task_body
from workers.simulation.lift_execution import LiftExecution, LiftFailure
from workers.simulation.settings import SimulationSettings, WinchSettings
from workers.simulation.world import LiftWorld

LIFTERS = 20
SPEEDS = (0.3, 1.0, 3.0)
"""Of the lifters that are to be followed, over the usual ones [1]."""
SWEEP = (2.0, 2.5, 3.5, 4.0, 5.0, 6.0)
"""Other speeds, until it fails [1]."""
SUDDEN = (0.3, 1.0, 2.0, 3.0)
"""Speeds from which lifters stop at once [1]."""
SUDDEN_STOP = 10.0
"""How a lifter brakes that stops at once [m/s^2]: from 0.15 m/s in 15 ms."""
PROCESSES = 2
LIFTED, NO_PLAN = "lifted", "no plan"
_MEASURING = ("bench_lifters.py",)
_SEED = 0
"""Of all that goes before the lift."""


@dataclass(frozen=True)
class LifterKind:
    """How fast a lifter is, and how it stops."""

    speed: float
    """Over that of the usual ones [1]."""
    sudden: bool = False
    """Whether it stops at once, after each of its moves."""

    def winch(self) -> WinchSettings:
        """Return how it is operated."""
        winch = WinchSettings().times(self.speed)
        return replace(winch, deceleration=SUDDEN_STOP, hold_chance=1.0) if self.sudden else winch


KINDS = (
    *(LifterKind(speed) for speed in sorted((*SPEEDS, *SWEEP))),
    *(LifterKind(speed, sudden=True) for speed in SUDDEN),
)


@dataclass(frozen=True)
class LifterRun:
    """One lift behind one lifter."""

    task: str
    speed: float
    sudden: bool
    seed: int
    outcome: str
    """Of the simulation, before the lift or in it; or that there is no plan, or that something broke."""
    cause: str = ""
    off_goal: float = 0.0
    """Mean of what both hands bore over F_goal while the lifter rose [N]."""

    @classmethod
    def broken(cls, key: tuple[str, LifterKind, int], error: BaseException) -> Self:
        """Return the run that raised what it should not raise."""
        task, kind, seed = key
        return cls(task, kind.speed, kind.sudden, seed, BROKEN, f"{type(error).__name__}: {error}")

    @property
    def key(self) -> tuple[str, LifterKind, int]:
        """Task, kind of the lifter, and seed."""
        return self.task, LifterKind(self.speed, self.sudden), self.seed

    @property
    def lifted(self) -> bool:
        """Whether the plate was lifted."""
        return self.outcome == LIFTED

    def told(self) -> str:
        """Say in a line what came of it."""
        stops = ", sudden stops" if self.sudden else ""
        return f"{self.task}, {self.speed:g} × speed{stops}, seed {self.seed}: {self.outcome}. {self.cause}".strip()


@dataclass(frozen=True)
class LifterFigures:
    """All lifts of one task behind one kind of lifter."""

    task: str
    kind: LifterKind
    runs: Sequence[LifterRun]
    """By seed."""

    @property
    def lifted(self) -> int:
        """How many lifters were followed to the end."""
        return sum(run.lifted for run in self.runs)

    @property
    def outcomes(self) -> Counter[str]:
        """How often what came of it."""
        return Counter(run.outcome for run in self.runs)


def measure(
    note: Note,
    kept: Path,
    tasks: Sequence[str] = SOLVABLE,
    lifters: int = LIFTERS,
    processes: int = PROCESSES,
    most: int | None = None,
) -> list[LifterFigures]:
    """Lift the plate of each task behind so many lifters of each kind.

    A process plans a task once and executes its plan once; from there it lifts the plate behind one lifter after the
    other.

    Args:
        note: told of each that is done.
        kept: folder of lifts, which are not repeated while the code is the same.
        tasks: shipped ones.
        lifters: of each kind, seeds from 0.
        processes: at a time.
        most: how many lifts to make before this stops; None: all.

    Raises:
        Unfinished: more than `most` are missing.
    """
    file = AttemptFile.of_this_code(kept, LifterRun, "lifters", _MEASURING)
    cases = [(task, kind) for task in tasks for kind in KINDS]
    done = repeated(file, _run, cases, lifters, processes, lambda told: note(f"lifters: {told}"), most)
    return [LifterFigures(*case, each) for case, each in zip(cases, done, strict=True)]


def _run(task: str, kind: LifterKind, seed: int) -> LifterRun:
    key = (task, kind.speed, kind.sudden, seed)
    prepared = _prepared(task)
    if not isinstance(prepared, LiftExecution):
        return LifterRun(*key, *prepared)
    receiver, sender = Pipe(duplex=False)
    # A copy of this process, with the plate hanging in its physics, lifts it; here it hangs on for the next lifter.
    copy = get_context("fork").Process(target=_lift, args=(prepared, kind.winch(), seed, sender))
    copy.start()
    sender.close()
    try:
        outcome, cause, off_goal = receiver.recv()
    except EOFError:
        raise RuntimeError("the lift ended without an answer") from None
    finally:
        copy.join()
    return LifterRun(*key, outcome, cause, off_goal)


def _lift(execution: LiftExecution, winch: WinchSettings, seed: int, sender: Connection) -> None:
    failure = execution.lift_behind(winch, seed)
    lift, recorder = execution.lift, execution.recorder
    assert lift is not None
    rising = recorder.column("lifter velocity", lift.begin) > 0.0
    borne = recorder.column("both hands", lift.begin)[rising]
    off = float(np.mean(borne)) - lift.forces.both if len(borne) else 0.0
    sender.send((*_ending(failure), off))


@cache
def _prepared(name: str) -> LiftExecution | tuple[str, str]:
    """Return the plan of a shipped task executed until the lifter rises, once in this process; or what hindered it."""
    task = read_task(task_body(name))
    assert isinstance(task, PlateLiftTask)
    scene, settings = build_scene(task), SimulationSettings()
    found = Plan.read(plan(task, scene, silent, process_time).write())
    if found.outcome != "solved":
        return NO_PLAN, found.explanation.summary
    world = ExitStack().enter_context(LiftWorld(scene, settings))
    execution = LiftExecution(found, scene, world, settings, np.random.default_rng(_SEED), scene)
    failure = execution.prepare()
    return execution if failure is None else _ending(failure)


def _ending(failure: LiftFailure | None) -> tuple[str, str]:
    return (LIFTED, "") if failure is None else (failure.outcome, failure.cause)
