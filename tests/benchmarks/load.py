"""How fast the service answers while both cores plan, with thousands of plans stored and hundreds of watchers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import sqlalchemy as sa

from tests.benchmarks.tasks import Note, task_body
from tests.support.service import ServiceProcess, finished, running_service, wait_for
from workers.settings import WorkerSettings
from workers.stores.database import open_database
from workers.stores.tables import PLANS

ROWS_A_TIME = 500


@dataclass(frozen=True)
class LoadEffort:
    """How much is asked."""

    submissions: int = 1000
    senders: int = 8
    reads: int = 2000
    stored: int = 10_000
    watchers: int = 200
    busy_jobs: int = 2
    """Jobs that plan meanwhile."""


@dataclass(frozen=True)
class LoadFigures:
    """Milliseconds unless it says otherwise."""

    submissions_per_second: float
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


def measure(effort: LoadEffort, solver: Sequence[str], folder: Path, note: Note) -> LoadFigures:
    """Run a service, keep its solvers busy, and ask."""
    settings = {"worker_slots": 2, "max_queued": 1_000_000, "requests_per_second": 1e6, "request_burst": 1_000_000}
    with running_service(folder, tuple(solver), **settings) as service, service.client() as client:
        note(f"load: storing {effort.stored} plans")
        _store(folder, effort.stored)
        with _busy(client, effort.busy_jobs):
            note(f"load: {effort.submissions} submissions")
            rate = asyncio.run(_submit(service.address, effort))
            _cancel_the_rest(client)
        with _busy(client, effort.busy_jobs) as plans:
            note(f"load: {effort.reads} reads")
            reads = 1e3 * np.array(asyncio.run(_read(service.address, plans, effort)))
            note("load: pages")
            pages = 1e3 * np.array(list(_page(client)))
            note("load: searches")
            search = 1e3 * _search(client, [f"{n:032x}" for n in range(0, effort.stored, effort.stored // 100)])
            vain_search = 1e3 * _search_in_vain(client)
        note(f"load: {effort.watchers} watchers")
        watchers, lag = _watch(service, client, effort)
    return LoadFigures(
        rate, float(np.percentile(reads, 50)), float(np.percentile(reads, 99)), float(reads.max()),
        float(pages[0]), float(np.median(pages[-5:])), len(pages), search, vain_search,
        watchers, lag,
    )  # fmt: skip


def _store(folder: Path, number: int) -> None:
    """Copy one accepted and finished plan, with its job, as often as asked."""
    database = open_database(WorkerSettings(data_dir=folder))
    try:
        with database.engine.begin() as transaction:
            jobs = sa.Table("workflow_status", sa.MetaData(), autoload_with=database.engine)
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
    finally:
        database.close()


def _template() -> dict[str, Any]:
    now = time.time_ns() // 1000
    columns = {column.name: None for column in PLANS.columns}
    return {
        **columns, "created_us": now, "kind": "plate_lift", "fingerprint": "0" * 64, "task": "{}", "attempts": 1,
        "crashes": 0, "fraction": 1.0, "started_us": now,
    }  # fmt: skip


@contextmanager
def _busy(client: httpx.Client, jobs: int) -> Iterator[list[dict[str, Any]]]:
    """Have jobs plan until the block ends."""
    body = task_body("ab1", contact_density=2.0, hold_density=2.0)
    plans = [client.post("/v1/plans", json=body).json() for _ in range(jobs)]
    wait_for(lambda: all(client.get(each["links"]["self"]).json()["state"] == "running" for each in plans), 120.0)
    try:
        yield plans
    finally:
        for plan in plans:
            client.post(plan["links"]["cancel"])


async def _submit(address: str, effort: LoadEffort) -> float:
    """Post tasks from several connections at once; return how many were accepted a second."""
    body = task_body("pb1_weak_cup")
    left = iter(range(effort.submissions))

    async def send(client: httpx.AsyncClient) -> int:
        accepted = 0
        for _ in left:
            accepted += (await client.post("/v1/plans", json=body)).status_code == 202
        return accepted

    begun = time.perf_counter()
    async with httpx.AsyncClient(base_url=address, timeout=120.0) as client:
        accepted = sum(await asyncio.gather(*(send(client) for _ in range(effort.senders))))
    return accepted / (time.perf_counter() - begun)


async def _read(address: str, plans: Sequence[dict[str, Any]], effort: LoadEffort) -> list[float]:
    """Read plans one after the other, as a person's browser does, and return how long each answer took [s]."""
    seconds = []
    async with httpx.AsyncClient(base_url=address, timeout=120.0) as client:
        for n in range(effort.reads):
            begun = time.perf_counter()
            (await client.get(plans[n % len(plans)]["links"]["self"])).raise_for_status()
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


def _watch(service: ServiceProcess, client: httpx.Client, effort: LoadEffort) -> tuple[int, float]:
    """Have many follow one job to its end."""
    plan = client.post("/v1/plans", json=task_body("ab1", simulate=False)).json()
    ends = asyncio.run(_follow(service.address, plan["links"]["events"], effort.watchers))
    finished(client, plan, 600.0)
    return len(ends), max(ends) - min(ends)


async def _follow(address: str, path: str, watchers: int) -> list[float]:
    limits = httpx.Limits(max_connections=watchers, max_keepalive_connections=0)

    async def follow(client: httpx.AsyncClient) -> float | None:
        async with client.stream("GET", path) as stream:
            async for line in stream.aiter_lines():
                if line == "event: finished":
                    return time.monotonic()
        return None

    async with httpx.AsyncClient(base_url=address, timeout=600.0, limits=limits) as client:
        ends = await asyncio.gather(*(follow(client) for _ in range(watchers)))
    return [end for end in ends if end is not None]


def _cancel_the_rest(client: httpx.Client) -> None:
    """Have nothing wait or run."""
    for state in ("queued", "running"):
        while plans := client.get("/v1/plans", params={"page_size": 200, "state": state}).json()["plans"]:
            for plan in plans:
                client.post(plan["links"]["cancel"])
