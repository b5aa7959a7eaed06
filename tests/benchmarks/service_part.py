"""The parts of RESULTS.md on what a factory asks of the service: faults, load, bad input."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tests.benchmarks import fuzz, interface, load, soak
from tests.benchmarks.attempt_file import SERVING, AttemptFile, kept_attempts
from tests.benchmarks.effort import Effort, SoakEffort
from tests.benchmarks.fuzz import FuzzFigures
from tests.benchmarks.interface import InterfaceFigures
from tests.benchmarks.load import DATABASE, SENDER, LoadEffort, LoadFigures, PostingFigures
from tests.benchmarks.markdown import Cell, table
from tests.benchmarks.part import Findings, Limit
from tests.benchmarks.soak import SoakFigures, SoakRound, SoakSettings
from tests.benchmarks.tasks import Note, task_body
from tests.support.service import FAKE_SOLVER, task

FEWEST_SUBMISSIONS = {"SQLite": 200.0, "PostgreSQL": 500.0}
"""[1/s]"""
MANY_SUBMISSIONS = 500
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
        (each.place, seed): partial(_soaked, each.place, _soak_settings(each, seed))
        for each in effort.soaks
        for seed in range(each.rounds)
    }
    if not work:
        return Findings([], [])
    with kept_attempts(effort.resumed) as kept, ProcessPoolExecutor(1, get_context("spawn")) as process:
        file = AttemptFile.of_this_code(kept, SoakRound, "soak", ("soak.py", "service_part.py"), SERVING)
        rounds = file.complete(process, work, note, effort.most_attempts)
    soaks: dict[str, SoakFigures] = {}
    for (place, _), each in rounds.items():
        soaks[place] = soaks.get(place, SoakFigures()) + each.sums
    return Findings([_soak_limit(place, figures) for place, figures in soaks.items()], [_soak_section(soaks)])


def measure_load(effort: Effort, note: Note, folder: Path) -> Findings:
    """Ask services of their own for much while both cores plan: some minutes, on an idle machine."""
    del folder
    if effort.load is None:
        return Findings([], [])
    asked = {place: load.measure(effort.load, place, note) for place in effort.load.places}
    limits = [limit for place, figures in asked.items() for limit in _load_limits(effort.load, place, figures)]
    return Findings(limits, [_load_section(asked)])


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


def _soak_settings(effort: SoakEffort, seed: int) -> SoakSettings:
    body, solver = (_cheap_task, None) if effort.planned else (_made_up_task, FAKE_SOLVER)
    return SoakSettings(effort.jobs, effort.kills, effort.postgres, body, solver, seed)


def _soaked(place: str, settings: SoakSettings) -> SoakRound:
    with tempfile.TemporaryDirectory() as folder:
        return SoakRound(place, settings.seed, soak.soak(settings, Path(folder), _noted).data())


def _noted(words: str) -> None:
    """Tell how far a round is; its process has no clock of the run."""
    sys.stderr.write(f"{words}\n")


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


def _made_up_task(number: int) -> dict[str, Any]:
    """Return a task for which a made-up solver takes from nothing to two seconds."""
    return task(external_id="now" if number % 4 == 0 else f"steps-{number % 20}")


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
        "Tasks are posted and asked for all the while, and planned; or answered by made-up solvers, which are ready at "
        "once, so that there are more kills in the same time. Each kill is a SIGKILL (every other one of PostgreSQL an "
        "immediate shutdown) at a random moment, in rounds with a fresh fleet each. PostgreSQL has a synchronous "
        "standby, which once in each round takes the place of a primary that was killed. "
        "Checked for each job: accepted once, ended, succeeded, one document, which is what its hash says and what is "
        "served; and that no process is left. On SQLite the API is the whole service."
    )
    faults = "".join(f"\n- {fault}" for each in soaks.values() for fault in each.faults[:20])
    return "\n\n".join(["### Killed at random", text, table(head, rows), *([faults] if faults else [])])


def _load_limits(effort: LoadEffort, place: str, asked: LoadFigures) -> Iterator[Limit]:
    rate, fewest = asked.posting.per_second, FEWEST_SUBMISSIONS[place]
    yield Limit(
        f"accepted submissions per second on {place} while both cores plan", f"≥ {fewest:g}", rate, rate >= fewest
    )
    read = asked.read_p99
    yield Limit(f"p99 of reads on {place} while both cores plan [ms]", "≤ 50", read, read <= LONGEST_READ)
    told, watchers = asked.watchers, effort.watchers
    yield Limit(f"watchers told of the end on {place}", f"= {watchers}", told, told == watchers)


def _load_section(asked: dict[str, LoadFigures]) -> str:
    pages = max(each.pages for each in asked.values())
    kinds: dict[str, Callable[[LoadFigures], Cell]] = {
        **dict(_posting_kinds("while both cores plan", lambda each: each.posting)),
        **dict(_posting_kinds("while nobody plans", lambda each: each.posting_alone)),
        "a read, median [ms]": lambda each: each.read_p50,
        "a read, 99th percentile [ms]": lambda each: each.read_p99,
        "a read, longest [ms]": lambda each: each.read_max,
        f"the first of {pages} pages of 200 plans [ms]": lambda each: each.first_page,
        "one of the last pages [ms]": lambda each: each.last_page,
        "a search for one plan by its external_id, median [ms]": lambda each: each.search,
        "a search that looks at all plans, median [ms]": lambda each: each.vain_search,
        "between the first and the last watcher being told of the end [s]": lambda each: each.watcher_lag,
    }
    rows = [(name, *(figure(each) for each in asked.values())) for name, figure in kinds.items()]
    text = (
        "On SQLite as `liftwright serve` runs it; on PostgreSQL as `liftwright api --api-processes 2` and two workers "
        "of one slot each, every process on this machine. The database and whoever asks share its cores with those "
        "that plan, so the processor time of an accepted task tells what more cores would do. Eight owners post in "
        "turns, over 32 connections that are kept. Reads come one after the other while both cores plan."
    )
    return "\n\n".join(["### Asked for much", text, table(("", *asked), rows)])


def _posting_kinds(
    when: str, posting: Callable[[LoadFigures], PostingFigures]
) -> Iterator[tuple[str, Callable[[LoadFigures], Cell]]]:
    """Yield what is told of posts at some time, and how it is found."""
    yield f"accepted submissions {when} [1/s]", lambda each: posting(each).per_second
    yield f"until one is answered {when}, median [ms]", lambda each: posting(each).median
    yield f"until one is answered {when}, 99th percentile [ms]", lambda each: posting(each).p99
    for process in ("API", DATABASE, SENDER):
        yield f"processor time of one {when}, {process} [ms]", lambda each, of=process: posting(each).cpu.get(of)
    yield (
        f"cores that {MANY_SUBMISSIONS} a second take {when}",
        lambda each: 1e-3 * MANY_SUBMISSIONS * posting(each).service_cpu,
    )
    yield f"share of the cores that nobody wants {when}", lambda each: posting(each).idle


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
