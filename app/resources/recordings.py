"""Recordings of plans: made one after the other, for as long as somebody waits, and kept by their documents."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from app.errors import TooManyRecordings
from app.work.wanted import NobodyWaits, StillWanted
from workers.kept_files import KeptFiles
from workers.stores.plan_store import StoredDocument

_SUFFIX = ".html"
Make = Callable[[StoredDocument, StillWanted], str]
log = structlog.get_logger(__name__)


@dataclass(eq=False)
class _Making:
    """A recording that is being made, or waits for its turn."""

    task: asyncio.Task[bytes]
    wanted: StillWanted
    waiting: int = 0
    """So many requests wait for it."""
    begun: bool = False


class Recordings:
    """A folder of recordings, and a queue of those that are made. On one event loop.

    The folder holds what can be made again: several processes may share it, and one that is full costs time only.
    """

    def __init__(self, folder: Path, make: Make, software: str, most_bytes: int, most_waiting: int) -> None:
        """Keep at most `most_bytes`; let at most `most_waiting` wait.

        Args:
            folder: where they are kept.
            make: returns the page of a document, for as long as it is wanted; called in a thread, takes seconds.
            software: changes with whatever else makes a page another one.
            most_bytes: so much is kept, those used last [bytes]; 0: nothing.
            most_waiting: so many documents wait for the one that is being made; a further one is refused [1].
        """
        self._kept = KeptFiles(folder, _SUFFIX, most_bytes)
        self._make, self._software, self._most_waiting = make, software, most_waiting
        self._making: dict[str, _Making] = {}
        self._turn = asyncio.Lock()

    def tag(self, document: StoredDocument) -> str:
        """Return what names a document's recording, and no other page."""
        return hashlib.sha256(f"{document.sha256} {self._software}".encode()).hexdigest()

    async def get(self, document: StoredDocument, left: Callable[[], Coroutine[Any, Any, object]]) -> bytes:
        """Return the recording of a document, once it is made.

        Args:
            document: of the plan.
            left: returns once whoever asks has gone; what nobody waits for any more is not made any further.

        Raises:
            TooManyRecordings: Too many wait already.
            NobodyWaits: `left` returned first.
        """
        name = self.tag(document)
        kept = await asyncio.to_thread(self._kept.read, name)
        if kept is not None:
            return kept
        making = self._making.get(name)
        if making is None:
            if len(self._making) > self._most_waiting:
                raise TooManyRecordings(self._most_waiting)
            wanted = StillWanted()
            making = self._making[name] = _Making(asyncio.create_task(self._made(name, document, wanted)), wanted)
            making.task.add_done_callback(_note_failure)
        gone = asyncio.create_task(left())
        making.waiting += 1
        try:
            await asyncio.wait((making.task, gone), return_when=asyncio.FIRST_COMPLETED)
            if making.task.done():
                return making.task.result()
            raise NobodyWaits
        finally:
            making.waiting -= 1
            gone.cancel()
            if not making.waiting and not making.task.done():
                # Whoever asks from now on has it made anew.
                self._making.pop(name, None)
                making.wanted.no_longer()
                if not making.begun:
                    making.task.cancel()

    async def _made(self, name: str, document: StoredDocument, wanted: StillWanted) -> bytes:
        try:
            with wanted:
                async with self._turn:
                    self._making[name].begun = True
                    page = (await asyncio.to_thread(self._make, document, wanted)).encode()
                    await asyncio.to_thread(self._kept.keep, name, page)
                    return page
        finally:
            if self._making.get(name) is not None and self._making[name].task is asyncio.current_task():
                del self._making[name]


def _note_failure(task: asyncio.Task[bytes]) -> None:
    """Whoever waits raises it again; nobody may wait."""
    if not task.cancelled() and (error := task.exception()) is not None and not isinstance(error, NobodyWaits):
        log.warning("recording not made", error=repr(error))
