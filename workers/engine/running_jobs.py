"""What a process does for its jobs at the moment: it can be left, job by job, or stopped altogether."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, Generic, TypeVar

from dbos import error

JobResult = TypeVar("JobResult")


class JobLeft(error.DBOSWorkflowCancelledError):
    """This process must not go on with a job: it was cancelled or deleted, or somebody else has it.

    The engine takes it as the end of this run and not of the job: it writes no result.
    """

    def __init__(self, job_id: str) -> None:
        super().__init__(f"job {job_id} is not this worker's any more")


class RunningJobs(Generic[JobResult]):
    """The task of each job that is worked on, on the running event loop; each ends its processes when cancelled."""

    def __init__(self) -> None:
        self._tasks: dict[str, asyncio.Task[JobResult]] = {}
        self._left: set[asyncio.Task[JobResult]] = set()
        self._stopping = False

    @property
    def ids(self) -> list[str]:
        """The jobs that are worked on now."""
        return list(self._tasks)

    def stop(self) -> None:
        """End all work; the jobs stay begun, and are begun anew by whoever takes them up."""
        self._stopping = True
        for task in self._tasks.values():
            task.cancel()

    def leave(self, job_id: str) -> None:
        """Stop working on a job, if that is still going on; its processes are gone soon."""
        task = self._tasks.get(job_id)
        if task is not None and task not in self._left:
            self._left.add(task)
            task.cancel()

    async def run(self, job_id: str, work: Callable[[], Coroutine[Any, Any, JobResult]]) -> JobResult:
        """Work on a job.

        Raises:
            JobLeft: It was left meanwhile.
            Exception: What the work raises.
        """
        if self._stopping:
            await _stay_begun()
        # An earlier run of the same job in this process has lost it: only the newest may have a process.
        self.leave(job_id)
        task = self._tasks[job_id] = asyncio.create_task(work())
        try:
            return await task
        except asyncio.CancelledError:
            if self._stopping:
                await _stay_begun()
                raise
            if task in self._left:
                raise JobLeft(job_id) from None
            task.cancel()
            # Its process must be gone before whoever has cancelled this goes on, or tells that the time was up.
            await asyncio.wait([task])
            raise
        finally:
            self._left.discard(task)
            if self._tasks.get(job_id) is task:
                del self._tasks[job_id]


async def _stay_begun() -> None:
    """Wait until the event loop ends: stopping is no end of a job, which whoever starts next begins anew.

    Whoever handles a cancellation by this goes on at once if it was the loop's end, which cancels no task twice.
    """
    task = asyncio.current_task()
    if task is None or not task.cancelling():
        await asyncio.Event().wait()
