"""Cells of one's own, named by owner and content. A cell is never changed, and stays while a plan is in it."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell
from planners.survey.survey import SurveyFigures
from workers.stores.database import Database
from workers.stores.tables import CELLS, PLANS, now_us

MOST_LOADED = 16
"""Cells that are kept in memory."""
KEPT_US = 86_400_000_000
"""A deleted cell is kept so long, since tasks that name it may be on their way [us]."""


@dataclass(frozen=True, eq=False)
class StoredCell:
    """A cell that is kept."""

    id: str
    owner: str | None
    """Whose key it was posted with; None where no keys were asked for."""
    created_us: int
    """When it was posted last, in microseconds since 1970, UTC."""
    name: str
    version: int
    """Of all that its owner posted under its name, from 1."""
    hash: str
    """Of its content; plan documents state it."""
    figures: SurveyFigures
    deleted: bool
    """It is only there for plans that are in it."""


_COLUMNS: list[sa.ColumnElement[Any]] = [column for column in CELLS.c if column.name != "zip"]


class CellStore:
    """Reads and writes cells. Every method is one transaction; safe to share between threads."""

    def __init__(self, database: Database, folder: Path) -> None:
        """`folder` is where cells are unpacked; several processes may share it."""
        self._database, self.folder = database, folder
        self._loaded, self._lock = OrderedDict[str, Cell](), threading.Lock()

    def add(self, bundle: CellBundle, figures: SurveyFigures, owner: str | None) -> tuple[StoredCell, bool]:
        """Keep a cell, as the next version of its name.

        Returns:
            The cell, and whether this has added it. What the same owner posted before is found again, is there again if
            it was deleted, and is what its name means from now on.
        """
        cell_id = hashlib.sha256(f"{owner or ''}\0{bundle.digest}".encode()).hexdigest()[:32]
        known = self.get(cell_id)
        if known is not None:
            again = {"deleted_us": None, "created_us": now_us()}
            self._database.write(sa.update(CELLS).where(CELLS.c.id == cell_id).values(again))
            return self._there(cell_id), known.deleted
        version = sa.select(sa.func.coalesce(sa.func.max(CELLS.c.version), 0) + 1).where(
            CELLS.c.name == bundle.name, CELLS.c.owner.is_(None) if owner is None else CELLS.c.owner == owner
        )
        row = {
            "id": cell_id,
            "created_us": now_us(),
            "owner": owner,
            "name": bundle.name,
            "version": version.scalar_subquery(),
            "hash": figures.hash,
            "figures": figures.model_dump_json(),
            "zip": bundle.zip(),
        }
        while True:
            try:
                self._database.write(sa.insert(CELLS).values(row))
            except IntegrityError:
                # Somebody else posted the same, or another version at the same time.
                if self.get(cell_id) is None:
                    continue
            return self._there(cell_id), True

    def get(self, cell_id: str) -> StoredCell | None:
        """Return a cell, a deleted one too."""
        found = self._database.rows(sa.select(*_COLUMNS).where(CELLS.c.id == cell_id))
        return _stored(found[0]) if found else None

    def named(self, name: str, owner: str | None) -> StoredCell | None:
        """Return the cell that an owner posted last under a name."""
        query = sa.select(*_COLUMNS).where(
            CELLS.c.name == name,
            CELLS.c.deleted_us.is_(None),
            CELLS.c.owner.is_(None) if owner is None else CELLS.c.owner == owner,
        )
        found = self._database.rows(query.order_by(CELLS.c.created_us.desc(), CELLS.c.version.desc()).limit(1))
        return _stored(found[0]) if found else None

    def all(self, owner: str | None, *, anybodys: bool = False) -> list[StoredCell]:
        """Return the cells that an owner, or anybody, has, by name, newest version first."""
        query = sa.select(*_COLUMNS).where(CELLS.c.deleted_us.is_(None))
        if not anybodys:
            query = query.where(CELLS.c.owner.is_(None) if owner is None else CELLS.c.owner == owner)
        return [_stored(row) for row in self._database.rows(query.order_by(CELLS.c.name, CELLS.c.version.desc()))]

    def zip(self, cell_id: str) -> bytes | None:
        """Return all files of a cell."""
        return self._database.scalar(sa.select(CELLS.c.zip).where(CELLS.c.id == cell_id))

    def unpacked(self, cell_id: str) -> Path | None:
        """Return the folder with the files of a cell, which are put there unless they are; None: there is no cell."""
        content = self.zip(cell_id)
        return None if content is None else CellBundle.of_zip(content).unpack(self.folder)

    def load(self, cell_id: str) -> Cell | None:
        """Return a cell as planners have it."""
        with self._lock:
            if cell_id in self._loaded:
                self._loaded.move_to_end(cell_id)
                return self._loaded[cell_id]
        content = self.zip(cell_id)
        if content is None:
            return None
        cell = CellBundle.of_zip(content).load(self.folder)
        with self._lock:
            self._loaded[cell_id] = cell
            while len(self._loaded) > MOST_LOADED:
                self._loaded.popitem(last=False)
        return cell

    def delete(self, cell_id: str) -> None:
        """Have a cell for no more tasks; its files go when no plan is in it any more."""
        self._database.write(sa.update(CELLS).where(CELLS.c.id == cell_id).values(deleted_us=now_us()))

    def forget_deleted(self) -> int:
        """Remove deleted cells that no plan is in, and return how many there were."""
        used = sa.exists().where(PLANS.c.cell == CELLS.c.id)
        return self._database.write(sa.delete(CELLS).where(CELLS.c.deleted_us < now_us() - KEPT_US, ~used))

    def _there(self, cell_id: str) -> StoredCell:
        stored = self.get(cell_id)
        assert stored is not None
        return stored


def _stored(row: Any) -> StoredCell:
    figures = SurveyFigures.model_validate_json(row.figures)
    deleted = row.deleted_us is not None
    return StoredCell(row.id, row.owner, row.created_us, row.name, row.version, row.hash, figures, deleted)
