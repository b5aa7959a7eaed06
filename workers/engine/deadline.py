"""Questions that may hang, asked for so long and no longer."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

Reply = TypeVar("Reply")


class PatientQuestion(Generic[Reply]):
    """A blocking call that is made by one thread at a time, of its own, which holds up no end of the process.

    Whoever asks while it is being answered gets that answer, and one that is fresh is given again: a question that
    hangs costs one thread, however often it is asked.
    """

    def __init__(self, call: Callable[[], Reply], fresh_seconds: float = 0.0) -> None:
        """`fresh_seconds`: so long an answer holds [s]; what the call raises does not."""
        self._call, self._fresh_seconds = call, fresh_seconds
        self._lock = threading.Lock()
        self._asked: Future[Reply] | None = None
        self._answered_at = float("-inf")

    def ask(self) -> Future[Reply]:
        """Return the answer, or what will be it."""
        with self._lock:
            if self._asked is not None and not self._is_old(self._asked):
                return self._asked
            asked = self._asked = Future[Reply]()
        try:
            threading.Thread(target=self._answer, args=(asked,), name="question", daemon=True).start()
        except RuntimeError as error:
            # There is no room for a thread now; the next who asks tries again.
            asked.set_exception(error)
        return asked

    def within(self, seconds: float) -> Reply:
        """Return the answer.

        Raises:
            TimeoutError: It has not come for so long [s].
            Exception: What the call raises.
        """
        return self.ask().result(seconds)

    def _is_old(self, asked: Future[Reply]) -> bool:
        fresh = time.monotonic() - self._answered_at < self._fresh_seconds
        return asked.done() and (asked.exception() is not None or not fresh)

    def _answer(self, asked: Future[Reply]) -> None:
        try:
            answer = self._call()
        except BaseException as error:  # noqa: BLE001 - whoever asks raises it again
            asked.set_exception(error)
        else:
            self._answered_at = time.monotonic()
            asked.set_result(answer)
