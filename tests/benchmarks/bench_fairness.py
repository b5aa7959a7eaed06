"""How long one owner's job waits while another's thousand do, and whether priorities are kept among an owner's jobs."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import httpx
import sqlalchemy as sa

from tests.benchmarks.scale_fleet import running_fleet
from tests.benchmarks.tasks import Note, task_body
from tests.support.service import FAKE_SOLVER, finished, wait_for
from workers.settings import WorkerSettings
from workers.stores.database import open_database
from workers.stores.jobs import workflow_table
from workers.stores.tables import PLANS

MANY, FEW = "factory", "laboratory"
"""The two owners: who posts a thousand jobs, and who posts one."""
STEPS = 2
"""Of the solver, 50 ms each."""
JOB_SECONDS = 0.1
SLOTS = 2
HIGHEST = 9
LONGEST_SECONDS = 1200.0
COMMIT_MS = 100.0
"""A job that was accepted so shortly before another one was begun may not have been committed then [ms]."""


@dataclass(frozen=True)
class FairnessEffort:
    """How much is posted."""

    jobs: int = 1000
    """Of the owner with many."""
    places: tuple[str, ...] = ("SQLite", "PostgreSQL")
    repeats: int = 10
    """How often the other one posts in each case."""
    together: int = 5
    """Jobs that the other one posts at once."""
    urgent: int = 50
    """Jobs of highest priority that the owner with many adds."""
    begun: int = 300
    """Jobs of the owner with many are to be begun before the service is stopped."""


@dataclass(frozen=True)
class BegunJob:
    """When a job was accepted and begun [ms since 1970; inf: it still waits], and what was said about it."""

    id: str
    owner: str
    priority: int
    created_ms: float
    begun_ms: float


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

    @property
    def pace(self) -> float:
        """How many jobs were begun a second, from the first of the owner with many on [1/s]."""
        times = [each.begun_ms for each in self.begun if each.begun_ms < math.inf]
        first = min(each.begun_ms for each in self.begun if each.owner == MANY)
        late = [each for each in times if each >= first]
        return 1e3 * (len(late) - 1) / (late[-1] - first) if len(late) > 1 else 0.0

    def median(self, case: str) -> float:
        """Return the median wait of a case [s]."""
        return median(each.seconds for each in self.waits[case])

    def longest(self, case: str) -> float:
        """Return the longest wait of a case [s]."""
        return max(each.seconds for each in self.waits[case])

    def overtaken(self, case: str) -> int:
        """Return by how many jobs of the owner with many a post of a case was overtaken at worst [1]."""
        return max(each.overtaken_by for each in self.waits[case])


ALONE, ALONE_TOGETHER = "one, nobody else waits", "several at once, nobody else waits"
ONE, TOGETHER = "one, behind many", "several at once, behind many"
URGENT = "one, behind many of highest priority"


def inverted(begun: Sequence[BegunJob]) -> list[BegunJob]:
    """Return the jobs that were begun, in this order, while another one of their owner should have been."""
    found = []
    for place, job in enumerate(begun):
        if job.begun_ms == math.inf:
            break
        later = (each for each in begun[place + 1 :] if each.owner == job.owner)
        if any(each.priority > job.priority and each.created_ms + COMMIT_MS < job.begun_ms for each in later):
            found.append(job)
    return found


def overtaken(begun: Sequence[BegunJob], posted: set[str], answered_ms: float) -> int:
    """Return how many jobs of others were begun after a moment, and before the last of those that were posted."""
    last = max(each.begun_ms for each in begun if each.id in posted)
    return sum(each.id not in posted and answered_ms < each.begun_ms < last for each in begun)


def measure(effort: FairnessEffort, *, postgres: bool, note: Note) -> FairnessFigures:
    """Run a service of its own: two workers of one slot on PostgreSQL, or two slots on SQLite."""
    figures = FairnessFigures(effort.jobs, effort.together)
    answers: dict[str, list[tuple[set[str], float, float]]] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        running_fleet(Path(folder), FAKE_SOLVER, postgres=postgres, owners=(MANY, FEW), workers=SLOTS) as fleet,
        fleet.client(MANY) as many,
        fleet.client(FEW) as few,
    ):

        def ask(case: str, number: int) -> None:
            answers[case] = [_ask(few, number) for _ in range(effort.repeats)]
            note(f"fairness: {case}")

        # Solvers are loaded then.
        for _ in range(SLOTS):
            _ask(few, SLOTS)
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
        wait_for(lambda: _number_begun(fleet.settings) >= min(effort.begun, effort.jobs), LONGEST_SECONDS)
        figures.begun = _begun(fleet.settings)
    for case, posts in answers.items():
        figures.waits[case] = [Waited(seconds, overtaken(figures.begun, ids, at)) for ids, at, seconds in posts]
    return figures


def _ask(client: httpx.Client, number: int) -> tuple[set[str], float, float]:
    """Post jobs and wait for them; return their ids, when the last was accepted [ms since 1970], and the wait [s]."""
    plans = [_post(client, 0) for _ in range(number)]
    at, begun = 1e3 * time.time(), time.perf_counter()
    for plan in plans:
        finished(client, plan, LONGEST_SECONDS)
    return {plan["id"] for plan in plans}, at, time.perf_counter() - begun


def _post(client: httpx.Client, priority: int) -> dict[str, Any]:
    body = {**task_body("ab1"), "external_id": f"steps-{STEPS}"}
    return client.post("/v1/plans", json=body, params={"priority": priority}).raise_for_status().json()


def _number_begun(settings: WorkerSettings) -> int:
    """Return how many jobs of the owner with many were begun, as seldom as is no load."""
    time.sleep(1.0)
    return sum(each.owner == MANY and each.begun_ms < math.inf for each in _begun(settings))


def _begun(settings: WorkerSettings) -> list[BegunJob]:
    with closing(open_database(settings)) as database:
        jobs = workflow_table(database.engine.dialect.name)
        query = sa.select(
            PLANS.c.id, PLANS.c.owner, PLANS.c.priority, PLANS.c.created_us, jobs.c.started_at_epoch_ms
        ).join(jobs, jobs.c.workflow_uuid == PLANS.c.id)
        found = [
            BegunJob(row.id, row.owner, row.priority or 0, 1e-3 * row.created_us, row.started_at_epoch_ms or math.inf)
            for row in database.rows(query)
        ]
    return sorted(found, key=lambda each: each.begun_ms)
