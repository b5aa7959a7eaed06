"""What the process of a worker says of itself: a file that it touches while it gets on.

Whoever ends a process that does not live must not ask the database: it may be away, and then every worker waits for it
and goes on by itself. All of them being ended meanwhile would help nobody.
"""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

from workers.settings import WorkerSettings


class SignOfLife:
    """The file of one worker, in its data directory."""

    def __init__(self, settings: WorkerSettings) -> None:
        self._path = _path(settings)

    def give(self) -> None:
        """Say that all is well. A file that cannot be touched says nothing, which is no reason to do nothing else."""
        with suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.touch()

    def withdraw(self) -> None:
        """Say nothing any more."""
        with suppress(OSError):
            self._path.unlink(missing_ok=True)


def shows_life(settings: WorkerSettings) -> bool:
    """Whether the worker has said that all is well within the time after which others hold it for frozen."""
    try:
        said_at = _path(settings).stat().st_mtime
    except OSError:
        return False
    return time.time() - said_at < settings.frozen_seconds


def _path(settings: WorkerSettings) -> Path:
    return settings.data_dir.resolve() / f"worker-{settings.executor_name}.alive"
