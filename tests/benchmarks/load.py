"""How fast the service answers while both cores plan, with thousands of plans stored and hundreds of watchers."""

from __future__ import annotations

import asyncio
import socket
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil
import sqlalchemy as sa

from tests.benchmarks.load_sender import post_apart
from tests.benchmarks.scale_fleet import ScaleFleet, running_fleet
from tests.benchmarks.tasks import Note, task_body
from tests.support.service import FAKE_SOLVER, ServiceProcess, cpu_seconds, finished, wait_for
from workers.settings import SOLVER_COMMAND, WorkerSettings
from workers.stores.database import open_database
from workers.stores.jobs import CANCELLED, QUEUED, workflow_table
from workers.stores.tables import PLANS

ROWS_A_TIME = 500
OWNERS = tuple(f"owner {n}" for n in range(8))
"""Whose keys post in turns: of one key no more than 100 requests a second are answered."""
READER = OWNERS[0]
"""Whose plans are stored, and looked at."""
API_PROCESSES = {"SQLite": 1, "PostgreSQL": 2}
WARM_UP = 200
"""Posts before it is measured."""
DATABASE, SENDER = "PostgreSQL", "the sender of requests"
"""Processes, beside the API, whose time is told."""


@dataclass(frozen=True)
class LoadEffort:
    """How much is asked."""

    places: tuple[str, ...] = tuple(API_PROCESSES)
    submissions: int = 3000
    senders: int = 32
    """Connections that post at once."""
    reads: int = 2000
    stored: int = 10_000
    watchers: int = 200
    busy_jobs: int = 2
    """Jobs that plan meanwhile."""


@dataclass(frozen=True)
class PostingFigures:
    """How tasks were accepted that many posted at once."""

    per_second: float
    median: float
    """From a request to its answer [ms]."""
    p99: float
    cpu: dict[str, float]
    """Processor time of an accepted task, by process [ms]."""
    idle: float
    """Share of the machine's cores that nobody wanted meanwhile [1]."""

    @property
    def service_cpu(self) -> float:
        """Of all that belongs to the service [ms]."""
        return sum(milliseconds for process, milliseconds in self.cpu.items() if process != SENDER)


@dataclass(frozen=True)
class LoadFigures:
    """Milliseconds unless it says otherwise."""

    posting: PostingFigures
    """While both cores plan."""
    posting_alone: PostingFigures
    """While jobs wait, and nobody plans."""
    read_p50: float
    read_p99: float
    read_max: float
    first_page: float
    last_page: float
    """The median of pages near the end of the list."""
    pages: int
    search: float
    """For one plan by the caller's name for it, the median."""
    vain_search: float
    """For plans that have an outcome which none has, the median: all are looked at."""
    watchers: int
    """Streams that told of the end of their job."""
    watcher_lag: float
    """From the end of a job to the last watcher knowing it [s]."""


def measure(effort: LoadEffort, place: str, note: Note) -> LoadFigures:
    """Run a service on a database, keep its solvers busy, and ask; then another one whose solvers only wait."""
    with _running(place, SOLVER_COMMAND) as fleet, fleet.client(READER) as client:
        note(f"load on {place}: storing {effort.stored} plans")
        _store(fleet.settings, effort.stored)
        busy_task = task_body("ab1", contact_density=2.0, hold_density=2.0)
        with _busy(client, busy_task, effort.busy_jobs):
            note(f"load on {place}: {effort.submissions} submissions while both cores plan")
            posting = _post(fleet, effort)
            _cancel_waiting(fleet.settings)
        with _busy(client, busy_task, effort.busy_jobs) as plans:
            note(f"load on {place}: {effort.reads} reads")
            reads = 1e3 * np.array(asyncio.run(_read(client, plans, effort)))
            note(f"load on {place}: pages and searches")
            pages = 1e3 * np.array(list(_page(client)))
            search = 1e3 * _search(client, [f"{n:032x}" for n in range(0, effort.stored, effort.stored // 100)])
            vain_search = 1e3 * _search_in_vain(client)
        note(f"load on {place}: {effort.watchers} watchers")
        watchers, lag = _watch(client, effort)
    with _running(place, FAKE_SOLVER) as fleet, fleet.client(READER) as client:
        _store(fleet.settings, effort.stored)
        with _busy(client, {**task_body("ab1"), "external_id": "hang"}, effort.busy_jobs):
            note(f"load on {place}: {effort.submissions} submissions while nobody plans")
            posting_alone = _post(fleet, effort)
            _cancel_waiting(fleet.settings)
    return LoadFigures(
        posting, posting_alone,
        float(np.percentile(reads, 50)), float(np.percentile(reads, 99)), float(reads.max()),
        float(pages[0]), float(np.median(pages[-5:])), len(pages), search, vain_search,
        watchers, lag,
    )  # fmt: skip


@contextmanager
def _running(place: str, solver: tuple[str, ...]) -> Iterator[ScaleFleet]:
    """Run a service until the block ends, of which every process answers."""
    processes = API_PROCESSES[place]
    with (
        tempfile.TemporaryDirectory() as folder,
        running_fleet(
            Path(folder), solver, postgres=place != "SQLite", owners=OWNERS, api_processes=processes
        ) as fleet,
    ):
        wait_for(lambda: _answering(fleet.api) == processes)
        yield fleet


def _answering(api: ServiceProcess) -> int:
    """Return how many processes take some of many connections."""
    with ExitStack() as stack:
        for _ in range(16):
            stack.enter_context(socket.create_connection(("127.0.0.1", api.port)))
        time.sleep(0.5)
        return sum(
            any(each.status == psutil.CONN_ESTABLISHED and each.laddr.port == api.port for each in taken)
            for taken in (process.net_connections("tcp") for process in api.answering())
        )


def _post(fleet: ScaleFleet, effort: LoadEffort) -> PostingFigures:
    """Post tasks from several connections at once, which take turns with the keys of several owners."""
    task, keys = task_body("pb1_weak_cup"), tuple(fleet.keys.values())
    post_apart(fleet.api.address, task, keys, effort.senders, WARM_UP)
    psutil.cpu_times_percent()
    before = _cpu_seconds(fleet)
    posted = post_apart(fleet.api.address, task, keys, effort.senders, effort.submissions)
    taken = {name: seconds - before[name] for name, seconds in _cpu_seconds(fleet).items()} | {SENDER: posted.cpu}
    idle = 0.01 * psutil.cpu_times_percent().idle
    cpu = {name: 1e3 * seconds / posted.accepted for name, seconds in taken.items()}
    waits = 1e3 * np.array(posted.waits)
    rate = posted.accepted / posted.seconds
    return PostingFigures(rate, float(np.median(waits)), float(np.percentile(waits, 99)), cpu, idle)


def _cpu_seconds(fleet: ScaleFleet) -> dict[str, float]:
    """Return the processor time that the parts of a service have taken [s]; on SQLite the API works on jobs as well."""
    taken = {"API": sum(cpu_seconds(process) for process in fleet.api.answering())}
    if fleet.server is not None:
        taken[DATABASE] = fleet.server.cpu_seconds()
    return taken


def _store(settings: WorkerSettings, number: int) -> None:
    """Copy one accepted and finished plan, with its job, as often as asked."""
    with closing(open_database(settings)) as database:
        with database.engine.begin() as transaction:
            schema = workflow_table(database.engine.dialect.name).schema
            jobs = sa.Table("workflow_status", sa.MetaData(), autoload_with=database.engine, schema=schema)
            plan = _template()
            job = {"status": "SUCCESS", "name": "plan", "priority": 0, "was_forked_from": False, "rate_limited": False,
                   "is_debounced": False, "application_name": "liftwright", "queue_name": "plans"}  # fmt: skip
            for begin in range(0, number, ROWS_A_TIME):
                ids = [f"{n:032x}" for n in range(begin, min(begin + ROWS_A_TIME, number))]
                at = [plan["created_us"] - 60_000_000 - n for n in range(begin, begin + len(ids))]
                transaction.execute(
                    sa.insert(PLANS),
                    [
                        {**plan, "id": each, "created_us": time_us, "finished_us": time_us, "external_id": each}
                        for each, time_us in zip(ids, at, strict=True)
                    ],
                )
                rows = [
                    {**job, "workflow_uuid": each, "created_at": time_us // 1000, "updated_at": time_us // 1000}
                    for each, time_us in zip(ids, at, strict=True)
                ]
                transaction.execute(sa.insert(jobs), rows)
        # As a database that has lived for a while has done by itself.
        with database.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            connection.execute(sa.text("ANALYZE"))


def _template() -> dict[str, Any]:
    now = time.time_ns() // 1000
    columns = {column.name: None for column in PLANS.columns}
    return {
        **columns, "created_us": now, "kind": "plate_lift", "owner": READER, "fingerprint": "0" * 64, "task": "{}",
        "attempts": 1, "crashes": 0, "fraction": 1.0, "started_us": now,
    }  # fmt: skip


@contextmanager
def _busy(client: httpx.Client, task: dict[str, Any], jobs: int) -> Iterator[list[dict[str, Any]]]:
    """Have jobs run until the block ends."""
    plans = [client.post("/v1/plans", json=task).json() for _ in range(jobs)]
    wait_for(lambda: all(client.get(each["links"]["self"]).json()["state"] == "running" for each in plans), 120.0)
    try:
        yield plans
    finally:
        for plan in plans:
            client.post(plan["links"]["cancel"])


async def _read(client: httpx.Client, plans: Sequence[dict[str, Any]], effort: LoadEffort) -> list[float]:
    """Read plans one after the other, as a person's browser does, and return how long each answer took [s]."""
    seconds = []
    async with _as_asynchronous(client) as reader:
        for n in range(effort.reads):
            begun = time.perf_counter()
            (await reader.get(plans[n % len(plans)]["links"]["self"])).raise_for_status()
            seconds.append(time.perf_counter() - begun)
            await asyncio.sleep(0.002)
    return seconds


def _page(client: httpx.Client) -> Iterator[float]:
    """Walk through the whole list, and yield how long each page took [s]."""
    token: str | None = None
    while True:
        asked = {"page_size": 200} | ({} if token is None else {"page_token": token})
        begun = time.perf_counter()
        page = client.get("/v1/plans", params=asked).raise_for_status().json()
        yield time.perf_counter() - begun
        token = page["next_page_token"]
        if token is None:
            return


def _search(client: httpx.Client, names: Sequence[str]) -> float:
    """Look for plans by the caller's names, and return how long that took in the median [s]."""
    return float(np.median([_searched(client, 1, external_id=name) for name in names]))


def _search_in_vain(client: httpx.Client) -> float:
    return float(np.median([_searched(client, 0, outcome="not_found") for _ in range(20)]))


def _searched(client: httpx.Client, expected: int, **query: str) -> float:
    begun = time.perf_counter()
    page = client.get("/v1/plans", params=query).raise_for_status().json()
    assert len(page["plans"]) == expected, page
    return time.perf_counter() - begun


def _watch(client: httpx.Client, effort: LoadEffort) -> tuple[int, float]:
    """Have many follow one job to its end."""
    plan = client.post("/v1/plans", json=task_body("ab1", simulate=False)).json()
    ends = asyncio.run(_follow(client, plan["links"]["events"], effort.watchers))
    finished(client, plan, 600.0)
    return len(ends), max(ends) - min(ends)


async def _follow(client: httpx.Client, path: str, watchers: int) -> list[float]:
    limits = httpx.Limits(max_connections=watchers, max_keepalive_connections=0)

    async def follow(watcher: httpx.AsyncClient) -> float | None:
        async with watcher.stream("GET", path) as stream:
            async for line in stream.aiter_lines():
                if line == "event: finished":
                    return time.monotonic()
        return None

    async with _as_asynchronous(client, timeout=600.0, limits=limits) as watcher:
        ends = await asyncio.gather(*(follow(watcher) for _ in range(watchers)))
    return [end for end in ends if end is not None]


def _as_asynchronous(client: httpx.Client, timeout: float = 120.0, **settings: Any) -> httpx.AsyncClient:
    """Return a client with the same key."""
    return httpx.AsyncClient(base_url=client.base_url, headers=client.headers, timeout=timeout, **settings)


def _cancel_waiting(settings: WorkerSettings) -> None:
    """Have nothing wait, at once: by requests it would take longer than what is measured."""
    with closing(open_database(settings)) as database:
        jobs = workflow_table(database.engine.dialect.name)
        database.write(sa.update(jobs).where(jobs.c.status.in_(QUEUED)).values(status=CANCELLED))
