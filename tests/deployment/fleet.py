"""`make fleet`: the fleet of docker-compose.yml is built, run, scaled, broken, upgraded, backed up and restored.

All of what is committed, in containers of podman's (see `containers`), as a factory would do it after the README:
nothing is reached into but by `liftwright`, HTTP, and the tools of the database. Whatever a step expects and does not
find ends the run; nothing is left running.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from tests.deployment.containers import BASES, Containers

ROOT = Path(__file__).resolve().parents[2]
IMAGE = "liftwright:0.1.0"
BACKUP = "/var/lib/postgresql/data/backup"
"""Where a container of the database may write."""
FOLDER = Path("/var/tmp/liftwright-fleet")
"""For images and volumes, some GB."""
PASSWORD = "p@ss/w:rd#1 %41"
"""With what stands in addresses for something else."""
SERVICES = ("postgres", "api", "worker")
WORKERS, MORE_WORKERS = 2, 3
FACTS = ("/proc/1/status", "/proc/1/mounts")
"""What a container's first process is, as the kernel tells it."""
STARTUP_SECONDS = 300.0
DOWN_SECONDS = 120.0
PLANNING_SECONDS = 1800.0
QUICK, MANY = "ab1", 6
"""A shipped task that is planned again and again, and how often."""
TRIES = 3
"""So often a worker is killed until it had a job: between two it has none for a moment."""
KILLS = {"worker": 12, "api": 6, "postgres": 6}
"""How often a container of each service is killed, in an order by chance."""
KILL_SEED = 1000
UNFINISHED = 4
"""With so many jobs that have not ended, the next container is killed."""
PAUSE_SECONDS, DOWN_FOR_SECONDS = 1.5, 2.0
"""So long it is waited at most before a kill, and before what was killed is started again."""


@dataclass
class FleetFigures:
    """What was measured, in seconds where nothing else is said."""

    image_bytes: int = 0
    building: float = 0.0
    """Of the image; layers that an earlier run has made are there."""
    rebuilding: float = 0.0
    """For another commit that changes none of its files."""
    starting: float = 0.0
    """API and workers, until the API is ready and the workers are healthy."""
    compiled: int = 0
    """Kernels that containers compiled after their start [1]."""
    outcomes: dict[str, str] = field(default_factory=dict)
    """Of the shipped tasks."""
    scaling: float = 0.0
    """Until the third worker is healthy."""
    taken_over: int = 0
    """Jobs of a worker that was killed, done by others [1]."""
    upgrading: float = 0.0
    """Until API and workers of the rebuilt image are ready."""
    waited: int = 0
    """Jobs that were accepted before the image was replaced, and planned by the rebuilt one [1]."""
    kills: dict[str, int] = field(default_factory=dict)
    """Containers that were killed at random, by service [1]."""
    outlived: int = 0
    """Jobs that were accepted meanwhile; each ended once, with the document that its hash says [1]."""
    begun_anew: int = 0
    """How often these were begun again [1]."""
    restored: int = 0
    """Documents that are the same after the database was lost and restored [1]."""


class Fleet:
    """The services of docker-compose.yml."""

    def __init__(self, containers: Containers) -> None:
        self._containers = containers
        self.source = containers.folder / "source"
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self._port = probe.getsockname()[1]
        self.key = ""

    def take_source(self) -> None:
        """Take what is committed."""
        shutil.rmtree(self.source, ignore_errors=True)
        self.source.mkdir()
        archive = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout
        subprocess.run(["tar", "--extract", f"--directory={self.source}"], input=archive, check=True)
        # Quoted, as the README has it: unquoted, a # would begin a comment.
        (self.source / ".env").write_text(f"POSTGRES_PASSWORD='{PASSWORD}'\nLIFTWRIGHT_PORT={self._port}\n")

    def build(self, commit: str) -> float:
        """Build the image, and return how long it took [s]."""
        begun = time.monotonic()
        base = next(image for image in BASES if "python" in image)
        file = self.source / "Dockerfile"
        self._containers.build(IMAGE, file, self.source, with_pip=True, BASE=base, COMMIT=commit)
        return time.monotonic() - begun

    def image_bytes(self) -> int:
        """Size of the image, its base included."""
        return int(self._containers.podman("image", "inspect", "--format={{.Size}}", IMAGE))

    def compose(self, *words: object) -> str:
        """Run podman-compose on the fleet."""
        command = self._containers.composer()
        return self._containers.run(command, "--project-name=liftwright", *words, cwd=self.source)

    def names(self, service: str) -> list[str]:
        """Return the names of the containers of a service that run."""
        told = self._containers.podman("ps", "--format={{.Names}}", f"--filter=name=liftwright_{service}_")
        return told.split()

    def up(self, *words: object, workers: int = WORKERS) -> float:
        """Start what does not run, and return after how long the API was ready and so many workers healthy [s]."""
        begun = time.monotonic()
        self.compose("up", "--detach", "--no-build", f"--scale=worker={workers}", *words)
        self.wait_until_ready(workers)
        return time.monotonic() - begun

    def wait_until_ready(self, workers: int) -> None:
        """Wait until the API is ready, and so many workers are healthy."""
        wait_until(self._is_ready, STARTUP_SECONDS, "the API is ready")
        wait_until(lambda: len(self.healthy("worker")) == workers, STARTUP_SECONDS, f"{workers} workers are healthy")

    def start_database(self) -> None:
        """Start the database alone, and wait until it answers."""
        self.compose("up", "--detach", "--no-build", "postgres")
        wait_until(lambda: bool(self.healthy("postgres")), STARTUP_SECONDS, "the database answers")

    def issue_key(self) -> None:
        """Issue a key, as the compose file says."""
        words = ("run", "--rm", "api", "liftwright", "keys", "issue", "--owner=it", "--scope=admin")
        (self.key,) = re.findall(r"^(\S{30,})\s*$", self.compose(*words), re.MULTILINE)

    def healthy(self, service: str) -> list[str]:
        """Return the containers of a service whose health check holds; all are asked at once."""
        names = self.names(service)
        with ThreadPoolExecutor(max(1, len(names))) as pool:
            return [name for name, holds in zip(names, pool.map(self._is_healthy, names), strict=True) if holds]

    def kill(self, name: str) -> int:
        """Kill a container, as the kernel does one that takes too much, and return the process that it was."""
        process = self._process(name)
        self._containers.podman("kill", "--signal=KILL", name)
        return process

    def begin_again(self, name: str, killed: int) -> None:
        """Start a container whose process was killed, unless it was started again by itself."""

        def runs() -> bool:
            # Podman may not have noticed yet that it has ended, and then does nothing.
            self._containers.podman("start", name, check=False)
            return self._process(name) not in (0, killed)

        wait_until(runs, DOWN_SECONDS, f"{name} runs again")

    def faults_of_hardening(self) -> list[str]:
        """Return what is not as docker-compose.yml says of the containers that run, asked within each."""
        names = [name for service in SERVICES for name in self.names(service)]
        return [f"{name} {fault}" for name in names for fault in faults_of_hardening(*map(self._reader(name), FACTS))]

    def _reader(self, name: str) -> Callable[[str], str]:
        return lambda path: self._containers.podman("exec", name, "cat", path)

    def _process(self, name: str) -> int:
        """Return the first process of a container; 0 if there is none."""
        return int(self._containers.podman("inspect", "--format={{.State.Pid}}", name))

    def compiled_since_start(self, service: str) -> int:
        """Count kernels that the containers of a service have written since they were started."""
        count, podman = 0, self._containers.podman
        for name in self.names(service):
            started = podman("inspect", "--format={{.State.StartedAt.Unix}}", name).strip()
            count += int(podman("exec", name, "sh", "-c", f"find /kernels -name '*.nb?' -newermt @{started} | wc -l"))
        return count

    @contextmanager
    def client(self) -> Iterator[httpx.Client]:
        """Return a client with the key."""
        headers = {"Authorization": f"Bearer {self.key}"}
        with httpx.Client(base_url=f"http://127.0.0.1:{self._port}", headers=headers, timeout=60.0) as client:
            yield client

    def dump(self, file: Path) -> None:
        """Back the database up, while all of it runs, as docs/operations.md says."""
        name, words = self.names("postgres")[0], ("--host=127.0.0.1", "--username=liftwright", f"--file={BACKUP}")
        self._with_password(name, "pg_dump", "--format=custom", *words, "liftwright")
        self._containers.podman("cp", f"{name}:{BACKUP}", file)

    def restore(self, file: Path) -> None:
        """Restore the database into an empty one."""
        name = self.names("postgres")[0]
        self._containers.podman("cp", file, f"{name}:{BACKUP}")
        words = ("--host=127.0.0.1", "--username=liftwright", "--dbname=liftwright", BACKUP)
        self._with_password(name, "pg_restore", *words)

    def log(self) -> None:
        """Keep the last lines that each container has written, in the log of all commands."""
        for name in self._containers.podman("ps", "--all", "--format={{.Names}}").split():
            self._containers.run("sh", "-c", f"podman logs --tail=50 {name} 2>&1", check=False)

    def down(self) -> None:
        """Take all of it down, with what it kept."""
        self.compose("down", "--volumes", "--timeout=30")
        # One that ends and is begun again, over and over, is not taken down by compose.
        for kind, every in (("pod", ()), ("container", ("--all",)), ("volume", ())):
            wait_until(lambda kind=kind, every=every: self._gone(kind, *every), DOWN_SECONDS, f"no {kind} is left")

    def _gone(self, kind: str, *every: str) -> bool:
        """Remove all of a kind; podman gives up on one that ends by itself just then."""
        self._containers.podman(kind, "rm", "--force", "--all", check=False)
        return not self._containers.podman(kind, "ls", "--quiet", *every).strip()

    def _with_password(self, name: str, *words: str) -> None:
        self._containers.podman("exec", f"--env=PGPASSWORD={PASSWORD}", name, *words)

    def _is_healthy(self, name: str) -> bool:
        # Nobody runs the checks by themselves where there is no systemd.
        told = self._containers.podman("healthcheck", "run", name, check=False)
        return (
            "unhealthy" not in told
            and self._containers.podman("inspect", "--format={{.State.Healthcheck.Status}}", name).strip() == "healthy"
        )

    def _is_ready(self) -> bool:
        try:
            return httpx.get(f"http://127.0.0.1:{self._port}/readyz", timeout=5.0).status_code == 200
        except httpx.TransportError:
            return False


def measure(folder: Path, note: Callable[[str], None]) -> FleetFigures:
    """Do all of it, and return what was measured; about half an hour the first time.

    Raises:
        RuntimeError: Something did not go as it has to.
    """
    containers = Containers(folder, note)
    fleet, figures = Fleet(containers), FleetFigures()
    containers.make_bases()
    fleet.take_source()
    note("building the image")
    figures.building, figures.image_bytes = fleet.build("first"), fleet.image_bytes()
    note(f"built in {figures.building:.0f} s, {figures.image_bytes / 1e9:.2f} GB")
    fleet.down()
    try:
        _run(fleet, figures, note)
    except BaseException:
        # What they say is gone with them.
        fleet.log()
        raise
    finally:
        fleet.down()
    return figures


def _run(fleet: Fleet, figures: FleetFigures, note: Callable[[str], None]) -> None:
    fleet.start_database()
    fleet.issue_key()
    figures.starting = fleet.up()
    note(f"ready {figures.starting:.1f} s after the start, with {WORKERS} workers")
    require(not (faults := fleet.faults_of_hardening()), f"all containers are hardened: {', '.join(faults)}")
    with fleet.client() as client:
        for path, status in {"/livez": 200, "/readyz": 200, "/v1/plans": 421}.items():
            asked = client.get(path, headers={"Host": "elsewhere.example"}).status_code
            require(
                asked == status, f"{path} by a name that is not the API's is answered with {status}, and not {asked}"
            )
        _plan_shipped_tasks(client, figures, note)
        figures.compiled = fleet.compiled_since_start("api") + fleet.compiled_since_start("worker")
        note(f"{figures.compiled} kernels compiled since the start")
        figures.scaling = fleet.up(workers=MORE_WORKERS)
        note(f"{MORE_WORKERS} workers, {figures.scaling:.0f} s later")
        figures.taken_over = _kill_a_worker(fleet, client)
        require(figures.taken_over > 0, f"one of {TRIES} workers that were killed had a job")
        note(f"a worker was killed; {figures.taken_over} of its jobs were done by others")
        figures.rebuilding = fleet.build("second")
        # More of them than there are workers, and each takes longer than it takes to stop these.
        waiting = [_post(client, QUICK, seed) for seed in range(100, 100 + MANY)]
        figures.upgrading = fleet.up("--force-recreate", workers=MORE_WORKERS)
        ended = _all_succeed(client, waiting)
        figures.waited = sum(_document(client, plan)["software"]["commit"] == "second" for plan in ended)
        require(figures.waited > 0, "jobs that were accepted before the upgrade are planned by the rebuilt image")
        note(f"upgraded in {figures.upgrading:.0f} s; {figures.waited} jobs waited for it, and ended after it")
        _kill_at_random(fleet, client, figures)
        told = ", ".join(f"{number} of {service}" for service, number in figures.kills.items())
        note(f"killed: {told}; {figures.outlived} jobs ended once each, begun again {figures.begun_anew} times")
        before = _documents(client)
    backup = fleet.source / "backup"
    fleet.dump(backup)
    fleet.down()
    note("the database is gone")
    fleet.start_database()
    fleet.restore(backup)
    fleet.up()
    with fleet.client() as client:
        again = _documents(client)
    require(again == before, "what was backed up is there again, document for document")
    figures.restored = len(again)
    note(f"restored: {figures.restored} documents, and the key")


def _plan_shipped_tasks(client: httpx.Client, figures: FleetFigures, note: Callable[[str], None]) -> None:
    names = sorted(path.stem for path in (ROOT / "assets/tasks").glob("*.json"))
    plans = {name: _post(client, name) for name in names}
    for name, plan in plans.items():
        _all_succeed(client, [plan])
        document = _document(client, plan)
        figures.outcomes[name] = document["outcome"]
        certificate = document["certificate"]
        require(document["outcome"] != "solved" or certificate["passed"], f"{name} is certified")
    note(f"{len(names)} shipped tasks: {', '.join(f'{name} {outcome}' for name, outcome in figures.outcomes.items())}")


def _kill_a_worker(fleet: Fleet, client: httpx.Client) -> int:
    """Kill a worker that has a job, and return how many jobs others had to begin again; what was killed stays so."""
    taken_over = 0
    for first in range(0, TRIES * MANY, MANY):
        workers = sorted(fleet.names("worker"))
        plans = [_post(client, QUICK, seed) for seed in range(first, first + MANY)]
        # Each has one place: then whichever is killed has a job, if that does not end just now.
        wait_until(lambda plans=plans, workers=workers: _running(client, plans) == len(workers), 120.0, "all have jobs")
        killed = fleet.kill(workers[0])
        taken_over = sum(plan["attempts"] > 1 for plan in _all_succeed(client, plans))
        if taken_over:
            break
        fleet.begin_again(workers[0], killed)
    return taken_over


def _running(client: httpx.Client, plans: Iterable[dict[str, Any]]) -> int:
    return sum(_plan(client, plan)["state"] == "running" for plan in plans)


def _kill_at_random(fleet: Fleet, client: httpx.Client, figures: FleetFigures) -> None:
    """Kill containers while tasks are posted and planned, and require that no job is lost or done twice."""
    chance = random.Random(KILL_SEED)
    order = [service for service, number in KILLS.items() for _ in range(number)]
    chance.shuffle(order)
    before, made = len(_listed(client)), _documents_made(client)
    accepted: list[dict[str, Any]] = []
    unfinished: list[dict[str, Any]] = []
    with ThreadPoolExecutor(1) as poster:
        for number, service in enumerate(order):
            coming = poster.submit(_post_until_accepted, client, KILL_SEED + number)
            time.sleep(chance.uniform(0.0, PAUSE_SECONDS))
            wait_until(lambda service=service: bool(fleet.names(service)), STARTUP_SECONDS, f"{service} runs")
            name = chance.choice(sorted(fleet.names(service)))
            killed = fleet.kill(name)
            figures.kills[service] = figures.kills.get(service, 0) + 1
            time.sleep(chance.uniform(0.0, DOWN_FOR_SECONDS))
            fleet.begin_again(name, killed)
            accepted.append(coming.result())
            unfinished.append(accepted[-1])
            deadline = time.monotonic() + PLANNING_SECONDS
            while len(unfinished := [plan for plan in unfinished if not _plan(client, plan)["done"]]) > UNFINISHED:
                require(time.monotonic() < deadline, f"jobs end after the kill of {name}")
                time.sleep(0.5)
    ended = _all_succeed(client, accepted)
    listed = [plan["id"] for plan in _listed(client)]
    require(len({plan["id"] for plan in ended}) == len(order), "each task is a plan of its own")
    require({plan["id"] for plan in ended} <= set(listed), "each plan that was accepted is listed")
    require(len(listed) == len(set(listed)) == before + len(order), "no task was accepted twice")
    for plan in ended:
        answer = client.get(plan["links"]["document"]).raise_for_status()
        said = answer.headers["ETag"].removeprefix("W/").strip('"')
        require(
            hashlib.sha256(answer.content).hexdigest() == said, f"the document of {plan['id']} is what its hash says"
        )
        require(answer.json()["id"] == plan["id"], f"the document of {plan['id']} is its own")
    require(_documents_made(client) - made == len(order), "each job has made one document")
    figures.outlived, figures.begun_anew = len(ended), sum(plan["attempts"] - 1 for plan in ended)
    fleet.wait_until_ready(MORE_WORKERS)


def _documents_made(client: httpx.Client) -> int:
    """Return how many documents all workers together have ever made."""
    text = client.get("/metrics").raise_for_status().text
    return sum(
        int(float(number)) for number in re.findall(r"^liftwright_documents_made_total\{.*\} (\S+)$", text, re.M)
    )


def _post_until_accepted(client: httpx.Client, seed: int) -> dict[str, Any]:
    """Post a task until it is accepted, by a key of its own, so that a repeat after a lost answer is none."""
    task = {**json.loads((ROOT / f"assets/tasks/{QUICK}.json").read_text()), "seed": seed}
    deadline = time.monotonic() + STARTUP_SECONDS
    while True:
        try:
            answer = client.post("/v1/plans", json=task, headers={"Idempotency-Key": f"order-{seed}"})
        except httpx.TransportError:
            answer = None
        if answer is not None and answer.status_code != httpx.codes.SERVICE_UNAVAILABLE:
            return answer.raise_for_status().json()
        require(time.monotonic() < deadline, f"a task is accepted within {STARTUP_SECONDS:.0f} s")
        time.sleep(0.5)


def _post(client: httpx.Client, name: str, seed: int | None = None) -> dict[str, Any]:
    task = json.loads((ROOT / f"assets/tasks/{name}.json").read_text())
    answer = client.post("/v1/plans", json={**task, **({} if seed is None else {"seed": seed})})
    return answer.raise_for_status().json()


def _plan(client: httpx.Client, plan: dict[str, Any]) -> dict[str, Any]:
    """Return how a plan stands; the API may be away for a while."""
    for _ in range(120):
        try:
            answer = client.get(plan["links"]["self"])
        except httpx.TransportError:
            answer = None
        if answer is not None and answer.status_code == 200:
            return answer.json()
        time.sleep(1.0)
    raise RuntimeError(f"the plan {plan['id']} cannot be asked for")


def _all_succeed(client: httpx.Client, plans: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Wait until jobs have ended; they have to have succeeded."""
    ended = []
    for plan in plans:
        wait_until(lambda plan=plan: _plan(client, plan)["done"], PLANNING_SECONDS, f"{plan['id']} ends")
        ended.append(_plan(client, plan))
        require(ended[-1]["state"] == "succeeded", f"{plan['id']} succeeds, and is not {ended[-1]['state']}")
    return ended


def _document(client: httpx.Client, plan: dict[str, Any]) -> dict[str, Any]:
    return client.get(plan["links"]["document"]).raise_for_status().json()


def _documents(client: httpx.Client) -> dict[str, str]:
    """Return the hashes of all documents by plan."""
    return {
        plan["id"]: hashlib.sha256(client.get(plan["links"]["document"]).raise_for_status().content).hexdigest()
        for plan in _listed(client)
    }


def _listed(client: httpx.Client) -> list[dict[str, Any]]:
    """Return all plans."""
    listed, token = [], {}
    while token is not None:
        page = client.get("/v1/plans", params={"page_size": 100, **token}).raise_for_status().json()
        listed += page["plans"]
        token = {"page_token": page["next_page_token"]} if page["next_page_token"] else None
    return listed


def faults_of_hardening(status: str, mounts: str) -> Sequence[str]:
    """Return what of a container is not as it has to be.

    Args:
        status: `/proc/1/status` as it is within.
        mounts: `/proc/1/mounts` likewise.
    """
    facts = {name: value.split() for name, _, value in (line.partition(":") for line in status.splitlines())}
    root = [words[3].split(",") for words in map(str.split, mounts.splitlines()) if words[1] == "/"]
    return [
        fault
        for fault, holds in {
            "runs as root": "0" in facts["Uid"] + facts["Gid"],
            "has capabilities": any(int(facts[each][0], 16) for each in ("CapEff", "CapPrm", "CapInh", "CapBnd")),
            "may gain privileges": facts["NoNewPrivs"] != ["1"],
            "can write to its root file system": not root or any("ro" not in flags for flags in root),
        }.items()
        if holds
    ]


def wait_until(holds: Callable[[], bool], seconds: float, what: str) -> None:
    """Wait until something holds.

    Raises:
        RuntimeError: It did not for so long [s].
    """
    deadline = time.monotonic() + seconds
    while not holds():
        require(time.monotonic() < deadline, f"within {seconds:.0f} s {what}")
        time.sleep(0.5)


def require(holds: bool, what: str) -> None:
    """Raise what was expected and is not so."""
    if not holds:
        raise RuntimeError(f"expected, and not so: {what}")


def main() -> None:
    """Run it all, and print what was measured."""
    parser = argparse.ArgumentParser(prog="make fleet", description=__doc__)
    parser.add_argument(
        "--folder",
        type=Path,
        default=FOLDER,
        metavar="DIR",
        help="for images and volumes, some GB; kept, so that the next run is quicker; default: %(default)s",
    )
    folder = parser.parse_args().folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    begun = time.monotonic()

    def note(what: str) -> None:
        print(f"{time.monotonic() - begun:6.0f} s  {what}", file=sys.stderr, flush=True)

    print(json.dumps(vars(measure(folder, note)), indent=1))


if __name__ == "__main__":
    main()
