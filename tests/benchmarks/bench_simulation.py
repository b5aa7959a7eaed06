"""What the leader-follower controller is worth: every task lifted after random lifters, with and without it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from statistics import fmean, median
from time import process_time

from planners.contract.task_spec import PlateLiftTask, read_task
from planners.plan.plan import Plan
from planners.plan.simulation import LiftSimulation, SimulatedLift
from planners.planning import plan
from planners.progress import silent
from planners.scene.scene import build_scene
from tests.benchmarks.tasks import SOLVABLE, Note, task_body
from tests.simulation.node_tolerance import largest_excess
from workers.simulation.settings import SimulationSettings
from workers.simulation.simulate import simulate_lift

LIFTERS = 20
PROCESSES = 2
DRAWN = 0
"""The lifter whose curves are drawn; which one was decided before any was seen."""


@dataclass(frozen=True, eq=False)
class LiftFigures:
    """One plan simulated with one lifter."""

    seed: int
    controlled: LiftSimulation
    blind: LiftSimulation
    """Without the controller."""
    cpu_of_motion: float
    """CPU time over the simulated time, with the controller [1]."""


@dataclass(frozen=True, eq=False)
class SimulationFigures:
    """One task over all lifters."""

    task: str
    cup_force: float
    """The most that the cup is planned with [N]."""
    lifts: Sequence[LiftFigures]
    """By lifter, the first from seed 0."""

    @property
    def lifted(self) -> int:
        """How many lifters were followed to the end."""
        return self.outcomes["lifted"]

    @property
    def outcomes(self) -> Counter[str]:
        """How often the controlled lifts ended how."""
        return Counter(lift.controlled.outcome for lift in self.lifts)

    @property
    def blind_outcomes(self) -> Counter[str]:
        """Likewise without the controller."""
        return Counter(lift.blind.outcome for lift in self.lifts)

    @property
    def height(self) -> float:
        """How far up the plate came in the lowest of the lifts that did not fail [m]."""
        lifts = [each.controlled.lift for each in self.lifts if each.controlled.outcome == "lifted"]
        return min((lift.height for lift in lifts if lift is not None), default=0.0)

    @property
    def reachable(self) -> float:
        """How far up both arms can go, least of all lifters [m]."""
        return min((lift.reachable_height for lift in self._prepared), default=0.0)

    @property
    def end_of_reach(self) -> str:
        """What ends the way up."""
        return ", ".join(sorted({lift.end_of_reach for lift in self._prepared}))

    @property
    def reserve(self) -> float:
        """Part of the cup's largest force that F_goal keeps back, least of all lifters [1]."""
        return min((lift.cup_reserve for lift in self._prepared), default=0.0)

    @property
    def differences(self) -> list[float]:
        """Simulated force less planned, worst bearer of each node of each lifter [N]."""
        return [node.largest_difference for lift in self.lifts for node in lift.controlled.manipulation.nodes]

    @property
    def difference_of_tolerance(self) -> float:
        """Largest difference over what the simulation is told to do wrong explains of it [1]."""
        compared = [lift.controlled.manipulation for lift in self.lifts]
        return max((largest_excess(forces) for forces in compared if forces.nodes), default=0.0)

    @property
    def dips(self) -> tuple[float, float, float]:
        """How often and how long [s] the hands' sum was below the minimum, means of all lifts; the longest [s]."""
        dips = [lift.controlled.dips for lift in self.lifts]
        seconds = [each.seconds for each in dips]
        return fmean(each.count for each in dips), fmean(seconds), max(seconds)

    @property
    def cpu_of_motion(self) -> tuple[float, float]:
        """CPU time over simulated time: median, and most [1]."""
        costs = [lift.cpu_of_motion for lift in self.lifts]
        return median(costs), max(costs)

    @property
    def drawn(self) -> LiftSimulation:
        """The controlled simulation whose curves are drawn."""
        return self.lifts[DRAWN].controlled

    @property
    def _prepared(self) -> list[SimulatedLift]:
        return [each.controlled.lift for each in self.lifts if each.controlled.lift is not None]


def measure(note: Note, tasks: Sequence[str] = SOLVABLE, lifters: int = LIFTERS) -> list[SimulationFigures]:
    """Plan every task once, and simulate its plan with many lifters in a few processes."""
    lifts: dict[str, list[LiftFigures]] = {name: [] for name in tasks}
    with ProcessPoolExecutor(PROCESSES, mp_context=get_context("spawn")) as processes:
        jobs = {}
        for name in tasks:
            note(f"simulation: planning {name}")
            task = _task(name)
            planned = plan(task, build_scene(task), silent, process_time).write()
            jobs |= {processes.submit(partial(_lift, name, planned, seed)): name for seed in range(lifters)}
        for done in as_completed(jobs):
            lifts[jobs[done]].append(done.result())
            note(f"simulation: {jobs[done]}, {len(lifts[jobs[done]])} of {lifters} lifters")
    in_order = {name: sorted(each, key=lambda lift: lift.seed) for name, each in lifts.items()}
    return [SimulationFigures(name, _task(name).cup.max_force, in_order[name]) for name in tasks]


def _lift(name: str, planned: bytes, seed: int) -> LiftFigures:
    found, scene, settings = Plan.read(planned), build_scene(_task(name)), SimulationSettings()
    begun = process_time()
    controlled = simulate_lift(found, scene, silent, seed, settings)
    spent = process_time() - begun
    blind = simulate_lift(found, scene, silent, seed, replace(settings, controlled=False))
    return LiftFigures(seed, controlled, blind, spent / controlled.time)


def _task(name: str) -> PlateLiftTask:
    task = read_task(task_body(name))
    assert isinstance(task, PlateLiftTask)
    return task
