"""Cells: those that are shipped, and one's own."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from functools import lru_cache
from pathlib import Path

from app.access.caller import ANYBODY, Caller, Scope
from app.errors import CellIsShipped, CellNotFound
from app.task_intake import VersionedCells
from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell, load_cell
from planners.contract.task_spec import DEFAULT_CELLS
from planners.survey.cell_limits import CellLimits
from planners.survey.faults import doubts_about, load_checked, surveyed
from planners.survey.survey import CellSurvey
from workers.stores.cell_store import CellFindings, CellStore, StoredCell, passing

LookAtCell = Callable[[Cell], CellSurvey]


def look_at(cell: Cell) -> CellSurvey:
    """Return what a cell can do, with everything that takes long."""
    survey = CellSurvey.of(cell)
    survey.figures()
    return survey


def prepare() -> None:
    """Load what looking at any cell takes, so that processes forked from this one need not."""
    for name in DEFAULT_CELLS.values():
        look_at(load_cell(name))


def examined(bundle: CellBundle, folder: Path, shipped: Collection[str]) -> CellFindings:
    """Return what was found in a cell that is to be one's own; takes seconds, and keeps nothing.

    Args:
        bundle: the cell.
        folder: where its files are unpacked meanwhile.
        shipped: names that it must not have.

    Raises:
        CellIsShipped: It is called as a shipped one is.
        AssetError: Something is wrong with it; it lists everything that is.
    """
    if bundle.name in shipped:
        raise CellIsShipped(bundle.name)
    with passing(bundle, folder, load_checked) as cell:
        notes = [*bundle.notes, *doubts_about(cell)]
        return CellFindings.of(surveyed(cell, bundle).figures(), notes, CellLimits.of(cell))


def examined_upload(
    content: bytes, suffix: str, folder: Path, shipped: Collection[str]
) -> tuple[CellBundle, CellFindings]:
    """Return a cell as it was sent, a zip or a document by its suffix, and what was found in it; see `examined`."""
    bundle = CellBundle.of_zip(content) if suffix == ".zip" else CellBundle.of_text(content, f"cell{suffix}")
    return bundle, examined(bundle, folder, shipped)


@lru_cache(maxsize=16)
def survey_shelf(cell: Cell) -> list[CellSurvey]:
    """Return where the survey of a cell is put once it was made."""
    return []


class CellCollection(VersionedCells):
    """What one caller sees of all cells, by what a task may call them: a name, or an id.

    A name means a cell of the caller's own, and of several the newest; an administrator has everybody's by their ids.
    All methods block on the database, those that load or look at a cell for long: call them from a thread.
    """

    def __init__(
        self, shipped: Mapping[str, Cell], store: CellStore, caller: Caller = ANYBODY, *, deleted_too: bool = False
    ) -> None:
        """With `deleted_too`, cells are found by their ids for whoever looks at plans that are in them."""
        self.shipped, self._store, self._caller, self._deleted_too = shipped, store, caller, deleted_too

    def seen_by(self, caller: Caller) -> CellCollection:
        """Return what another caller sees."""
        return CellCollection(self.shipped, self._store, caller)

    def with_deleted(self) -> CellCollection:
        """Return these and deleted ones, by their ids."""
        return CellCollection(self.shipped, self._store, self._caller, deleted_too=True)

    def of_owner(self, owner: str | None) -> CellCollection:
        """Return everybody's cells by their ids, and an owner's by their names, as what is that owner's calls them."""
        caller = Caller(None, owner, Scope.ADMIN)
        return CellCollection(self.shipped, self._store, caller, deleted_too=self._deleted_too)

    def __getitem__(self, name: str) -> Cell:
        if name in self.shipped:
            return self.shipped[name]
        stored = self._find(name)
        cell = None if stored is None else self._store.load(stored.id)
        if cell is None:
            raise KeyError(name)
        return cell

    def __contains__(self, name: object) -> bool:
        return name in self.shipped or (isinstance(name, str) and self._find(name) is not None)

    def __iter__(self) -> Iterator[str]:
        yield from self.shipped
        yield from dict.fromkeys(cell.name for cell in self._store.all(self._caller.owner))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def lasting_name(self, name: str) -> str:
        """Return by what a task is to name a cell for good: a shipped one by its name, another by its id.

        What does not exist keeps its name, for whoever tells so.
        """
        if name in self.shipped:
            return name
        stored = self._find(name)
        return name if stored is None else stored.id

    def own(self) -> list[StoredCell]:
        """Return the caller's own cells by name, newest version first; an administrator's are everybody's."""
        return self._store.all(self._caller.owner, anybodys=self._caller.scope is Scope.ADMIN)

    def stored(self, cell_id: str) -> StoredCell:
        """Return one of the caller's own cells, by id or name; an administrator's are everybody's, by id.

        Raises:
            CellNotFound: There is none.
        """
        stored = self._find(cell_id)
        if stored is None:
            raise CellNotFound(cell_id, self, shipped=cell_id in self.shipped)
        return stored

    def findings(self, stored: StoredCell) -> CellFindings | None:
        """Return what was found in a cell when it was posted; None: it is gone by now."""
        return self._store.findings(stored.id)

    def notes(self, name: str) -> tuple[str, ...]:
        """Return what was noticed in a cell when it was posted; of a shipped one there is nothing to tell.

        Raises:
            CellNotFound: There is none.
        """
        found = None if name in self.shipped else self.findings(self.stored(name))
        return () if found is None else found.notes

    def limits(self) -> dict[str, CellLimits]:
        """Return what tasks must keep within, by name of the cell; one that cannot be loaded any more is left out."""
        shipped = {name: CellLimits.of(cell) for name, cell in self.shipped.items()}
        # As a task that names it would find it.
        ids = {name: self.lasting_name(name) for name in self if name not in shipped}
        found = self._store.limits(ids.values())
        own = {name: found[cell_id] for name, cell_id in ids.items() if cell_id in found}
        return dict(sorted({**shipped, **own}.items()))

    @property
    def folder(self) -> Path:
        """Where cells are unpacked."""
        return self._store.folder

    def add(self, bundle: CellBundle, findings: CellFindings) -> tuple[StoredCell, bool]:
        """Keep a cell, in which `examined` has found this; return it, and whether it was not there before."""
        return self._store.add(bundle, findings, self._caller.owner)

    def survey(self, name: str, look: LookAtCell) -> CellSurvey:
        """Return what was found in a cell, looked at as `look_at` does, if it was not before.

        Raises:
            CellNotFound: There is none.
        """
        if name not in self:
            raise CellNotFound(name, self)
        cell = self[name]
        place = survey_shelf(cell)
        if not place:
            place.append(look(cell))
        return place[0]

    def files(self, cell_id: str) -> bytes:
        """Return all files of one of the caller's own cells, as a zip.

        Raises:
            CellNotFound: There is none.
        """
        content = self._store.zip(self.stored(cell_id).id)
        if content is None:
            raise CellNotFound(cell_id)
        return content

    def delete(self, cell_id: str) -> None:
        """Have a cell for no more tasks. Plans that were made in it, or are under way, keep it.

        Raises:
            CellNotFound: There is none.
        """
        self._store.delete(self.stored(cell_id).id)

    def _find(self, name: str) -> StoredCell | None:
        stored = self._store.get(name)
        if stored is not None and self._caller.may_see(stored.owner) and (self._deleted_too or not stored.deleted):
            return stored
        return self._store.named(name, self._caller.owner)
