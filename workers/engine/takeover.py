"""How jobs of a dead worker are taken over: each worker proves that it lives, and looks for those that do not."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence, Set

import structlog

from workers.engine.executor_lock import AdvisoryLock, FileLock, WorkerRuns
from workers.settings import WorkerSettings
from workers.stores.database_loss import DATABASE_GONE, said_by
from workers.stores.job_queue import JobQueue

FORMER_LIFE_SECONDS = 20.0
"""So long a worker that starts waits for the server to notice that its own last life has ended [s]."""
FIRST_LOOK_SECONDS = 0.5
BEGINNING_SECONDS = 5.0
"""So long a job may take to begin after it was handed to this worker: on a busy machine that is a while [s]."""

log = structlog.get_logger(__name__)


class Takeover:
    """Holds the worker's name, and looks around every few seconds.

    On PostgreSQL the lock on the name belongs to a connection. If the connection is lost, so is the proof of life. One
    that hangs proves nothing either: each look says something on it, and of a worker that has said nothing for
    `frozen_seconds` the others end the connection. Long before that the worker stops its jobs: `patience_seconds` after
    a look that was due. If it proves sooner that it lives, those that nobody has taken go on.
    """

    def __init__(
        self,
        settings: WorkerSettings,
        queue: JobQueue,
        lock: AdvisoryLock | None,
        at_work: Callable[[], Set[str]],
        stuck: Callable[[], Sequence[str]],
    ) -> None:
        """`at_work` tells the ids of the jobs that this process has, `stuck` what in it does not get on.

        `lock` is None on SQLite, where the API of the same process tells what is stuck.
        """
        self._settings, self._queue, self._lock, self._at_work = settings, queue, lock, at_work
        self._stuck = stuck
        self._name = settings.executor_name
        self._file: FileLock | None = None
        self._strays: dict[str, float] = {}
        """Jobs of ours that this process had not begun at the last look, and since when."""
        self._lost_at: float | None = None
        self._proved_at: float | None = None
        """When it was last known that the name is ours; None: it needs no proof, or none yet."""

    @property
    def alone(self) -> bool:
        """Whether it could not be proved for so long that this worker lives that others may have its jobs.

        Nothing is asked for that: whatever is asked of a database may hang.
        """
        if self._proved_at is None:
            return False
        patience = self._settings.watch_seconds + self._settings.patience_seconds
        return time.monotonic() - self._proved_at > patience

    async def start(self) -> None:
        """Take the name.

        Raises:
            WorkerRuns: Another worker has it, and keeps it.
        """
        if self._lock is None:
            self._file = FileLock(self._settings.data_dir, self._name)
            return
        deadline = time.monotonic() + FORMER_LIFE_SECONDS
        while not await asyncio.to_thread(self._lock.hold_at_start):
            if time.monotonic() > deadline:
                await asyncio.to_thread(self._lock.close)
                raise WorkerRuns(self._name, "this database")
            await asyncio.sleep(FIRST_LOOK_SECONDS)
        self._proved_at = time.monotonic()

    def stop(self) -> None:
        """Give the name back. Blocks, for a moment: the engine takes the loop's threads along when it ends."""
        if self._file is not None:
            self._file.release()
        if self._lock is not None:
            self._lock.close()

    async def look(self) -> None:
        """Look around once; a database that is gone is for the worker to know."""
        try:
            await asyncio.to_thread(self._look, stuck=bool(self._stuck()))
        except DATABASE_GONE as error:
            self._lose(said_by(error))

    def _look(self, *, stuck: bool) -> None:
        begun = time.monotonic()
        if self._lock is not None:
            if not self._lock.hold():
                self._lose("another connection has this worker's name")
                return
            # From before it was asked: a thread that was frozen after it was answered proves nothing.
            self._proved_at = begun
        if self._lost_at is not None:
            log.info("worker is itself again", worker=self._name, seconds=round(time.monotonic() - self._lost_at, 1))
            self._lost_at = None
        if self._lock is not None:
            self._lock.show_stuck(stuck=stuck)
        running = self._queue.running()
        self._begin_strays_anew(running.pop(self._name, set()))
        if self._lock is None or not running:
            return
        silences = self._lock.silences(running)
        for other, jobs in running.items():
            if other not in silences:
                with self._lock.borrowed(other) as dead:
                    if dead:
                        self._begin_anew(other, jobs)
            elif (silence := silences[other]) > self._settings.frozen_seconds:
                log.warning("a frozen worker loses its name", of_worker=other, by_worker=self._name, seconds=silence)
                # Its jobs are taken over by whoever gets the name at a next look.
                self._lock.end_session(other)

    def _begin_strays_anew(self, ours: set[str]) -> None:
        """A job may be ours without our knowing: the connection broke as it was handed to us, or as it ended."""
        now = time.monotonic()
        strays = {job: self._strays.get(job, now) for job in ours - self._at_work()}
        lost = {job for job, since in strays.items() if now - since >= BEGINNING_SECONDS}
        self._begin_anew(self._name, lost)
        # Whoever is handed one of them next, and be it this worker, has as long.
        self._strays = {job: since for job, since in strays.items() if job not in lost}

    def _begin_anew(self, worker: str, jobs: set[str]) -> None:
        taken = self._queue.begin_anew(worker, jobs)
        if taken:
            log.warning("jobs begun anew", of_worker=worker, by_worker=self._name, jobs=taken)

    def _lose(self, why: str) -> None:
        if self._lost_at is None:
            self._lost_at = time.monotonic()
            log.warning("worker cannot prove that it lives", worker=self._name, error=why)
