"""Where and on what figures were measured. No names of hosts, users or paths."""

from __future__ import annotations

import os
import platform
import subprocess
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Self

import psutil

ROOT = Path(__file__).resolve().parents[2]
LIBRARIES = (
    "numpy", "numba", "scipy", "clarabel", "ompl", "pin", "coal", "python-fcl", "cvxpy", "networkx", "dbos", "fastapi",
)  # fmt: skip
MEASURED = (
    *("app", "planners", "workers", "assets", "tests/benchmarks"),
    *("pyproject.toml", "constraints.txt", "Dockerfile", "docker-compose.yml"),
    *(":!tests/benchmarks/RESULTS.md", ":!tests/benchmarks/*.svg"),
)
"""What figures depend on, as Git's path specifications; what is written here depends on it."""


@dataclass(frozen=True)
class Circumstances:
    """Where, when and on what a part of the benchmarks was begun."""

    commit: str
    date: str
    load: float
    """Processes that wanted a core during the minute before [1]."""
    clock: float
    """[s]"""

    @classmethod
    def now(cls) -> Self:
        """Return what holds as a measurement begins."""
        return cls(commit(), f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", os.getloadavg()[0], time.monotonic())

    def told(self) -> str:
        """Return the paragraph on circumstances, as the measurement ends."""
        libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
        return (
            f"Commit {self.commit}, {self.date}, in {(time.monotonic() - self.clock) / 60:.1f} min; {_processor()}, "
            f"{len(os.sched_getaffinity(0))} cores, {psutil.virtual_memory().total / 2**30:.0f} GiB, "
            f"{platform.system()} {platform.machine()}, Python {platform.python_version()}. Processes that wanted a "
            f"core, mean of the minute before: {self.load:.1f} at the begin, {os.getloadavg()[0]:.1f} at the end. "
            f"{libraries}."
        )


def commit() -> str:
    """Return the last commit that changed what is measured or measures, and whether there are changes since.

    Texts and other tests change no figure, so parts that were measured before and after those are of one commit.
    """
    last = _git("log", "-1", "--format=%h", "--abbrev=12", "--", *MEASURED)
    if not last:
        return "unknown"
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", *MEASURED)
    return f"{last}{' with uncommitted changes' if changed else ''}"


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or "unknown"
