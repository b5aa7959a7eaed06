"""Handover databases on disk: computed once for a cell and a tool, read by every job after that."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

import structlog

from planners.cell.cell import Cell
from planners.progress import Progress, Report, silent
from planners.regrasp.grasps.handovers import (
    HandoverDatabase,
    HandoverDataError,
    HandoverSettings,
    find_handovers,
    handover_key,
)
from planners.scene.suction_tool import SuctionTool

CAPACITY = 500
"""Databases that are kept, those used last [1]: everyone may bring tools of their own. One takes some 40 kB."""
_SUFFIX = ".handovers"

log = structlog.get_logger(__name__)


class HandoverStore:
    """A folder with one file for each database, named by its key. Several processes may share it.

    Nothing in it is trusted: what does not prove to be the database that is asked for is computed again. A folder that
    cannot be written costs time, never a plan.
    """

    def __init__(self, folder: Path, capacity: int = CAPACITY) -> None:
        self._folder, self._capacity = folder, capacity

    def get(
        self, cell: Cell, tool: SuctionTool, settings: HandoverSettings, progress: Progress = silent
    ) -> HandoverDatabase:
        """Return the database of a cell and a tool: read, or computed and kept.

        Raises:
            LiftwrightError: the hands are not two equal grippers.
        """
        key = handover_key(cell, tool, settings)
        database = self.load(key)
        if database is None:
            progress(Report("handovers", 0, 1))
            database = find_handovers(cell, tool, settings, progress)
            self.save(database)
        return database

    def load(self, key: str) -> HandoverDatabase | None:
        """Return the database of a key, or None where there is none that can be used."""
        path = self._path(key)
        try:
            database = HandoverDatabase.from_bytes(path.read_bytes(), key)
        except FileNotFoundError:
            return None
        except (OSError, HandoverDataError) as error:
            log.warning("handovers_unusable", path=str(path), error=str(error))
            return None
        with contextlib.suppress(OSError):
            # The time of last use decides which files go.
            path.touch()
        return database

    def save(self, database: HandoverDatabase) -> None:
        """Keep a database. Readers see all of it or nothing."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._write(self._path(database.key), database.to_bytes())
            self._forget_the_oldest()
        except OSError as error:
            log.warning("handovers_not_kept", folder=str(self._folder), error=str(error))

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}{_SUFFIX}"

    def _write(self, path: Path, content: bytes) -> None:
        handle, name = tempfile.mkstemp(dir=self._folder, prefix=".", suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise

    def _forget_the_oldest(self) -> None:
        used = {}
        for path in self._folder.glob(f"*{_SUFFIX}"):
            # Another process may have removed it.
            with contextlib.suppress(FileNotFoundError):
                used[path] = path.stat().st_mtime_ns
        for path in sorted(used, key=used.__getitem__)[: max(0, len(used) - self._capacity)]:
            path.unlink(missing_ok=True)
