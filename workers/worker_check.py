"""Whether a worker is alive, as the database sees it."""

from __future__ import annotations

from workers.database import open_database
from workers.executor_lock import AdvisoryLock, FileLock, WorkerRuns
from workers.settings import WorkerSettings


def worker_lives(settings: WorkerSettings) -> bool:
    """Whether somebody holds the worker's name: its lock cannot be taken."""
    if settings.embedded:
        try:
            FileLock(settings.data_dir, settings.executor_name).release()
        except WorkerRuns:
            return True
        return False
    database = open_database(settings)
    lock = AdvisoryLock(database, f"check of {settings.executor_name}")
    try:
        lock.hold()
        with lock.borrowed(settings.executor_name) as dead:
            return not dead
    finally:
        lock.close()
        database.close()
