"""The parts of RESULTS.md on what a factory asks of the service: faults, load, bad input."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tests.benchmarks import fuzz, interface, load, soak
from tests.benchmarks.attempt_file import AttemptFile, kept_attempts
from tests.benchmarks.effort import Effort
from tests.benchmarks.fuzz import FuzzFigures
from tests.benchmarks.interface import InterfaceFigures
from tests.benchmarks.load import LoadFigures
from tests.benchmarks.markdown import table
from tests.benchmarks.part import Findings, Limit
from tests.benchmarks.soak import SoakFigures, SoakRound, SoakSettings
from tests.benchmarks.tasks import Note, task_body
from workers.settings import SOLVER_COMMAND

FEWEST_SUBMISSIONS = 200.0
"""[1/s]"""
MOST_STEPS = 50
"""Of one example of what several owners do [1]."""
LONGEST_READ = 50.0
"""99 of 100 reads [ms]."""


def measure_faults(effort: Effort, note: Note, folder: Path) -> Findings:
    """Kill parts of fleets of its own while they plan, round by round: some hours, which `--most` takes apart.

    Raises:
        Unfinished: Rounds are left.
    """
    del folder
    work = {
        (place, seed): partial(_soaked, place, seed, SoakSettings(jobs, kills, postgres, _cheap_task, seed=seed))
        for place, postgres, rounds, jobs, kills in effort.soaks
        for seed in range(rounds)
    }
    if not work:
        return Findings([], [])
    with kept_attempts(effort.resumed) as kept, ProcessPoolExecutor(1, get_context("spawn")) as process:
        file = AttemptFile.of_this_code(kept, SoakRound, "soak", ("soak.py", "service_part.py"))
        rounds = file.complete(process, work, note, effort.most_attempts)
    soaks: dict[str, SoakFigures] = {}
    for (place, _), each in rounds.items():
        soaks[place] = soaks.get(place, SoakFigures()) + each.sums
    return Findings([_soak_limit(place, figures) for place, figures in soaks.items()], [_soak_section(soaks)])


def measure_load(effort: Effort, note: Note, folder: Path) -> Findings:
    """Ask a service of its own for much while both cores plan: about a minute, on an idle machine."""
    del folder
    if effort.load is None:
        return Findings([], [])
    with tempfile.TemporaryDirectory() as place_of_files:
        asked = load.measure(effort.load, SOLVER_COMMAND, Path(place_of_files), note)
    return Findings(list(_load_limits(effort.load.watchers, asked)), [_load_section(asked)])


def measure_bad_input(effort: Effort, note: Note, folder: Path) -> Findings:
    """Send bad input to services of their own, one a core: about a quarter of an hour."""
    del folder
    if not effort.fuzz_cases:
        return Findings([], [])
    with ProcessPoolExecutor(effort.processes, get_context("spawn")) as pool:
        shares = [(effort.fuzz_cases // effort.processes, number) for number in range(effort.processes)]
        # One of them tells how far it is; the others are about as far.
        abused = sum(pool.map(_fuzzed, shares), FuzzFigures())
        note(f"fuzz: {abused.cases + abused.documents} cases, {len(abused.faults)} broken promises")
        shares = [(effort.interface_examples // effort.processes, number) for number in range(effort.processes)]
        used = sum(pool.map(_explored, shares), InterfaceFigures())
    note(f"interface: {used.steps} steps, {len(used.faults)} of them not as foretold")
    limits = [_fuzz_limit(abused), _interface_limit(used)]
    return Findings(limits, [_fuzz_section(abused), _interface_section(used)])


def _soaked(place: str, seed: int, settings: SoakSettings) -> SoakRound:
    with tempfile.TemporaryDirectory() as folder:
        return SoakRound(place, seed, asdict(soak.soak(settings, Path(folder), lambda _: None)))


def _explored(share: tuple[int, int]) -> InterfaceFigures:
    """Do so many times what several owners may do; the number is what is drawn by."""
    examples, number = share
    return interface.explore_alone(examples, MOST_STEPS, number)


def _fuzzed(share: tuple[int, int]) -> FuzzFigures:
    """Send so many cases to a service of its own; the number is what they are drawn by."""
    cases, number = share

    def tell(words: str) -> None:
        if not number:
            sys.stderr.write(f"{words}, of the first process\n")

    with tempfile.TemporaryDirectory() as folder, fuzz.watched_service(Path(folder)) as target:
        fuzz.fuzz(target, cases, number, tell)
        return target.conclude()


def _cheap_task(number: int) -> dict[str, Any]:
    """Return a real task that a solver answers in less than a second: half of them search, half are too heavy."""
    few = {"hold_density": 0.25, "simulate": False}
    return task_body("ab1", **few) if number % 2 else task_body("pb1_weak_cup")


def _soak_limit(place: str, figures: SoakFigures) -> Limit:
    what = f"soak on {place}: broken promises in {figures.jobs} jobs and {figures.kills.total()} kills"
    return Limit(what, "= 0", len(figures.faults), not figures.faults)


def _soak_section(soaks: dict[str, SoakFigures]) -> str:
    rows = [
        (place, each.jobs, each.seconds / 60.0, *(each.kills[kind] for kind in ("worker", "solver")),
         each.kills["api"] + each.kills["service"], each.kills["postgres"], each.kills["fail-over"], each.attempts,
         each.unavailable)
        for place, each in soaks.items()
    ]  # fmt: skip
    head = (
        "",
        "jobs",
        "[min]",
        "workers",
        "solvers",
        "API",
        "PostgreSQL",
        "fail-overs",
        "attempts",
        "answers that had to wait",
    )
    text = (
        "Real tasks; each kill is a SIGKILL (every other one of PostgreSQL an immediate shutdown) at a random moment, "
        "in rounds with a fresh fleet each. PostgreSQL has a synchronous standby, which once in each round takes the "
        "place of a primary that was killed. "
        "Checked for each job: accepted once, ended, succeeded, one document, which is what its hash says and what is "
        "served; and that no process is left. On SQLite the API is the whole service."
    )
    faults = "".join(f"\n- {fault}" for each in soaks.values() for fault in each.faults[:20])
    return "\n\n".join(["### Killed at random", text, table(head, rows), *([faults] if faults else [])])


def _load_limits(watchers: int, asked: LoadFigures) -> Iterator[Limit]:
    rate = asked.submissions_per_second
    yield Limit("accepted submissions per second while both cores plan", "≥ 200", rate, rate >= FEWEST_SUBMISSIONS)
    yield Limit("p99 of reads while both cores plan [ms]", "≤ 50", asked.read_p99, asked.read_p99 <= LONGEST_READ)
    yield Limit("watchers told of the end", f"= {watchers}", asked.watchers, asked.watchers == watchers)


def _load_section(asked: LoadFigures) -> str:
    rows = [
        ("accepted submissions [1/s]", asked.submissions_per_second),
        ("a read, median [ms]", asked.read_p50),
        ("a read, 99th percentile [ms]", asked.read_p99),
        ("a read, longest [ms]", asked.read_max),
        (f"the first of {asked.pages} pages of 200 plans [ms]", asked.first_page),
        ("one of the last pages [ms]", asked.last_page),
        ("a search for one plan by its external_id, median [ms]", asked.search),
        ("a search that looks at all plans, median [ms]", asked.vain_search),
        ("between the first and the last watcher being told of the end [s]", asked.watcher_lag),
    ]
    return "\n\n".join(["### Asked for much", "On SQLite, as `liftwright serve` runs it.", table(("", ""), rows)])


def _fuzz_limit(abused: FuzzFigures) -> Limit:
    what = f"broken promises in {abused.cases} bad bodies and {abused.documents} changed plan documents"
    return Limit(what, "= 0", len(abused.faults), not abused.faults)


def _fuzz_section(abused: FuzzFigures) -> str:
    rows = [(str(status), number) for status, number in sorted(abused.statuses.items())]
    text = (
        "Tasks, meshes, cells and scans were posted; plan documents were to become programs. At its largest a service "
        f"took {abused.peak_mib:.0f} MiB; nothing was fetched, started or written elsewhere. Of the documents "
        f"{abused.exported} became programs: what was changed in them moves nothing."
    )
    if abused.faults:
        text = "\n".join(f"- {fault}" for fault in abused.faults[:20])
    return "\n\n".join(["### Answers", text, table(("status", "answers"), rows)])


def _interface_limit(used: InterfaceFigures) -> Limit:
    what = (
        f"answers that a model beside the service has not foretold, in {used.steps} steps of {used.examples} examples"
    )
    return Limit(what, "= 0", len(used.faults), not used.faults)


def _interface_section(used: InterfaceFigures) -> str:
    rows = [(str(status), number) for status, number in sorted(used.statuses.items())]
    text = (
        "Several owners post, look at, list, cancel and delete plans, scenes, cells, webhooks and studies, with keys "
        f"that come and go; the service is restarted {used.restarts} times over what it has kept. Behind each step all "
        "plans are as they were accepted, for everybody whose they are and for nobody else."
    )
    faults = "".join(f"\n- {fault}" for fault in used.faults)
    return "\n\n".join(["### Foretold", text, table(("status", "answers"), rows), *([faults] if faults else [])])
