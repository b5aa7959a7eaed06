"""Cells of one's own, named by owner and content. A cell is never changed, and stays while a plan is in it."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
import threading
import time
import uuid
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import sqlalchemy as sa
import structlog
from pydantic import BaseModel
from sqlalchemy.exc import IntegrityError

from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell
from planners.errors import AssetError
from planners.survey.cell_limits import CellLimits
from planners.survey.survey import SurveyFigures
from workers.stores.database import Database
from workers.stores.tables import CELLS, PLANS, STUDIES, now_us

MOST_LOADED = 16
"""Cells that are kept in memory."""
KEPT_US = 86_400_000_000
"""A deleted cell is kept so long, since tasks that name it may be on their way [us]."""
SETTLED_SECONDS = 3600.0
"""Files that were unpacked or asked for within this time may be of use to somebody [s]."""
_UNPACKED = re.compile(r"[0-9a-f]{64}|\.(?:unpacking|checking|removing)-.+")
"""What there may be in the folder of unpacked cells, whole or left by a process that was killed."""


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
    deleted: bool
    """It is only there for plans and studies that are in it."""


class _KeptBeside(BaseModel):
    """What is kept beside a cell's figures."""

    limits: CellLimits | None = None
    """None: the cell was posted to a version that did not keep them."""


class CellFindings(SurveyFigures, _KeptBeside):
    """What was found in a cell when it was posted."""

    @classmethod
    def of(cls, figures: SurveyFigures, notes: Iterable[str], limits: CellLimits) -> Self:
        """Put figures together with the notes of the reading, and with what tasks must keep within."""
        return cls(**{**dict(figures), "notes": tuple(notes)}, limits=limits)


_COLUMNS: list[sa.ColumnElement[Any]] = [column for column in CELLS.c if column.name not in ("zip", "figures")]
log = structlog.get_logger(__name__)


@contextmanager
def passing(
    bundle: CellBundle, folder: Path, load: Callable[[CellBundle, Path], Cell] = CellBundle.load
) -> Iterator[Cell]:
    """Load a cell without keeping it: its files are gone behind the block.

    Args:
        bundle: the cell.
        folder: in which a place for its files is made.
        load: loads it, unpacked below a folder.

    Raises:
        AssetError: Something is wrong with it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # Not where the system keeps what is temporary: that may be memory, and a cell has up to 64 MB.
    with tempfile.TemporaryDirectory(dir=folder, prefix=".checking-") as place:
        yield load(bundle, Path(place))


class CellStore:
    """Reads and writes cells. Every method is one transaction; safe to share between threads."""

    def __init__(self, database: Database, folder: Path) -> None:
        """`folder` is where cells are unpacked; several processes may share it."""
        self._database, self.folder = database, folder
        self._loaded, self._lock = OrderedDict[str, Cell](), threading.Lock()
        self._limits: dict[str, CellLimits | None] = {}
        """By id; None: it cannot be loaded. Of all that was asked for: a cell never changes, and they are small."""

    def add(self, bundle: CellBundle, findings: CellFindings, owner: str | None) -> tuple[StoredCell, bool]:
        """Keep a cell, as the next version of its name.

        Args:
            bundle: the cell.
            findings: what was found in it.
            owner: whose it is.

        Returns:
            The cell, and whether this has added it. What the same owner posted before is found again, is there again if
            it was deleted, and is what its name means from now on.
        """
        cell_id = _id_of(bundle.digest, owner)
        known = self.get(cell_id)
        if known is not None:
            # Of one that was deleted, nothing but its version may be left.
            files = {"zip": bundle.zip()} if known.deleted else {}
            again = {"deleted_us": None, "created_us": now_us(), **files}
            if self._database.write(sa.update(CELLS).where(CELLS.c.id == cell_id).values(again)):
                return self._there(cell_id), known.deleted
            # What was left of it has just been forgotten.
        version = sa.select(sa.func.coalesce(sa.func.max(CELLS.c.version), 0) + 1).where(
            CELLS.c.name == bundle.name, CELLS.c.owner.is_not_distinct_from(owner)
        )
        row = {
            "id": cell_id,
            "created_us": now_us(),
            "owner": owner,
            "name": bundle.name,
            "version": version.scalar_subquery(),
            "hash": findings.hash,
            "figures": findings.model_dump_json(),
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

    def findings(self, cell_id: str) -> CellFindings | None:
        """Return what was found in a cell when it was posted."""
        text = self._database.scalar(sa.select(CELLS.c.figures).where(CELLS.c.id == cell_id))
        return None if text is None else CellFindings.model_validate_json(text)

    def limits(self, cell_ids: Collection[str]) -> dict[str, CellLimits]:
        """Return the limits of cells, by id; what cannot be loaded any more is left out."""
        unknown = [cell_id for cell_id in cell_ids if cell_id not in self._limits]
        if unknown:
            query = sa.select(CELLS.c.id, CELLS.c.figures).where(CELLS.c.id.in_(unknown))
            for row in self._database.rows(query):
                kept = _KeptBeside.model_validate_json(row.figures).limits
                self._limits[row.id] = kept or self._limits_of(row.id)
        known = {cell_id: self._limits.get(cell_id) for cell_id in cell_ids}
        return {cell_id: limits for cell_id, limits in known.items() if limits is not None}

    def named(self, name: str, owner: str | None) -> StoredCell | None:
        """Return the cell that an owner posted last under a name."""
        query = sa.select(*_COLUMNS).where(
            CELLS.c.name == name,
            CELLS.c.deleted_us.is_(None),
            CELLS.c.owner.is_not_distinct_from(owner),
        )
        found = self._database.rows(query.order_by(CELLS.c.created_us.desc(), CELLS.c.version.desc()).limit(1))
        return _stored(found[0]) if found else None

    def all(self, owner: str | None, *, anybodys: bool = False) -> list[StoredCell]:
        """Return the cells that an owner, or anybody, has, by name, newest version first."""
        query = sa.select(*_COLUMNS).where(CELLS.c.deleted_us.is_(None))
        if not anybodys:
            query = query.where(CELLS.c.owner.is_not_distinct_from(owner))
        return [_stored(row) for row in self._database.rows(query.order_by(CELLS.c.name, CELLS.c.version.desc()))]

    def zip(self, cell_id: str) -> bytes | None:
        """Return all files of a cell; nothing of one that was forgotten."""
        return self._database.scalar(sa.select(CELLS.c.zip).where(CELLS.c.id == cell_id))

    def unpacked(self, cell_id: str) -> Path | None:
        """Return the folder with the files of a cell, which are put there unless they are; None: there is no cell."""
        bundle = self._bundle(cell_id)
        return None if bundle is None else bundle.unpack(self.folder)

    def load(self, cell_id: str) -> Cell | None:
        """Return a cell as planners have it."""
        with self._lock:
            known = self._loaded.get(cell_id)
            # One that was forgotten and posted again has its files no more: the viewer reads them when it draws.
            if known is not None and known.shelf.folders[0].is_dir():
                self._loaded.move_to_end(cell_id)
                return known
        bundle = self._bundle(cell_id)
        if bundle is None:
            return None
        cell = bundle.load(self.folder)
        with self._lock:
            self._loaded[cell_id] = cell
            while len(self._loaded) > MOST_LOADED:
                self._loaded.popitem(last=False)
        return cell

    def delete(self, cell_id: str) -> None:
        """Have a cell for no more tasks; its files go when no plan and no study is in it any more."""
        self._database.write(sa.update(CELLS).where(CELLS.c.id == cell_id).values(deleted_us=now_us()))

    def forget_deleted(self) -> int:
        """Remove the files of deleted cells that no plan and no study is in, and return how many cells there were.

        The last version of a name stays known without them, so that no other one is ever called so.
        """
        planned = sa.exists().where(PLANS.c.cell == CELLS.c.id)
        # Points of a study may be planned as long as it is there. Nothing else in it looks like an id.
        studied = sa.exists().where(STUDIES.c.study.contains(CELLS.c.id))
        old = CELLS.c.deleted_us < now_us() - KEPT_US
        gone = old & ~planned & ~studied & (sa.func.length(CELLS.c.zip) > 0)
        later = CELLS.alias()
        same_name = (later.c.name == CELLS.c.name) & later.c.owner.is_not_distinct_from(CELLS.c.owner)
        is_last = ~sa.exists().where(same_name, later.c.version > CELLS.c.version)
        emptied = self._database.write(sa.update(CELLS).where(gone, is_last).values(zip=b""))
        return emptied + self._database.write(sa.delete(CELLS).where(gone, ~is_last))

    def clear_folder(self) -> int:
        """Remove the files of this machine that belong to no cell, and return of how many cells they were.

        Whatever was unpacked or asked for within the last hour stays: it may be on its way to a solver.
        """
        # Looked for before the rows are: what is unpacked had its row before.
        settled = [path for path in self._found() if _changed(path) < time.time() - SETTLED_SECONDS]
        if not settled:
            return 0
        rows = self._database.rows(sa.select(CELLS.c.id, CELLS.c.owner).where(sa.func.length(CELLS.c.zip) > 0))
        ids, owners = {row.id for row in rows}, {row.owner for row in rows}
        left = [path for path in settled if not any(_id_of(path.name, owner) in ids for owner in owners)]
        for path in left:
            # At once: nobody must take what is left of it for the whole.
            aside = path.with_name(f".removing-{uuid.uuid4().hex}")
            with suppress(OSError):
                path.rename(aside)
                shutil.rmtree(aside, ignore_errors=True)
        return len(left)

    def _limits_of(self, cell_id: str) -> CellLimits | None:
        """Look at a cell of which no limits are kept."""
        try:
            bundle = self._bundle(cell_id)
            if bundle is None:
                return None
            with passing(bundle, self.folder) as cell:
                return CellLimits.of(cell)
        except AssetError as error:
            log.warning("a cell that is kept cannot be loaded", cell_id=cell_id, error=str(error))
            return None

    def _found(self) -> list[Path]:
        if not self.folder.is_dir():
            return []
        return [path for path in self.folder.iterdir() if _UNPACKED.fullmatch(path.name)]

    def _bundle(self, cell_id: str) -> CellBundle | None:
        content = self.zip(cell_id)
        if not content:
            return None
        bundle = CellBundle.of_zip(content)
        with suppress(OSError):
            # If its files are there, whoever clears the folder sees that they are wanted.
            os.utime(self.folder / bundle.digest)
        return bundle

    def _there(self, cell_id: str) -> StoredCell:
        stored = self.get(cell_id)
        assert stored is not None
        return stored


def _id_of(digest: str, owner: str | None) -> str:
    """Return the id of an owner's cell, by the digest of its files."""
    return hashlib.sha256(f"{owner or ''}\0{digest}".encode()).hexdigest()[:32]


def _changed(path: Path) -> float:
    """Return when a folder was changed last [s since 1970]; one that has gone was so just now."""
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return time.time()


def _stored(row: Any) -> StoredCell:
    deleted = row.deleted_us is not None
    return StoredCell(row.id, row.owner, row.created_us, row.name, row.version, row.hash, deleted)
