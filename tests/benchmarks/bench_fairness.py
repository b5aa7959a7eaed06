"""How long one owner's job waits while another's thousand do, and whether priorities are kept among an owner's jobs."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from signal import SIGKILL, SIGTERM
from typing import Any

import httpx
import sqlalchemy as sa

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from tests.benchmarks.tasks import Note, task_body
from tests.support.postgres import running_postgres
from tests.support.service import FAKE_SOLVER, ServiceProcess, finished, wait_for
from tests.support.worker import WorkerProcess
from workers.settings import WorkerSettings
from workers.stores.database import open_database
from workers.stores.jobs import workflow_table
from workers.stores.tables import PLANS

MANY, FEW = "factory", "laboratory"
"""The two owners: who posts a thousand jobs, and who posts one."""
STEPS = 2
"""Of the solver, 50 ms each."""
SLOTS = 2
HIGHEST = 9
LONGEST_SECONDS = 1200.0


@dataclass(frozen=True)
class FairnessEffort:
    """How much is posted."""

    jobs: int = 1000
    """Of the owner with many."""
    repeats: int = 10
    """How often the other one posts in each case."""
    together: int = 5
    """Jobs that the other one posts at once."""
    urgent: int = 50
    """Jobs of highest priority that the owner with many adds."""


@dataclass(frozen=True)
class BegunJob:
    """When a job was accepted and begun [µs since 1970], and what was said about it."""

    id: str
    owner: str
    priority: int
    created_us: int
    begun_us: int


@dataclass(frozen=True)
class Waited:
    """What one post of the other owner met."""

    seconds: float
    """From the last 202 to the end of the last of the jobs [s]."""
    overtaken_by: int
    """Jobs of the owner with many that were begun after the 202 and before the last of these [1]."""


@dataclass
class FairnessFigures:
    """What was measured in one place."""

    jobs: int = 0
    """Of the owner with many."""
    together: int = 0
    waits: dict[str, list[Waited]] = field(default_factory=dict)
    """By the case."""
    begun: list[BegunJob] = field(default_factory=list)
    """All jobs of both, in the order in which they were begun."""

    @property
    def inversions(self) -> int:
        """How many jobs were begun while one of the same owner with a higher priority waited."""
        return len(inverted(self.begun))


ALONE, ALONE_TOGETHER = "one, nobody else waits", "several at once, nobody else waits"
ONE, TOGETHER = "one, behind many", "several at once, behind many"
URGENT = "one, behind many of highest priority"


def inverted(begun: Sequence[BegunJob]) -> list[BegunJob]:
    """Return the jobs that were begun, in this order, while another one of their owner should have been.

    Those that are begun at a time, as many as there are slots, may be so in any order.
    """
    found = []
    for place, job in enumerate(begun):
        later = (each for each in begun[place + SLOTS :] if each.owner == job.owner)
        if any(each.priority > job.priority and each.created_us < job.begun_us for each in later):
            found.append(job)
    return found


def overtaken(begun: Sequence[BegunJob], posted: set[str], answered_us: float) -> int:
    """Return how many jobs of others were begun after a moment, and before the last of those that were posted."""
    last = max(each.begun_us for each in begun if each.id in posted)
    return sum(each.id not in posted and answered_us < each.begun_us < last for each in begun)


def measure(effort: FairnessEffort, *, postgres: bool, note: Note) -> FairnessFigures:
    """Have two owners post to a service of its own, one of them much."""
    figures = FairnessFigures(effort.jobs, effort.together)
    answers: dict[str, list[tuple[set[str], float, float]]] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        running_fleet(Path(folder), postgres=postgres) as fleet,
        fleet.client(MANY) as many,
        fleet.client(FEW) as few,
    ):

        def ask(case: str, number: int) -> None:
            answers[case] = [_ask(few, number) for _ in range(effort.repeats)]
            note(f"fairness: {case}")

        ask(ALONE, 1)
        ask(ALONE_TOGETHER, effort.together)
        for number in range(effort.jobs):
            # In an order that has no meaning, all but the highest.
            _post(many, number * 7 % HIGHEST)
        note(f"fairness: {effort.jobs} jobs are posted")
        ask(ONE, 1)
        ask(TOGETHER, effort.together)
        for _ in range(effort.urgent):
            _post(many, HIGHEST)
        ask(URGENT, 1)
        wait_for(lambda: not _waits(many), LONGEST_SECONDS)
        figures.begun = _begun(fleet.settings)
    for case, posts in answers.items():
        figures.waits[case] = [Waited(seconds, overtaken(figures.begun, ids, at)) for ids, at, seconds in posts]
    return figures


def _ask(client: httpx.Client, number: int) -> tuple[set[str], float, float]:
    """Post jobs and wait for them; return their ids, when the last was accepted [µs since 1970], and the wait [s]."""
    plans = [_post(client, 0) for _ in range(number)]
    at, begun = 1e6 * time.time(), time.perf_counter()
    for plan in plans:
        finished(client, plan, LONGEST_SECONDS)
    return {plan["id"] for plan in plans}, at, time.perf_counter() - begun


def _post(client: httpx.Client, priority: int) -> dict[str, Any]:
    body = {**task_body("ab1"), "external_id": f"steps-{STEPS}"}
    return client.post("/v1/plans", json=body, params={"priority": priority}).raise_for_status().json()


def _waits(client: httpx.Client) -> bool:
    """Whether any job of this owner has not ended."""
    time.sleep(0.5)
    asked = ({"state": state, "page_size": 1} for state in ("queued", "running"))
    return any(client.get("/v1/plans", params=each).raise_for_status().json()["plans"] for each in asked)


def _begun(settings: WorkerSettings) -> list[BegunJob]:
    with closing(open_database(settings)) as database:
        jobs = workflow_table(database.engine.dialect.name)
        # When the queue handed a job out; on SQLite it tells that in whole seconds, and the one worker in its order.
        by_queue = 1000 * jobs.c.started_at_epoch_ms
        at = (PLANS.c.started_us if settings.database_url is None else by_queue).label("begun_us")
        query = (
            sa.select(PLANS.c.id, PLANS.c.owner, PLANS.c.priority, PLANS.c.created_us, at)
            .join(jobs, jobs.c.workflow_uuid == PLANS.c.id)
            .order_by(at)
        )
        rows = database.rows(query)
    return [BegunJob(each.id, each.owner, each.priority or 0, each.created_us, each.begun_us) for each in rows]


NOBODY_REFUSED = 1_000_000
"""Requests and jobs: more than are sent."""


@dataclass(frozen=True)
class OwnersFleet:
    """A service that runs, with a key for each owner."""

    settings: WorkerSettings
    """Which lead to its database."""
    address: str
    keys: dict[str, str]
    """By owner."""

    def client(self, owner: str) -> httpx.Client:
        """Return a client with the key of an owner."""
        return httpx.Client(
            base_url=self.address, headers={"Authorization": f"Bearer {self.keys[owner]}"}, timeout=120.0
        )


@contextmanager
def running_fleet(folder: Path, *, postgres: bool) -> Iterator[OwnersFleet]:
    """Run an API and two workers of one slot on PostgreSQL; otherwise one process of two slots on SQLite."""
    names = ("max_queued", "max_queued_of_owner", "requests_per_second", "request_burst")
    shared: dict[str, Any] = {**dict.fromkeys(names, NOBODY_REFUSED), "worker_slots": 1 if postgres else SLOTS}
    with ExitStack() as stack:
        if postgres:
            shared["database_url"] = stack.enter_context(running_postgres()).url
        settings = WorkerSettings(data_dir=folder / "api", database_url=shared.get("database_url"))
        keys = {owner: issue_key(settings, owner, Scope.WRITE, None) for owner in (MANY, FEW)}
        workers = [
            WorkerProcess(f"w{n}", folder / f"w{n}", FAKE_SOLVER, fresh=True, **shared) for n in range(SLOTS * postgres)
        ]
        api = ServiceProcess(folder / "api", FAKE_SOLVER, "api" if postgres else "serve", fresh=True, **shared)
        for worker in workers:
            stack.callback(_end, worker)
            worker.launch()
        stack.callback(api.stop)
        api.start()
        for worker in workers:
            worker.wait()
        yield OwnersFleet(settings, api.address, keys)


def _end(worker: WorkerProcess) -> None:
    with suppress(TimeoutError):
        worker.end(SIGTERM)
        return
    worker.end(SIGKILL)
