"""A real service for tests: a process of its own on a free port of this machine, with a store of its own."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self, TypeVar

import httpx
import psutil

from planners.regrasp.grasps.handovers import handover_key
from workers.settings import HANDOVERS_FOLDER, WorkerSettings
from workers.solver.warm_up import MARK, mark_warm
from workers.stores.handover_store import HandoverStore

from .program import COMMAND_LINE, ROOT, Program, launch
from .samples import sample

TASKS = ROOT / "assets" / "tasks"
FAKE_SOLVER = (sys.executable, "-m", "tests.support.fake_solver")
FAKE_EXAMINER = (sys.executable, "-m", "tests.support.fake_examiner")
API_MODULE = "app.serve"
"""What further processes of an API run."""
STARTUP_SECONDS = 900.0
PATIENCE_SECONDS = 300.0
"""How long tests wait where no time is promised: a busy machine may take long, and is no fault of ours."""
SHORTEST_PAUSE, LONGEST_PAUSE = 0.02, 0.1
"""Between two looks at what is waited for, the longer the wait; looks keep a machine busy, too. Where a second is
promised they stay short [s]."""
T = TypeVar("T")


def task(name: str = "ab1.json", **members: Any) -> dict[str, Any]:
    """Return the body of a bundled task, with some members replaced."""
    return {**json.loads((TASKS / name).read_text()), **members}


def unsolved_task(name: str) -> dict[str, Any]:
    """Return the body of a bundled task that has no plan, for tests that do not look at remedies.

    Those are left out of the quick suite here: to look for them takes several times as long as to find no plan.
    """
    body = task(f"{name}.json")
    return sample({**body, "options": {**body.get("options", {}), "remedies": False}}, body)


class ServiceProcess:
    """`liftwright serve`, or `liftwright api`, in a process of its own."""

    def __init__(
        self,
        data_dir: Path,
        solver: tuple[str, ...] | None,
        command: str = "serve",
        module: str = COMMAND_LINE,
        *,
        fresh: bool = False,
        **settings: Any,
    ) -> None:
        """Take what `program.launch` is to be told."""
        self._command, self._module, self._fresh, self._solver = command, module, fresh, solver
        self._environment = {f"LIFTWRIGHT_{name.upper()}": str(value) for name, value in settings.items()}
        if solver is not None:
            self._environment["LIFTWRIGHT_SOLVER_COMMAND"] = json.dumps(solver)
        self._data_dir = data_dir
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self.port = probe.getsockname()[1]
        self.address = f"http://127.0.0.1:{self.port}"
        self.process: Program | None = None

    def start(self) -> Self:
        """Start, and wait until it is ready."""
        words = [self._command, "--port", str(self.port), "--data-dir", str(self._data_dir)]
        if self._solver is not None and self._command == "serve":
            call_warm(self._data_dir, self._solver)
        fresh = self._fresh or (self._solver is None and sample(quick=False, whole=True))
        self.process = launch(words, self._environment, module=self._module, fresh=fresh)
        # A client takes long to make.
        with self.client() as client:
            wait_for(lambda: self._ready(client), STARTUP_SECONDS)
        return self

    def kill(self) -> None:
        """kill -9, as a power failure would."""
        self._signal(signal.SIGKILL)

    def stop(self) -> None:
        """Ask it to end, and wait."""
        code = self._signal(signal.SIGTERM)
        assert code in (None, 0), f"a stop in order ends with 0, not {code}"

    def client(self) -> httpx.Client:
        """Return a client for it."""
        return httpx.Client(base_url=self.address, timeout=120.0)

    def descendants(self) -> list[psutil.Process]:
        """Return the processes it has started, and those they have started."""
        assert self.process is not None
        return psutil.Process(self.process.pid).children(recursive=True)

    def answering(self) -> list[psutil.Process]:
        """Return the processes that answer requests: itself, and further ones of an API."""
        assert self.process is not None
        further = [each for each in self.descendants() if API_MODULE in each.cmdline()]
        return [psutil.Process(self.process.pid), *further]

    def _ready(self, client: httpx.Client) -> bool:
        assert self.process is not None
        assert self.process.poll() is None, "the service ended instead of getting ready"
        try:
            return client.get("/readyz").status_code == 200
        except httpx.TransportError:
            return False

    def _signal(self, number: signal.Signals) -> int | None:
        """Send a signal, wait, and return the exit code; None where nothing runs."""
        process, self.process = self.process, None
        if process is None:
            return None
        process.send_signal(number)
        return process.wait(timeout=30)


@contextmanager
def running_service(data_dir: Path, solver: tuple[str, ...] | None, **settings: Any) -> Iterator[ServiceProcess]:
    """Run a service for the time of a test."""
    service = ServiceProcess(data_dir, solver, **settings)
    try:
        yield service.start()
    finally:
        service.stop()


def warmed(data_dir: Path) -> Path:
    """Give a data directory what was computed when this tree was set up, so that a service with real solvers need not.

    Where that is missing, or of other sources, the service finds out and computes it. Handovers of tools that have
    changed since, which may lie beside those of today, are left there.
    """
    # Most services that tests start have no planners.
    from workers.solver.pipeline import Pipeline

    kept, given = (HandoverStore(folder / HANDOVERS_FOLDER) for folder in (ROOT / "data", data_dir))
    for cell, tool, settings in Pipeline.load().shipped_handovers():
        database = kept.load(handover_key(cell, tool, settings))
        if database is not None:
            given.save(database)
    with suppress(FileNotFoundError):
        shutil.copy2(ROOT / "data" / HANDOVERS_FOLDER / MARK, data_dir / HANDOVERS_FOLDER / MARK)
    return data_dir


def call_warm(data_dir: Path, solver: tuple[str, ...]) -> None:
    """Spare a solver of tests, which has nothing to compile, a process that finds that out."""
    mark_warm(WorkerSettings(data_dir=data_dir, solver_command=solver))


def wait_for(holds: Callable[[], T], seconds: float = PATIENCE_SECONDS) -> T:
    """Wait until `holds()` is true, and return what it returned; `seconds` are given where they are promised."""
    deadline, pause = time.monotonic() + seconds, SHORTEST_PAUSE
    longest = min(LONGEST_PAUSE, SHORTEST_PAUSE * max(seconds, 1.0))
    while not (held := holds()):
        assert time.monotonic() < deadline, f"did not hold within {seconds} s"
        time.sleep(pause)
        pause = min(1.2 * pause, longest)
    return held


def cpu_seconds(process: psutil.Process) -> float:
    """Return the processor time that a process has taken [s]; 0 if it has ended."""
    try:
        return sum(process.cpu_times()[:2])
    except psutil.NoSuchProcess:
        return 0.0


def finished(client: httpx.Client, plan: dict[str, Any], seconds: float = PATIENCE_SECONDS) -> dict[str, Any]:
    """Wait until a plan's job has ended, and return the plan."""
    last: dict[str, Any] = {}

    def ended() -> bool:
        last.update(client.get(plan["links"]["self"]).json())
        return last["done"]

    wait_for(ended, seconds)
    return last
