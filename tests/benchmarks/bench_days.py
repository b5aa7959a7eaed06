"""Thousands of plans of all kinds, most of them deleted meanwhile: what memory and database of the service come to."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import httpx
import psycopg
import sqlalchemy as sa

from tests.benchmarks.scale_fleet import MIB, ScaleFleet, running_fleet
from tests.benchmarks.short_days import PAUSE
from tests.benchmarks.tasks import Note, task_body
from tests.support.service import FAKE_SOLVER
from workers.settings import WorkerSettings
from workers.stores.database import SQLITE_FILE, Database, open_database
from workers.stores.jobs import STATE_OF_STATUS, input_table, workflow_table
from workers.stores.tables import AUDIT, DOCUMENTS, EVENTS, PLANS

OUTSTANDING = 40
"""So many jobs are accepted and not finished, as long as there are more."""
TASKS = ("ab1", "ab2", "ab3", "pb1", "domino_pile", "can_stack", "carton_pile")
WISHES = ("plan", "steps-1", "infeasible", "simulate-1", "remedies-1", "plan", "fail", "plan")
"""What the solver makes of the tasks, in turn: see `tests.support.fake_solver`."""
CANCELLED_EVERY = 20
"""Each so many-th job is cancelled at once."""
READ_EVERY = 5
"""Of each so many-th job its plan, its document and a page of the list are read."""
WINDOW = 0.05
"""Share of the jobs during which figures are taken whose median counts [1]."""
POLL_SECONDS = 0.02
STALL_SECONDS = 120.0
NOT_FOUND = 404
SETTLED_JOBS = 1000
"""After so many jobs everything that is loaded once is there [1]."""
SETTLED_SHARE = 0.4
"""At most so much of the jobs comes before that is taken to be so [1]."""


@dataclass(frozen=True)
class DaysEffort:
    """What is planned where."""

    places: tuple[str, ...] = ("SQLite", "PostgreSQL")
    retention_seconds: float = 20.0
    """Plans that ended longer ago are deleted."""
    pause_seconds: float = 5.0
    """Between two rounds of deletion."""
    look_seconds: float = 1.0
    """Between two looks at memory and database."""


@dataclass(frozen=True)
class DaysLook:
    """How the service stood at a moment."""

    ended: int
    """Jobs that had ended."""
    memory: dict[str, float]
    """Of each process, for itself alone [MiB]."""
    database: float
    """Its size [MiB]."""
    plans: int
    """That were stored."""


@dataclass
class DaysFigures:
    """What was measured in one place."""

    jobs: int = 0
    seconds: float = 0.0
    states: Counter[str] = field(default_factory=Counter)
    """Of the plans that were read."""
    looks: list[DaysLook] = field(default_factory=list)
    left: dict[str, int] = field(default_factory=dict)
    """Rows that are left when everything was deleted, by the table."""

    def memory(self, share: float) -> dict[str, float]:
        """Return the median memory of each process about a share of the jobs [MiB]."""
        near = self._near(share)
        return {name: median(look.memory[name] for look in near) for name in near[0].memory}

    def database(self, share: float) -> float:
        """Return the median size of the database about a share of the jobs [MiB]."""
        return median(look.database for look in self._near(share))

    def plans(self, share: float) -> int:
        """Return the median number of stored plans about a share of the jobs."""
        return round(median(look.plans for look in self._near(share)))

    @property
    def settled(self) -> float:
        """After which share of the jobs memory counts: a tenth, or more where there are few [1]."""
        return max(0.1, min(SETTLED_JOBS / max(1, self.jobs), SETTLED_SHARE))

    @property
    def growth(self) -> dict[str, float]:
        """By how much the memory of each process is larger at the end than once it has settled [%]."""
        first, last = self.memory(self.settled), self.memory(1.0)
        return {name: 100.0 * (last[name] / first[name] - 1.0) for name in first}

    def _near(self, share: float) -> list[DaysLook]:
        middle = share * self.jobs
        # Behind the tenth, and before the end.
        low, high = (middle, middle + WINDOW * self.jobs) if share < 0.5 else (middle - WINDOW * self.jobs, middle)
        found = [look for look in self.looks if low <= look.ended <= high]
        return found or [min(self.looks, key=lambda look: abs(look.ended - middle))]


def measure(effort: DaysEffort, place: str, jobs: int, note: Note) -> DaysFigures:
    """Run a service of its own, with one worker of two slots or two of one, as fast as it goes."""
    pause = PAUSE.removeprefix("LIFTWRIGHT_").lower()
    days = effort.retention_seconds / 86_400.0
    retention: dict[str, Any] = {"retention_days": days, "audit_days": days, pause: effort.pause_seconds}
    figures = DaysFigures(jobs)
    with (
        tempfile.TemporaryDirectory() as folder,
        running_fleet(
            Path(folder), FAKE_SOLVER, postgres=place == "PostgreSQL", module="tests.benchmarks.short_days",
            poll_seconds=POLL_SECONDS, **retention,
        ) as fleet,
        httpx.Client(base_url=fleet.api.address, timeout=120.0) as client,
        closing(open_database(fleet.settings)) as database,
    ):  # fmt: skip
        begun = time.monotonic()
        _plan(effort, figures, fleet, client, database, note)
        figures.seconds = time.monotonic() - begun
        time.sleep(effort.retention_seconds + 3 * effort.pause_seconds)
        figures.left = _rows(database)
    return figures


def _plan(
    effort: DaysEffort,
    figures: DaysFigures,
    fleet: ScaleFleet,
    client: httpx.Client,
    database: Database,
    note: Note,
) -> None:
    """Keep so many jobs accepted until all have ended, and look around every second."""
    waiting: dict[str, int] = {}
    posted, looked, moved = 0, 0.0, time.monotonic()
    while posted < figures.jobs or waiting:
        while posted < figures.jobs and len(waiting) < OUTSTANDING:
            waiting[_post(client, posted)] = posted
            posted += 1
        time.sleep(0.1)
        ended = _ended(database, list(waiting))
        for plan_id in ended:
            number = waiting.pop(plan_id)
            if number % READ_EVERY == 0:
                figures.states[_read(client, plan_id)] += 1
        moved = time.monotonic() if ended else moved
        assert time.monotonic() - moved < STALL_SECONDS, f"no job has ended for {STALL_SECONDS:g} s"
        if time.monotonic() - looked > effort.look_seconds:
            looked = time.monotonic()
            look = _look(fleet, database, posted - len(waiting))
            if not figures.looks or look.ended * 20 // figures.jobs > figures.looks[-1].ended * 20 // figures.jobs:
                note(f"days: {look.ended} of {figures.jobs} jobs have ended, {look.database:.0f} MiB, {look.memory}")
            figures.looks.append(look)
    figures.looks.append(_look(fleet, database, figures.jobs))


def _post(client: httpx.Client, number: int) -> str:
    body = {**task_body(TASKS[number % len(TASKS)]), "external_id": WISHES[number % len(WISHES)]}
    plan = client.post("/v1/plans", json=body).raise_for_status().json()
    if number % CANCELLED_EVERY == CANCELLED_EVERY - 1:
        answer = client.post(plan["links"]["cancel"])
        # It may have ended by then.
        assert answer.status_code in (200, 202, 204, 409), answer.text
    return plan["id"]


def _read(client: httpx.Client, plan_id: str) -> str:
    """Read what a caller reads of a plan that has ended, and return its state."""
    answer = client.get(f"/v1/plans/{plan_id}")
    if answer.status_code == NOT_FOUND:
        return "deleted before"
    plan: dict[str, Any] = answer.raise_for_status().json()
    client.get("/v1/plans", params={"page_size": 50}).raise_for_status()
    if plan["outcome"] is not None:
        client.get(plan["links"]["document"]).raise_for_status()
    with client.stream("GET", plan["links"]["events"]) as stream:
        stream.read()
    return plan["state"] if plan["outcome"] is None else plan["outcome"]


def _ended(database: Database, plan_ids: list[str]) -> list[str]:
    jobs = workflow_table(database.engine.dialect.name)
    going_on = [status for status, state in STATE_OF_STATUS.items() if not state.done]
    query = sa.select(jobs.c.workflow_uuid).where(jobs.c.workflow_uuid.in_(plan_ids), jobs.c.status.in_(going_on))
    waiting = set(database.column(query))
    # One that is not there any more has ended, and was deleted.
    return [plan_id for plan_id in plan_ids if plan_id not in waiting]


def _look(fleet: ScaleFleet, database: Database, ended: int) -> DaysLook:
    plans = database.scalar(sa.select(sa.func.count()).select_from(PLANS))
    return DaysLook(ended, fleet.memory_mib(), size_of(fleet.settings) / MIB, plans)


def size_of(settings: WorkerSettings) -> float:
    """Return the size of a database, with what is not yet written into its file [bytes]."""
    if settings.database_url is None:
        return sum(path.stat().st_size for path in settings.data_dir.glob(f"{SQLITE_FILE}*"))
    with psycopg.connect(settings.database_url) as connection:
        row = connection.execute("SELECT pg_database_size(current_database())").fetchone()
    assert row is not None
    return float(row[0])


def _rows(database: Database) -> dict[str, int]:
    dialect = database.engine.dialect.name
    tables = PLANS, EVENTS, DOCUMENTS, AUDIT, workflow_table(dialect), input_table(dialect)
    return {table.name: database.scalar(sa.select(sa.func.count()).select_from(table)) for table in tables}
