"""One worker per name: two processes that share one would run every job twice."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from planners.errors import LiftwrightError


class WorkerRuns(LiftwrightError):
    """Another worker of that name already uses the data directory."""

    def __init__(self, name: str, directory: Path) -> None:
        super().__init__(f"a worker {name!r} already runs on {directory}; stop it, or use another data directory")


class ExecutorLock:
    """Held by the kernel for as long as this process lives, however it ends."""

    def __init__(self, directory: Path, name: str) -> None:
        """Take the lock.

        Raises:
            WorkerRuns: Somebody else has it.
        """
        directory.mkdir(parents=True, exist_ok=True)
        self._descriptor = os.open(directory / f"worker-{name}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._descriptor)
            raise WorkerRuns(name, directory) from None

    def release(self) -> None:
        """Let another worker have the name."""
        os.close(self._descriptor)
