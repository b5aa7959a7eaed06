"""Whether a worker is alive and gets on, as the database sees it."""

from __future__ import annotations

from workers.database import open_database
from workers.executor_lock import AdvisoryLock, FileLock, WorkerRuns, stuck_name
from workers.settings import WorkerSettings


def worker_lives(settings: WorkerSettings) -> bool:
    """Whether somebody holds the worker's name, its lock cannot be taken, and nobody says that it is stuck."""
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
        name = settings.executor_name
        with lock.borrowed(name) as dead, lock.borrowed(stuck_name(name)) as gets_on:
            return gets_on and not dead
    finally:
        lock.close()
        database.close()
