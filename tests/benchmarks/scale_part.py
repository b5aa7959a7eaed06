"""The parts of RESULTS.md on a service that many use for long: fairness, many workers on one database, days of jobs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tests.benchmarks import bench_days, bench_fairness, bench_many_workers
from tests.benchmarks.bench_days import DaysEffort, DaysFigures
from tests.benchmarks.bench_fairness import (
    ALONE,
    ALONE_TOGETHER,
    JOB_SECONDS,
    ONE,
    SLOTS,
    TOGETHER,
    URGENT,
    FairnessFigures,
)
from tests.benchmarks.bench_many_workers import KINDS, ManyWorkersFigures
from tests.benchmarks.effort import Effort
from tests.benchmarks.markdown import Cell, table
from tests.benchmarks.part import Findings, Limit
from tests.benchmarks.tasks import Note
from tests.support.postgres import BINARIES
from workers.settings import WorkerSettings

LONGEST_EXTRA_SECONDS = JOB_SECONDS + WorkerSettings.model_fields["poll_seconds"].default
"""One job of somebody else's, and one look at the queue [s]."""
MOST_GROWTH = 5.0
"""Of memory, from the first tenth of the jobs to the end [%]."""
MOST_DATABASE_GROWTH = 5.0
"""Of the database, in the last quarter of the jobs, while what is kept stays as much [%]."""
FLEET = 1000
"""Workers that are reckoned with."""


def measure_fairness(effort: Effort, note: Note, folder: Path) -> Findings:
    """Post one owner's job behind a thousand of another's: about four minutes."""
    del folder
    if effort.fairness is None:
        return Findings([], [])
    places = [place for place in effort.fairness.places if place == "SQLite" or BINARIES is not None]
    found = {place: bench_fairness.measure(effort.fairness, postgres=place != "SQLite", note=note) for place in places}
    return Findings(list(fairness_limits(found)), [fairness_section(found)])


def measure_many_workers(effort: Effort, note: Note, folder: Path) -> Findings:
    """Run up to thirty workers without solvers on one PostgreSQL, as many as two cores bear: about four minutes."""
    del folder
    if effort.many_workers is None or BINARIES is None:
        return Findings([], [])
    found = bench_many_workers.measure(effort.many_workers, note)
    return Findings(list(many_workers_limits(found)), many_workers_sections(found))


def measure_days(effort: Effort, note: Note, folder: Path) -> Findings:
    """Plan thousands of tasks with made-up solvers, and delete them soon: about ten minutes on an idle machine."""
    del folder
    if effort.days is None:
        return Findings([], [])
    places = [place for place in effort.days.places if place == "SQLite" or BINARIES is not None]
    found = {place: bench_days.measure(effort.days, place, effort.days_jobs, note) for place in places}
    return Findings(list(days_limits(found)), [days_section(found, effort.days)])


def fairness_limits(found: Mapping[str, FairnessFigures]) -> Iterator[Limit]:
    """Yield what docs/service.md promises: others wait for one job, and an owner's priorities are kept."""
    for place, each in found.items():
        overtaken = max(each.overtaken(ONE), each.overtaken(URGENT))
        yield Limit(f"{place}: jobs of many begun before another owner's one", "≤ 1", overtaken, overtaken <= 1)
        extra = max(each.median(ONE), each.median(URGENT)) - each.median(ALONE)
        yield Limit(
            f"{place}: wait behind {each.jobs:,} jobs, longer than on an empty queue, medians [s]",
            f"≤ {LONGEST_EXTRA_SECONDS:g}", extra, extra <= LONGEST_EXTRA_SECONDS,
        )  # fmt: skip
        yield Limit(
            f"{place}: jobs begun before one of higher priority of their owner", "= 0", each.inversions,
            not each.inversions,
        )  # fmt: skip


def fairness_section(found: Mapping[str, FairnessFigures]) -> str:
    """Return what was measured."""
    text = (
        f"Two owners with a key each, jobs of {JOB_SECONDS:g} s by made-up solvers, {SLOTS} at a time: one process on "
        "SQLite; an API and two workers on PostgreSQL. One owner posts many jobs with priorities 0 to 8 in no order, "
        "and later some with 9; meanwhile the other posts with priority 0. A wait is from the 202 to the moment at "
        "which the client, which looks every 20 ms, sees that the job, or the last of several, has ended. Overtaken: "
        "how many jobs of many were begun after that 202 and before the last of these; turns give several at once as "
        "many."
    )
    rows = [
        (f"{place}: {case}", each.median(case), each.longest(case), each.overtaken(case))
        for place, each in found.items()
        for case in (ALONE, ONE, URGENT, ALONE_TOGETHER, TOGETHER)
    ]
    head = ("", "median wait [s]", "longest [s]", "overtaken by at most")
    paces = ", ".join(f"{each.pace:.1f} on {place}" for place, each in found.items())
    together = ", ".join(sorted({f"{each.together}" for each in found.values()}))
    end = f"Several are {together}. Jobs begun a second behind many: {paces}."
    return "\n\n".join(["### One owner's many jobs and another's one", text, table(head, rows), end])


def many_workers_limits(found: Sequence[ManyWorkersFigures]) -> Iterator[Limit]:
    """Yield what must hold of every fleet: all workers work, and each has the connections that it may have."""
    for each in found:
        allowed = each.case.workers * (each.case.connections + 2) + 10
        yield Limit(
            f"{_fleet(each)}: connections", f"≤ {allowed:,}", each.busy.connections, each.busy.connections <= allowed
        )


def many_workers_sections(found: Sequence[ManyWorkersFigures]) -> list[str]:
    """Return what was measured, and what follows for a larger fleet."""
    text = (
        "Real: the workers, each a process with the engine, queue polling, lock on its name, proof of life, takeover, "
        "housekeeping, events, documents and connections of its own; the server with its default settings but for "
        "max_connections and a count of statements. Made up: solver processes; a job reports twice, takes 0.1 s and "
        "has a document of a few hundred bytes. Workers and server share this machine's cores, so that workers which "
        "look often are kept from it by one another: then PostgreSQL's processor time for a statement counts, and not "
        "its share of the cores. Each worker has one slot for jobs and one for studies, and at most "
        f"{found[0].case.connections + 2} connections."
    )
    idle = [
        (_fleet(each), each.idle.rate, each.idle.rate / each.case.workers, each.idle.connections,
         each.idle.server_cores, each.idle.cpu_per_statement, each.idle.fleet_cores, 100.0 * each.idle.machine_idle)
        for each in found
    ]  # fmt: skip
    busy = [
        (_fleet(each), each.jobs_per_second, each.busy.rate, statements_of_a_job(each), each.busy.server_cores,
         each.busy.cpu_per_statement, each.busy.fleet_cores, 100.0 * each.busy.machine_idle)
        for each in found
    ]  # fmt: skip
    shared = ("PostgreSQL [cores]", "of a statement [ms]", "workers [cores]", "machine idle [%]")
    head = ("nothing waits", "statements [1/s]", "of each worker [1/s]", "connections", *shared)
    busy_head = ("jobs flow", "jobs [1/s]", "statements [1/s]", "of a job, beside looks", *shared)
    kinds: list[tuple[Cell, ...]] = [
        (kind, *(each.idle.statements.get(kind, 0) / each.idle.seconds / each.case.workers for each in found),
         *(each.busy.statements.get(kind, 0) / each.busy.seconds / each.case.workers for each in found))
        for kind in KINDS
    ]  # fmt: skip
    kinds_head = ("", *(f"{_fleet(each)}, idle" for each in found), *(f"{_fleet(each)}, jobs" for each in found))
    return [
        "\n\n".join(["### What they ask, and what it costs", text, table(head, idle), table(busy_head, busy)]),
        "\n\n".join(["### Statements a second of each worker, by kind", table(kinds_head, kinds)]),
        "\n\n".join(["### The first bottleneck, and a thousand workers", *_reckoned(found)]),
    ]


def statements_of_a_job(each: ManyWorkersFigures) -> float:
    """Return how many statements a job takes, beside what its workers ask without any [1]."""
    total = sum(each.busy.statements.values())
    return max(0.0, total - each.idle.rate * each.busy.seconds) / each.case.jobs


def _reckoned(found: Sequence[ManyWorkersFigures]) -> Iterator[str]:
    first, slow = found[0], max(found, key=lambda each: (each.case.poll_seconds, each.case.workers))
    looks = sum(first.idle.statements.get(kind, 0) for kind in KINDS if kind.startswith("queues"))
    share = 100.0 * looks / max(1, sum(first.idle.statements.values()))
    yield (
        f"Looking at queues is {share:.0f} % of all statements of {_fleet(first)} that have nothing to do, and most of "
        "the begins and ends of transactions are theirs as well: the first bottleneck is the processor time, of "
        "PostgreSQL and of the workers, that they take. `poll_seconds` moves it, of each worker for itself; a job then "
        "waits for half of it in the mean, if no other worker looks sooner."
    )
    pairs = [
        (before, after)
        for before in found
        for after in found
        if before.case.workers == after.case.workers and before.case.poll_seconds < after.case.poll_seconds
    ]
    head = ("before → after", "statements [1/s]", "", "PostgreSQL [cores]", "", "jobs [1/s]", "")
    rows = [
        (f"{before.case.workers} workers, {before.case.poll_seconds:g} s → {after.case.poll_seconds:g} s",
         before.idle.rate, after.idle.rate, before.idle.server_cores, after.idle.server_cores,
         before.jobs_per_second, after.jobs_per_second)
        for before, after in pairs
    ]  # fmt: skip
    if rows:
        yield table(head, rows)
    yield (
        f"A worker that has nothing to do takes {100.0 * first.idle.fleet_cores / first.case.workers:.1f} % of a core "
        f"itself in {_fleet(first)}, and {100.0 * slow.idle.fleet_cores / slow.case.workers:.1f} % in {_fleet(slow)}: "
        "a hundred that look every 4 s did their jobs on this machine, but wanted all of its cores, so that only those "
        "were measured."
    )
    yield reckoned_cores(first)
    if slow is not first:
        yield reckoned_cores(slow)


def reckoned_cores(each: ManyWorkersFigures) -> str:
    """Return the arithmetic by which a thousand workers follow from a fleet."""
    rate, cost = each.idle.rate / each.case.workers, each.idle.cpu_per_statement
    connections = FLEET * each.idle.connections / each.case.workers
    return (
        f"{FLEET:,} workers that look every {each.case.poll_seconds:g} s, reckoned from {_fleet(each)}: {FLEET:,} × "
        f"{rate:.1f} statements/s = {FLEET * rate:,.0f} statements/s; × {cost:.3f} ms = "
        f"{FLEET * rate * cost / 1e3:.1f} cores of PostgreSQL without a job; and {connections:,.0f} connections."
    )


def _fleet(each: ManyWorkersFigures) -> str:
    return f"{each.case.workers} workers, {each.case.poll_seconds:g} s"


def days_limits(found: Mapping[str, DaysFigures]) -> Iterator[Limit]:
    """Yield that neither memory nor database grow for ever."""
    for place, each in found.items():
        first = f"{100 * each.settled:.0f} % of {each.jobs:,} jobs"
        yield Limit.at_most(f"{place}: memory at the end, more than after {first} [%]", each.growth, MOST_GROWTH)
        growth = 100.0 * (each.database(1.0) / each.database(0.75) - 1.0)
        yield Limit(
            f"{place}: database at the end, larger than after 75 % of the jobs [%]", f"≤ {MOST_DATABASE_GROWTH:g}",
            growth,
            growth <= MOST_DATABASE_GROWTH,
        )  # fmt: skip
        left = sum(each.left.values())
        yield Limit(f"{place}: rows left once all was deleted", "= 0", left, not left)


def days_section(found: Mapping[str, DaysFigures], effort: DaysEffort) -> str:
    """Return what was measured."""
    text = (
        "Lifts and piles by made-up solvers, as fast as they go, 40 at a time: solved, infeasible, failed, with "
        "physics and remedies told later, every twentieth cancelled; of every fifth the plan, a page of the list, the "
        "document and the events are read. No clock is simulated, as engine and databases have their own: plans are "
        f"deleted {effort.retention_seconds:g} s after their end, and entries of the audit log at that age, in rounds "
        f"{effort.pause_seconds:g} s apart, where the product has days and an hour. Memory is what a process has for "
        "itself alone (USS), without solvers. On "
        "SQLite the API is the worker as well."
    )
    rows = [
        (f"{place}, after {100 * share:.0f} %", each.plans(share), each.database(share),
         ", ".join(f"{name} {mib:.0f}" for name, mib in each.memory(share).items()))
        for place, each in found.items()
        for share in (0.1, 0.25, 0.4, 0.55, 0.75, 1.0)
    ]  # fmt: skip
    ends = [
        f"{place}: {each.jobs:,} jobs in {each.seconds / 60.0:.1f} min; those that were read: "
        + ", ".join(f"{number:,} {state.replace('_', ' ')}" for state, number in sorted(each.states.items()))
        + "."
        for place, each in found.items()
    ]
    head = ("", "plans stored", "database [MiB]", "memory [MiB]")
    return "\n\n".join(["### Memory and database", text, table(head, rows), *ends])
