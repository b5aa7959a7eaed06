"""What many workers do to one PostgreSQL: statements by kind, connections, its processor time, jobs a second."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
import psycopg

from tests.benchmarks.machine import ROOT
from tests.benchmarks.tasks import Note, task_body
from tests.support.postgres import PostgresServer, running_postgres
from tests.support.service import cpu_seconds, wait_for
from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database
from workers.stores.job_queue import JobQueue
from workers.stores.plan_store import PlanStore, Submission
from workers.stores.plan_writer import MOST_TOGETHER

KINDS: dict[str, tuple[str, ...]] = {
    "begin and end of transactions": ("begin", "commit", "rollback"),
    "locks and proof of life": ("pg_advisory", "pg_try_advisory", "pg_locks", "set_config", "select $1", "select true"),
    "events": ("liftwright_plan_events",),
    "documents": ("liftwright_documents",),
    "webhooks": ("liftwright_webhook",),
    "queues: what the engine reads before a claim": ("queues", "application_versions"),
    "queues: claims": ("for update skip locked",),
    "jobs of the engine": ("workflow_", "operation_outputs", "notify", "listen"),
    "plans and the rest": ("",),
}
"""Words of which a statement of each kind has one; the first kind that fits is meant."""
START_SECONDS = 300.0
LONGEST_SECONDS = 300.0
SERVER = ("max_connections=2000", "shared_preload_libraries=pg_stat_statements", "pg_stat_statements.max=5000")


@dataclass(frozen=True)
class ManyWorkersCase:
    """One fleet that is measured."""

    workers: int
    poll_seconds: float
    jobs: int
    connections: int = 3
    """That each worker may have at most, beside its lock's and the engine's own."""


@dataclass(frozen=True)
class ManyWorkersEffort:
    """How much is measured."""

    cases: tuple[ManyWorkersCase, ...] = (
        ManyWorkersCase(10, 0.1, 100),
        ManyWorkersCase(10, 1.0, 100),
        ManyWorkersCase(30, 1.0, 100),
        ManyWorkersCase(30, 4.0, 100),
    )
    idle_seconds: float = 15.0


@dataclass
class Spell:
    """What a time did to the server."""

    seconds: float = 0.0
    statements: dict[str, int] = field(default_factory=dict)
    """By kind."""
    server_cpu: float = 0.0
    """Of all processes of PostgreSQL [s]."""
    fleet_cpu: float = 0.0
    """Of all workers [s]."""
    machine_idle: float = 0.0
    """Share of the machine's cores that nobody wanted [1]."""
    connections: int = 0
    """To the database, at its end."""

    @property
    def rate(self) -> float:
        """Statements a second [1/s]."""
        return sum(self.statements.values()) / self.seconds

    @property
    def server_cores(self) -> float:
        """Cores that PostgreSQL took [1]."""
        return self.server_cpu / self.seconds

    @property
    def fleet_cores(self) -> float:
        """Cores that all workers took [1]."""
        return self.fleet_cpu / self.seconds

    @property
    def cpu_per_statement(self) -> float:
        """PostgreSQL's processor time of a statement [ms]."""
        return 1e3 * self.server_cpu / max(1, sum(self.statements.values()))


@dataclass(frozen=True)
class ManyWorkersFigures:
    """What one fleet did."""

    case: ManyWorkersCase
    idle: Spell
    """Nothing waits."""
    busy: Spell
    """From the moment at which all jobs wait to the end of the last."""

    @property
    def jobs_per_second(self) -> float:
        """How many jobs were done a second [1/s]."""
        return self.case.jobs / self.busy.seconds


def kind_of(statement: str) -> str:
    """Return of which kind a statement is."""
    words = " ".join(statement.lower().split())
    if words in ("select $1", "select true"):
        return "locks and proof of life"
    for kind, marks in KINDS.items():
        if kind.startswith("begin"):
            if words.split(" ")[0] in marks:
                return kind
        elif any(mark in words for mark in marks if not mark.startswith("select ")):
            return kind
    raise AssertionError(statement)


def measure(effort: ManyWorkersEffort, note: Note) -> list[ManyWorkersFigures]:
    """Measure each fleet on a server of its own."""
    found = []
    for case in effort.cases:
        with tempfile.TemporaryDirectory() as folder, running_postgres(*SERVER) as server:
            figures = _measure(case, effort.idle_seconds, Path(folder), server)
        note(
            f"many workers: {case.workers} that look every {case.poll_seconds:g} s, "
            f"{figures.idle.rate:.0f} statements/s, {figures.jobs_per_second:.1f} jobs/s"
        )
        found.append(figures)
    return found


def _measure(case: ManyWorkersCase, idle_seconds: float, folder: Path, server: PostgresServer) -> ManyWorkersFigures:
    settings = WorkerSettings.model_validate({"data_dir": folder, "database_url": server.url})
    with closing(open_database(settings)) as database, _workers(case, folder, server) as pids:
        watch = _Watch(server, pids)
        with watch.spell() as idle:
            time.sleep(idle_seconds)
        _post(database, case.jobs)
        queue = JobQueue(database)
        with closing(queue), watch.spell() as busy:
            # Seldom: what is asked here is counted as well.
            wait_for(lambda: _done(queue, case.jobs), LONGEST_SECONDS)
    return ManyWorkersFigures(case, idle, busy)


@contextmanager
def _workers(case: ManyWorkersCase, folder: Path, server: PostgresServer) -> Iterator[list[int]]:
    """Run workers until the block ends, and yield the ids of their processes once all have their names."""
    told = {
        "data_dir": folder, "database_url": server.url, "poll_seconds": case.poll_seconds, "worker_slots": 1,
        "study_slots": 1, "database_connections": case.connections,
    }  # fmt: skip
    environment = {**os.environ, **{f"LIFTWRIGHT_{name.upper()}": str(value) for name, value in told.items()}}
    command = [sys.executable, "-m", "tests.benchmarks.noop_workers", str(case.workers)]
    with (folder / "workers.log").open("wb") as log:
        process = subprocess.Popen(
            command, cwd=ROOT, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log
        )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        pids: list[int] = json.loads(process.stdout.readline())
        wait_for(lambda: _working(server) == case.workers, START_SECONDS)
        # What only a start does is over.
        time.sleep(5.0)
        yield pids
    finally:
        with suppress(BrokenPipeError):
            process.stdin.close()
        process.wait(60.0)
        process.stdout.close()


def _working(server: PostgresServer) -> int:
    """Return how many workers hold their name, and listen, which they do last."""
    time.sleep(0.5)
    query = "SELECT count(*) FROM pg_stat_activity WHERE application_name LIKE 'liftwright worker w%'"
    (row,) = _asked(server, query)
    return row[0]


class _Watch:
    """Counts what the server does."""

    def __init__(self, server: PostgresServer, pids: list[int]) -> None:
        self._server, self._pids = server, pids
        _asked(server, "CREATE EXTENSION IF NOT EXISTS pg_stat_statements")

    @contextmanager
    def spell(self) -> Iterator[Spell]:
        """Fill what is yielded when the block ends."""
        spell = Spell()
        _asked(self._server, "SELECT pg_stat_statements_reset()")
        psutil.cpu_times_percent()
        server, fleet, begun = self._server.cpu_seconds(), self._fleet_cpu(), time.monotonic()
        yield spell
        # Of what is counted the longest to come by; where the machine is short of cores that takes a while itself.
        counted = _asked(self._server, "SELECT query, calls FROM pg_stat_statements")
        spell.seconds = time.monotonic() - begun
        spell.server_cpu, spell.fleet_cpu = self._server.cpu_seconds() - server, self._fleet_cpu() - fleet
        spell.machine_idle = 0.01 * psutil.cpu_times_percent().idle
        for text, calls in counted:
            if "pg_stat_statements" not in text:
                kind = kind_of(text)
                spell.statements[kind] = spell.statements.get(kind, 0) + int(calls)
        query = "SELECT count(*) FROM pg_stat_activity WHERE backend_type = 'client backend'"
        spell.connections = _asked(self._server, query)[0][0] - 1

    def _fleet_cpu(self) -> float:
        return sum(cpu_seconds(psutil.Process(pid)) for pid in self._pids)


def _asked(server: PostgresServer, query: str) -> list[tuple[Any, ...]]:
    with psycopg.connect(server.url, autocommit=True) as connection:
        cursor = connection.execute(query.encode())
        return [] if cursor.description is None else cursor.fetchall()


def _post(database: Database, number: int) -> None:
    """Have plans accepted as the API does, in transactions of as many."""
    queue, store = JobQueue(database), PlanStore(database)
    with closing(queue):
        for begin in range(0, number, MOST_TOGETHER):
            count = min(MOST_TOGETHER, number - begin)
            store.accept_all([Submission.of(task_body("ab1")) for _ in range(count)], queue)


def _done(queue: JobQueue, number: int) -> bool:
    time.sleep(0.25)
    depth = queue.depth(number)
    return depth.due == 0
