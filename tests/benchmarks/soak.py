"""A fleet that plans while its parts are killed at random; afterwards every promise about jobs is checked."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import random
import signal
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self

import httpx
import psutil
import sqlalchemy as sa

from tests.benchmarks.tasks import Note
from tests.support.postgres import PostgresServer, running_postgres
from tests.support.service import ServiceProcess, warmed
from tests.support.worker import WorkerProcess
from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database
from workers.stores.jobs import workflow_table
from workers.stores.tables import DOCUMENTS, PLANS

TAG = "LIFTWRIGHT_SOAK"
"""Environment variable by which every process of a fleet is found, whoever started it."""
OUTSTANDING = 8
"""So many jobs are accepted and not finished, as long as there are more."""
LONGEST_ORPHAN_SECONDS = 5.0
LOST = {"done": True, "state": "lost", "attempts": 0, "error": None}
"""What a plan is from then on that was accepted and is not there."""
STALL_SECONDS = 600.0
"""No job ending for so long is a job that never ends [s]."""


@dataclass(frozen=True)
class SoakSettings:
    """What is planned, and how often what is killed."""

    jobs: int
    kills: int
    postgres: bool
    """Two workers and the API apart on PostgreSQL with a standby, which takes over once; otherwise one process on
    SQLite."""
    body: Callable[[int], dict[str, Any]]
    """The task of the job of each number."""
    solver: tuple[str, ...] | None = None
    """None: the real one."""
    seed: int = 0


@dataclass
class SoakFigures:
    """What has happened, and what was found afterwards. Figures of several add up."""

    jobs: int = 0
    seconds: float = 0.0
    kills: Counter[str] = field(default_factory=Counter)
    states: Counter[str] = field(default_factory=Counter)
    attempts: int = 0
    """Solver processes that began to work on a job."""
    unavailable: int = 0
    """Requests that were answered with 503 or not at all."""
    faults: list[str] = field(default_factory=list)
    """Promises that were broken."""

    def data(self) -> dict[str, Any]:
        """Return all of it as JSON data."""
        # `asdict` would count the pairs of a Counter.
        return {each: dict(value) if isinstance(value, Counter) else value for each, value in vars(self).items()}

    def __add__(self, other: SoakFigures) -> SoakFigures:
        return SoakFigures(*(getattr(self, each.name) + getattr(other, each.name) for each in fields(self)))


@dataclass(frozen=True)
class SoakRound:
    """One fleet that was killed at random, as it is kept in a file."""

    place: str
    seed: int
    figures: dict[str, Any]
    """Its `SoakFigures.data`."""

    @classmethod
    def broken(cls, key: tuple[str, int], error: BaseException) -> Self:
        """Return the round that ended with an error of the fleet, or of whoever killed it."""
        return cls(*key, SoakFigures(faults=[f"the round ended with {error!r:.300}"]).data())

    @property
    def key(self) -> tuple[str, int]:
        """Where, and by what it was drawn."""
        return self.place, self.seed

    @property
    def sums(self) -> SoakFigures:
        """What has happened."""
        counted = {name: Counter(self.figures[name]) for name in ("kills", "states")}
        return SoakFigures(**{**self.figures, **counted})

    def told(self) -> str:
        """Say in a line what came of it."""
        sums = self.sums
        return (
            f"{self.place}, round {self.seed}: {sums.jobs} jobs, {sums.kills.total()} kills in {sums.seconds:.0f} s, "
            f"{len(sums.faults)} broken promises"
        )


def soak(settings: SoakSettings, folder: Path, note: Note) -> SoakFigures:
    """Run a fleet in `folder`, kill its parts while it plans, and check what is left."""
    chance, figures = random.Random(settings.seed), SoakFigures(jobs=settings.jobs)
    begun = time.monotonic()
    with _tagged() as tag, ExitStack() as stack:
        fleet = Fleet(settings, folder, stack)
        client = Client(fleet.api, figures)
        stack.callback(client.close)
        _plan_and_kill(settings, fleet, client, chance, note)
        figures.seconds = time.monotonic() - begun
        _check(settings, fleet, client)
        fleet.stop()
        figures.faults += [f"process {each} was left behind" for each in _left_behind(tag)]
    return figures


class Fleet:
    """The processes that make a service."""

    def __init__(self, settings: SoakSettings, folder: Path, stack: ExitStack) -> None:
        shared = {"poll_seconds": 0.2, "worker_slots": 1, "interruption_limit": 1000, "crash_limit": 10}
        # Started as people start them: what is forked from a loaded process does not bear the tag.
        self.server: PostgresServer | None = None
        """That takes writes now."""
        self._standby: PostgresServer | None = None
        self.workers: list[WorkerProcess] = []
        if settings.solver is None:
            # A fresh fleet would compute the handovers of the shipped tools before it plans.
            for name in ("api", "w0", "w1") if settings.postgres else ("api",):
                warmed(folder / name)
        if settings.postgres:
            self.server = stack.enter_context(running_postgres())
            self._standby = stack.enter_context(self.server.with_standby())
            hosts = "&".join(f"host=127.0.0.1:{each.port}" for each in (self.server, self._standby))
            shared["database_url"] = f"postgresql://liftwright@/liftwright?{hosts}&target_session_attrs=read-write"
            self.workers = [
                WorkerProcess(f"w{n}", folder / f"w{n}", settings.solver, fresh=True, **shared) for n in range(2)
            ]
        command = "api" if settings.postgres else "serve"
        self.api = ServiceProcess(folder / "api", settings.solver, command, fresh=True, **shared)
        stack.callback(self.stop)
        for worker in self.workers:
            worker.launch()
        self.api.start()
        for worker in self.workers:
            worker.wait()
        self.settings = WorkerSettings(data_dir=folder / "api", database_url=shared.get("database_url"))

    def fail_over(self, chance: random.Random) -> str:
        """Kill the database for good, have its standby take over, and return what that is called."""
        assert self.server is not None
        assert self._standby is not None
        chance.choice([self.server.kill, self.server.stop])()
        time.sleep(chance.uniform(0.0, 1.0))
        self._standby.promote()
        self.server, self._standby = self._standby, None
        return "fail-over"

    def kill_something(self, chance: random.Random) -> str:
        """Kill one part that is drawn, start it again, and return its kind."""
        kinds = ["worker", "solver", "api", "postgres"] if self.server else ["service", "solver"]
        weights = [4, 4, 2, 2] if self.server else [1, 1]
        # A solver may just not be there; the others always are.
        while not self._killed(kind := chance.choices(kinds, weights)[0], chance):
            time.sleep(0.1)
        return kind

    def _killed(self, kind: str, chance: random.Random) -> bool:
        pause = chance.uniform(0.0, 1.0)
        if kind == "postgres":
            assert self.server is not None
            chance.choice([self.server.kill, self.server.stop])()
            time.sleep(pause)
            self.server.start()
        elif kind == "worker":
            worker = chance.choice(self.workers)
            worker.end(signal.SIGKILL)
            time.sleep(pause)
            worker.launch()
        elif kind in ("api", "service"):
            self.api.kill()
            time.sleep(pause)
            self.api.start()
        else:
            return self._kill_a_solver(chance)
        return True

    def stop(self) -> None:
        """Ask every process to end, and wait."""
        for worker in self.workers:
            if worker.process is not None:
                # One that was started just now is not ready to be asked yet.
                worker.wait()
                worker.end(signal.SIGTERM)
        self.api.stop()

    def _kill_a_solver(self, chance: random.Random) -> bool:
        found = [each for worker in self.workers if worker.process for each in worker.solvers()]
        found = found or ([] if self.workers else self.api.descendants())
        if not found:
            return False
        try:
            chance.choice(found).kill()
        except psutil.NoSuchProcess:
            return False
        return True


class Client:
    """Posts tasks and waits for them as an MES would: with keys, again and again."""

    def __init__(self, api: ServiceProcess, figures: SoakFigures) -> None:
        self._api, self._figures = api, figures
        self._http = httpx.Client(base_url=api.address, timeout=20.0)
        self.accepted: dict[str, int] = {}
        """The number of the job, by its plan's id."""
        self.ended: dict[str, dict[str, Any]] = {}

    def close(self) -> None:
        """Give the connections back."""
        self._http.close()

    def post(self, number: int, body: dict[str, Any]) -> None:
        """Post a task until it is accepted."""
        answer = self._insist("POST", "/v1/plans", json=body, headers={"Idempotency-Key": f"job-{number}"})
        if answer is not None:
            self.accepted[answer["id"]] = number

    def look(self) -> None:
        """Find out which jobs have ended."""
        for plan_id in [each for each in self.accepted if each not in self.ended]:
            plan = self._insist("GET", f"/v1/plans/{plan_id}") or LOST
            if plan["done"]:
                self.ended[plan_id] = plan

    def have_planned(self, settings: SoakSettings) -> None:
        """Post all tasks, a few at a time, and wait until every job has ended, or none has for long."""
        posted, known, last = 0, 0, time.monotonic()
        while len(self.ended) < settings.jobs and time.monotonic() - last < STALL_SECONDS:
            while posted < settings.jobs and posted - len(self.ended) < OUTSTANDING:
                self.post(posted, settings.body(posted))
                posted += 1
            self.look()
            if len(self.ended) > known:
                known, last = len(self.ended), time.monotonic()
            time.sleep(0.1)

    def document(self, plan_id: str) -> bytes:
        """Fetch a document."""
        return self._http.get(f"/v1/plans/{plan_id}/document").content

    def fault(self, what: str) -> None:
        """Note a broken promise."""
        self._figures.faults.append(what)

    @property
    def figures(self) -> SoakFigures:
        """What has happened so far."""
        return self._figures

    def _insist(self, method: str, path: str, **request: Any) -> dict[str, Any] | None:
        """Ask until there is an answer; None if it is another one than was promised, which is noted."""
        while True:
            try:
                answer = self._http.request(method, path, **request)
            except httpx.TransportError:
                self._figures.unavailable += 1
            else:
                if answer.status_code in (200, 202):
                    return answer.json()
                if answer.status_code != 503:
                    self.fault(f"{method} {path} was answered with {answer.status_code}: {answer.text[:200]}")
                    return None
                self._figures.unavailable += 1
            time.sleep(0.1)


def _plan_and_kill(settings: SoakSettings, fleet: Fleet, client: Client, chance: random.Random, note: Note) -> None:
    """Spread the kills over the jobs: the next one comes some time after its share of them has ended.

    Tasks are posted and asked for all the while, so that kills meet requests that are under way.
    """
    failing_over = chance.randrange(settings.kills) if settings.postgres else None
    with ThreadPoolExecutor(1) as threads:
        customer = threads.submit(client.have_planned, settings)
        for kill in range(settings.kills):
            share = (settings.jobs - 2) * kill // settings.kills
            while len(client.ended) < share and not customer.done():
                time.sleep(0.05)
            if customer.done():
                break
            time.sleep(chance.uniform(0.0, 0.7))
            kind = fleet.fail_over(chance) if kill == failing_over else fleet.kill_something(chance)
            client.figures.kills[kind] += 1
            if kill % 10 == 0:
                note(f"soak: {kill + 1} kills, {len(client.ended)} of {settings.jobs} jobs have ended")
        customer.result()


def _check(settings: SoakSettings, fleet: Fleet, client: Client) -> None:
    """Compare what clients were told with what is stored."""
    for plan_id in client.accepted:
        plan = client.ended.get(plan_id)
        client.figures.states["never ended" if plan is None else plan["state"]] += 1
        client.figures.attempts += 0 if plan is None else plan["attempts"]
        if plan is None or plan["state"] != "succeeded":
            client.fault(f"plan {plan_id} ended as {plan and (plan['state'], plan['error'])}")
    database = open_database(fleet.settings)
    try:
        for what in _stored_faults(settings.jobs, database, client):
            client.fault(what)
    finally:
        database.close()


def _stored_faults(jobs: int, database: Database, client: Client) -> Iterator[str]:
    workflows = workflow_table(database.engine.dialect.name)
    with database.engine.connect() as connection:
        plans = connection.scalars(sa.select(PLANS.c.id)).all()
        ended = connection.execute(sa.select(workflows.c.workflow_uuid, workflows.c.status)).all()
        documents = connection.execute(sa.select(DOCUMENTS)).all()
    if sorted(plans) != sorted(client.accepted) or len(set(client.accepted.values())) != jobs:
        yield f"{jobs} tasks were posted, {len(client.accepted)} accepted, {len(plans)} plans are stored"
    if sorted((row.workflow_uuid, row.status) for row in ended) != sorted((each, "SUCCESS") for each in plans):
        yield f"the engine's jobs are {Counter(row.status for row in ended)}"
    if sorted(row.plan_id for row in documents) != sorted(plans):
        yield f"{len(documents)} documents are stored for {len(plans)} plans"
    for row in documents:
        body = gzip.decompress(row.gzip)
        if hashlib.sha256(body).hexdigest() != row.sha256 or json.loads(body)["id"] != row.plan_id:
            yield f"the document of {row.plan_id} is not what its hash says"
        if client.document(row.plan_id) != body:
            yield f"the document of {row.plan_id} is served as something else"


@contextmanager
def _tagged() -> Iterator[str]:
    """Mark all processes that are started meanwhile."""
    tag = uuid.uuid4().hex
    os.environ[TAG] = tag
    try:
        yield tag
    finally:
        del os.environ[TAG]


def _left_behind(tag: str) -> Sequence[str]:
    deadline = time.monotonic() + LONGEST_ORPHAN_SECONDS
    while (found := list(_bearers(tag))) and time.monotonic() < deadline:
        time.sleep(0.1)
    return found


def _bearers(tag: str) -> Iterator[str]:
    for process in psutil.process_iter():
        try:
            marked = process.environ().get(TAG) == tag
            # The database server belongs to the harness, and ends after this.
            if marked and process.pid != os.getpid() and process.name() != "postgres":
                yield " ".join(process.cmdline())
        except psutil.Error:
            continue
