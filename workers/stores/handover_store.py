"""Handover databases on disk: computed once for a cell and a tool, read by every job after that."""

from __future__ import annotations

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
from workers.kept_files import KeptFiles

MOST_BYTES = 20_000_000
"""Kept are those used last, some 500 of 40 kB: everyone may bring tools of their own [bytes]."""
_SUFFIX = ".handovers"

log = structlog.get_logger(__name__)


class HandoverStore:
    """A folder with one file for each database, named by its key. Several processes may share it.

    Nothing in it is trusted: what does not prove to be the database that is asked for is computed again. A folder that
    cannot be written costs time, never a plan.
    """

    def __init__(self, folder: Path, most_bytes: int = MOST_BYTES) -> None:
        self._kept = KeptFiles(folder, _SUFFIX, most_bytes)

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
        content = self._kept.read(key)
        if content is None:
            return None
        try:
            return HandoverDatabase.from_bytes(content, key)
        except HandoverDataError as error:
            log.warning("handovers_unusable", path=str(self._kept.path(key)), error=str(error))
            return None

    def save(self, database: HandoverDatabase) -> None:
        """Keep a database."""
        self._kept.keep(database.key, database.to_bytes())
