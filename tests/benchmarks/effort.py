"""How much the benchmarks measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tests.benchmarks import (
    bench_balance,
    bench_collision,
    bench_handovers,
    bench_kinematics,
    bench_motion,
    bench_piles,
    bench_processes,
    bench_random_lifts,
    bench_reserve,
    bench_search,
    bench_simulation,
    bench_tool_motion,
)
from tests.benchmarks.bench_days import DaysEffort
from tests.benchmarks.bench_fairness import FairnessEffort
from tests.benchmarks.bench_many_workers import ManyWorkersCase, ManyWorkersEffort
from tests.benchmarks.cell_tasks import EXAMPLES
from tests.benchmarks.lift_variants import VARIANTS, Variant
from tests.benchmarks.load import LoadEffort
from tests.benchmarks.peers.contest import PeersEffort
from tests.benchmarks.random_piles import PILES, Pile
from tests.benchmarks.tasks import SOLVABLE, TOO_HEAVY

KERNELS: dict[str, Callable[[], dict[str, float]]] = {
    "collision": bench_collision.measure,
    "kinematics": bench_kinematics.measure,
    "balance": bench_balance.measure,
    "motion": bench_motion.measure,
    "search": bench_search.measure,
}


@dataclass(frozen=True)
class SoakEffort:
    """Fleets that are killed at random, one after the other."""

    place: str
    """What they are called in the report."""
    postgres: bool
    planned: bool
    """By the planner; otherwise by solvers that are ready at once, so that there are more kills in the same time."""
    rounds: int
    jobs: int
    """In each round."""
    kills: int
    """In each round."""


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    tasks: tuple[str, ...] = (*SOLVABLE, *TOO_HEAVY)
    solvable: tuple[str, ...] = SOLVABLE
    variants: tuple[Variant, ...] = VARIANTS
    """Of the planner, whose whole graphs are built and searched."""
    runs: int = 5
    paper_sample: int = 400
    paper_programs: int = 60
    scaled: tuple[str, ...] = ("ab1", "pb1")
    densities: tuple[tuple[float, float], ...] = bench_processes.DENSITIES
    kernels: tuple[str, ...] = tuple(KERNELS)
    service: bool = True
    lifters: int = bench_simulation.LIFTERS
    soaks: tuple[SoakEffort, ...] = (
        SoakEffort("PostgreSQL, made-up solvers", postgres=True, planned=False, rounds=14, jobs=150, kills=50),
        SoakEffort("SQLite, made-up solvers", postgres=False, planned=False, rounds=6, jobs=75, kills=25),
        SoakEffort("PostgreSQL", postgres=True, planned=True, rounds=2, jobs=60, kills=50),
        SoakEffort("SQLite", postgres=False, planned=True, rounds=2, jobs=30, kills=25),
    )
    load: LoadEffort | None = LoadEffort()  # noqa: RUF009 - frozen
    fuzz_cases: int = 100_000
    interface_examples: int = 500
    """Of whatever several owners do, on a service of each process."""
    fairness: FairnessEffort | None = FairnessEffort()  # noqa: RUF009 - frozen
    many_workers: ManyWorkersEffort | None = ManyWorkersEffort()  # noqa: RUF009 - frozen
    days: DaysEffort | None = DaysEffort()  # noqa: RUF009 - frozen
    days_jobs: int = 10_000
    """Of the days of jobs, in each place."""
    fleet: bool = True
    piles: tuple[Pile, ...] = PILES
    layouts: int = bench_piles.LAYOUTS
    """Of each pile."""
    handover_tasks: tuple[str, ...] = bench_handovers.TISSUE_TASKS
    tool_tasks: tuple[str, ...] = bench_tool_motion.TASKS
    resumed: bool = True
    """Whether attempts that a stopped run had made with the same code are not made again."""
    random_lifts: int = bench_random_lifts.LIFTS
    reserve_runs: int = bench_reserve.RUNS
    """Of each task and reserve."""
    processes: int = bench_random_lifts.PROCESSES
    """That make attempts at random lifts and at the reserve study, at a time."""
    most_attempts: int | None = None
    """Of these, to make before the run stops; the next one goes on. None: all."""
    cells: tuple[str, ...] = tuple(EXAMPLES)
    cell_tasks: int = 100
    """Of each cell."""
    cell_simulations: int = 25
    """Of these, whose plans are executed in physics."""
    study_places: int = 12
    """Of the cup along each axis of the plate, in the map of a study."""
    remedy_searches: int = 12
    """Lifts without a plan for which what helps is looked for."""
    peers: PeersEffort = PeersEffort()  # noqa: RUF009 - frozen
    frames: int = 200
    """Of each kind, for perception."""
    scan_share: float = 1.0
    """Of the largest scans that are let in."""


FULL = Effort()
QUICK = Effort(
    tasks=("ab1",), solvable=("ab1",), variants=VARIANTS[:2], runs=1, paper_sample=20, paper_programs=4, scaled=(),
    densities=(),
    kernels=("kinematics",), service=False, lifters=1, frames=5, scan_share=0.1, piles=PILES[1:2], layouts=1,
    handover_tasks=bench_handovers.TISSUE_TASKS[1:], tool_tasks=("can_stack",), resumed=False, soaks=(), load=None,
    fuzz_cases=0,
    fairness=FairnessEffort(jobs=10, places=("SQLite",), repeats=1, together=2, urgent=2, begun=10),
    many_workers=ManyWorkersEffort((ManyWorkersCase(2, 0.1, 10),), 2.0),
    days=DaysEffort(("SQLite",), 10.0, 1.0, 0.2), days_jobs=40,
    fleet=False, random_lifts=2, reserve_runs=1,
    peers=PeersEffort(motions=2, poses=20, iterated=5, programs=5, handovers=0),
    cells=("dual_ur3_tool",), cell_tasks=1, cell_simulations=1, study_places=2, remedy_searches=0,
)  # fmt: skip
"""Only shows that everything works; its figures mean nothing."""
