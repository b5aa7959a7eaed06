"""Accepts what many callers submit at once in few transactions: each is answered when its own has been committed."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import Future
from queue import Empty, SimpleQueue

from workers.stores.job_queue import JobQueue
from workers.stores.plan_store import Accepted, NoRoom, PlanStore, Room, Submission

MOST_TOGETHER = 64
"""Submissions in one transaction [1]: a long one would keep other writers waiting, and lose more where it fails."""

_Waiting = tuple[Submission, Future[Accepted | NoRoom]]


class PlanWriter:
    """One thread that accepts whatever was submitted while it was busy with what came before.

    A commit takes as long for many plans as for one, and writers that wait for one another on SQLite sleep meanwhile.
    """

    def __init__(self, store: PlanStore, queue: JobQueue, room: Room) -> None:
        self._store, self._queue, self._room = store, queue, room
        self._submitted: SimpleQueue[_Waiting | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="plan writer", daemon=True)
        self._thread.start()

    def submit(self, submission: Submission) -> Future[Accepted | NoRoom]:
        """Have a task stored; the future is done when that is committed, or has failed as `accept_all` does."""
        future: Future[Accepted | NoRoom] = Future()
        self._submitted.put((submission, future))
        return future

    def close(self) -> None:
        """End once all that was submitted before is answered."""
        self._submitted.put(None)
        self._thread.join()

    def _run(self) -> None:
        waiting: list[_Waiting] = []
        ending = False
        while waiting or not ending:
            if not waiting:
                first = self._submitted.get()
                waiting, ending = ([], True) if first is None else ([first], ending)
            while len(waiting) < MOST_TOGETHER:
                try:
                    following = self._submitted.get_nowait()
                except Empty:
                    break
                if following is None:
                    ending = True
                else:
                    waiting.append(following)
            together, waiting = _with_keys_once(waiting)
            self._write([each for each in together if each[1].set_running_or_notify_cancel()])

    def _write(self, together: Sequence[_Waiting]) -> None:
        if not together:
            return
        try:
            answers = self._store.accept_all([submission for submission, _ in together], self._queue, self._room)
        except Exception as error:  # noqa: BLE001 - whoever submitted raises it again
            for _, future in together:
                future.set_exception(error)
            return
        for (_, future), answer in zip(together, answers, strict=True):
            future.set_result(answer)


def _with_keys_once(waiting: Sequence[_Waiting]) -> tuple[list[_Waiting], list[_Waiting]]:
    """Part those that can be stored together from those whose key another one of them has: these come later."""
    keys, together, later = set[str](), list[_Waiting](), list[_Waiting]()
    for each in waiting:
        key = each[0].key
        (later if key in keys else together).append(each)
        if key is not None:
            keys.add(key)
    return together, later
