"""`make fleet`: the fleet of docker-compose.yml is built, run, scaled, broken, upgraded, backed up and restored.

All of what is committed, in containers of podman's (see `containers`), as a factory would do it after the README:
nothing is reached into but by `liftwright`, HTTP, and the tools of the database. Whatever a step expects and does not
find ends the run; nothing is left running.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
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
PASSWORD = "p@ss/w:rd#1 %"
"""What stands in URLs for something else, too."""
STARTUP_SECONDS = 300.0
DOWN_SECONDS = 120.0
PLANNING_SECONDS = 1800.0
QUICK, MANY = "ab1", 6
"""A shipped task that is planned again and again, and how often."""


@dataclass
class FleetFigures:
    """What was measured, in seconds where nothing else is said."""

    image_bytes: int = 0
    building: float = 0.0
    """Of the image; layers that an earlier run has made are there."""
    rebuilding: float = 0.0
    """For another commit that changes none of its files."""
    starting: float = 0.0
    """API and workers, until the API is ready."""
    compiled: int = 0
    """Kernels that containers compiled after their start [1]."""
    outcomes: dict[str, str] = field(default_factory=dict)
    """Of the shipped tasks."""
    scaling: float = 0.0
    """Until the third worker is healthy."""
    taken_over: int = 0
    """Jobs of a worker that was killed, done by others [1]."""
    upgrading: float = 0.0
    """Until the API of the rebuilt image is ready."""
    waited: int = 0
    """Jobs that had not ended when the image was replaced, and did after it [1]."""
    restored: int = 0
    """Documents that are the same after the database was lost and restored [1]."""


class Fleet:
    """The services of docker-compose.yml."""

    def __init__(self, containers: Containers) -> None:
        self._containers = containers
        self.source = containers.folder / "source"
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self._port = probe.getsockname()[1]
        self._environment = {"POSTGRES_PASSWORD": PASSWORD, "LIFTWRIGHT_PORT": str(self._port)}
        self.key = ""

    def take_source(self) -> None:
        """Take what is committed."""
        shutil.rmtree(self.source, ignore_errors=True)
        self.source.mkdir()
        archive = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout
        subprocess.run(["tar", "--extract", f"--directory={self.source}"], input=archive, check=True)

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
        return self._containers.run(
            command, "--project-name=liftwright", *words, cwd=self.source, environment=self._environment
        )

    def names(self, service: str) -> list[str]:
        """Return the names of the containers of a service that run."""
        told = self._containers.podman("ps", "--format={{.Names}}", f"--filter=name=liftwright_{service}_")
        return told.split()

    def up(self, *words: object) -> float:
        """Start what does not run, and return after how long the API was ready [s]."""
        begun = time.monotonic()
        self.compose("up", "--detach", "--no-build", *words)
        wait_until(self._is_ready, STARTUP_SECONDS, "the API is ready")
        return time.monotonic() - begun

    def start_database(self) -> None:
        """Start the database alone, and wait until it answers."""
        self.compose("up", "--detach", "--no-build", "postgres")
        wait_until(lambda: bool(self.healthy("postgres")), STARTUP_SECONDS, "the database answers")

    def issue_key(self) -> None:
        """Issue a key, as the compose file says."""
        words = ("run", "--rm", "api", "liftwright", "keys", "issue", "--owner=it", "--scope=admin")
        (self.key,) = re.findall(r"^(\S{30,})\s*$", self.compose(*words), re.MULTILINE)

    def healthy(self, service: str) -> list[str]:
        """Return the containers of a service whose health check holds."""
        return [name for name in self.names(service) if self._is_healthy(name)]

    def kill(self, name: str) -> None:
        """Kill a container, as the kernel does one that takes too much."""
        self._containers.podman("kill", "--signal=KILL", name)

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
    note(f"ready {figures.starting:.1f} s after the start, with {len(fleet.names('worker'))} workers")
    with fleet.client() as client:
        _plan_shipped_tasks(client, figures, note)
        figures.compiled = fleet.compiled_since_start("api") + fleet.compiled_since_start("worker")
        note(f"{figures.compiled} kernels compiled since the start")
        begun = time.monotonic()
        fleet.up("--scale=worker=3")
        wait_until(lambda: len(fleet.healthy("worker")) == 3, STARTUP_SECONDS, "three workers are healthy")
        figures.scaling = time.monotonic() - begun
        note(f"three workers, {figures.scaling:.0f} s later")
        figures.taken_over = _kill_a_worker(fleet, client)
        note(f"a worker was killed; {figures.taken_over} of its jobs were done by others")
        waiting = [_post(client, QUICK, seed) for seed in range(100, 100 + MANY)]
        figures.rebuilding = fleet.build("second")
        figures.upgrading = fleet.up("--force-recreate", "--scale=worker=3")
        figures.waited = sum(not _plan(client, plan)["done"] for plan in waiting)
        _all_succeed(client, waiting)
        note(f"upgraded in {figures.upgrading:.0f} s; {figures.waited} jobs waited for it, and ended after it")
        after = _all_succeed(client, [_post(client, QUICK, 200)])
        require(_document(client, after[0])["software"]["commit"] == "second", "the rebuilt image plans")
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
    plans = [_post(client, QUICK, seed) for seed in range(MANY)]
    wait_until(lambda: sum(_plan(client, plan)["state"] == "running" for plan in plans) >= 2, 120.0, "two jobs run")
    fleet.kill(fleet.names("worker")[0])
    attempts = [_plan(client, plan)["attempts"] for plan in _all_succeed(client, plans)]
    return sum(number > 1 for number in attempts)


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
    listed, token = [], {}
    while token is not None:
        page = client.get("/v1/plans", params={"page_size": 100, **token}).raise_for_status().json()
        listed += page["plans"]
        token = {"page_token": page["next_page_token"]} if page["next_page_token"] else None
    return {
        plan["id"]: hashlib.sha256(client.get(plan["links"]["document"]).raise_for_status().content).hexdigest()
        for plan in listed
    }


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
