"""`liftwright cell`: check, keep, list and show cells, on this machine or in a service."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from itertools import chain
from pathlib import Path
from typing import Protocol

from app.cli.given_file import check_cell_path
from app.cli.output import BadInput, refuse
from app.cli.service_client import ServiceClient, ServiceRefused
from app.errors import CellIsShipped, ServiceError
from app.pictures.survey_picture import draw_survey
from app.resources.cell_collection import CellCollection, examined, look_at
from app.resources.schemas import CellList, CellResource
from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell, known_cells, load_cells
from planners.contract.problems import Problem
from planners.errors import AssetError, AssetFault, AssetFaults
from planners.survey.faults import doubts_about, load_checked, surveyed
from planners.survey.survey import SurveyFigures
from workers.settings import WorkerSettings
from workers.stores.cell_store import CellStore
from workers.stores.database import open_database

DONE = 0
COLUMNS = ("name", "version", "id", "added")


class CellKeeper(Protocol):
    """Keeps cells: a database of this machine, or a service."""

    def add(self, bundle: CellBundle) -> CellResource:
        """Keep a cell."""
        ...

    def all(self) -> Sequence[CellResource]:
        """Return the shipped cells and those that are kept."""
        ...

    def survey(self, name: str) -> tuple[SurveyFigures, Callable[[], bytes]]:
        """Return what a cell can do, and what draws it."""
        ...

    def files(self, name: str) -> bytes:
        """Return all files of a cell as a zip."""
        ...

    def delete(self, name: str) -> None:
        """Have a cell no more."""
        ...


def check_cell_files(path: Path, picture: Path | None) -> int:
    """Say what is wrong with a cell or what it can do, and return the exit code; nothing is kept.

    Raises:
        OSError: A file cannot be read or written.
    """
    try:
        bundle = _read(path)
        cell = _checked(bundle)
        survey = surveyed(cell, bundle)
    except AssetError as error:
        return _refuse(error, path)
    _note(bundle.notes, doubts_about(cell))
    _tell(survey.figures())
    if picture is not None:
        picture.write_bytes(draw_survey(survey))
    return DONE


def _read(path: Path) -> CellBundle:
    """Read a cell of one's own.

    Raises:
        AssetError: It is none.
        BadInput: There is no such file, or it is something else.
        OSError: It cannot be read.
    """
    check_cell_path(path)
    return CellBundle.read(path)


def _checked(bundle: CellBundle) -> Cell:
    """Load a cell that could be kept.

    Raises:
        AssetError: All that is wrong with it, a name of a shipped one included.
    """
    faults, cell = AssetFaults(), None
    if bundle.name in known_cells():
        shipped = AssetFault(str(CellIsShipped(bundle.name)), f"cells/{bundle.name}.yaml", "/name")
        faults.take([bundle.as_given(shipped)])
    with faults.at(""), tempfile.TemporaryDirectory(prefix="liftwright-cell-") as place:
        cell = load_checked(bundle, Path(place))
    if cell is None or faults.found:
        raise AssetError(*faults.found)
    return cell


def add_cell(path: Path, keeper: CellKeeper) -> int:
    """Keep the cell in a folder, a zip or a file, and return the exit code.

    Raises:
        OSError: A file cannot be read.
    """
    try:
        bundle = _read(path)
        added = keeper.add(bundle)
    except AssetError as error:
        return _refuse(error, path)
    # Files are sent as they were taken, so that a service knows nothing of what was left out.
    _note(bundle.notes, added.notes or ())
    if added.figures is not None:
        _tell(added.figures)
    version = "" if added.version is None else f", version {added.version}"
    sys.stdout.write(
        f'kept as {added.name}{version}; tasks name it as "cell": "{added.name}", or for good "{added.id}"\n'
    )
    return DONE


def list_cells(keeper: CellKeeper) -> int:
    """Print a table of all cells, and return the exit code."""
    rows = [COLUMNS, *(_row(cell) for cell in keeper.all())]
    widths = [max(len(row[column]) for row in rows) for column in range(len(COLUMNS))]
    for row in rows:
        sys.stdout.write("  ".join(map(str.ljust, row, widths)).rstrip() + "\n")
    return DONE


def show_cell(name: str, keeper: CellKeeper, picture: Path | None, files: Path | None) -> int:
    """Print what a cell can do, write its picture and its files, and return the exit code.

    Raises:
        OSError: A file cannot be written.
    """
    figures, draw = keeper.survey(name)
    _tell(figures)
    if picture is not None:
        picture.write_bytes(draw())
    if files is not None:
        files.write_bytes(keeper.files(name))
    return DONE


def refuse_file_as_name(name: str) -> None:
    """Refuse files where the name of a cell is meant.

    Raises:
        BadInput: It is a path; it says which commands take one.
    """
    # A name has neither; a file or folder of the same name may well lie beside.
    if "/" in name or Path(name).suffix:
        detail = "is a path, not the name of a cell that is shipped or kept"
        take = f"`liftwright cell check {name}` says what it can do, `liftwright cell add {name}` keeps it"
        raise BadInput(f"{name} {detail}; {take}")


class LocalCells:
    """Keeps cells in a database, which a service may use at the same time."""

    def __init__(self, cells: CellCollection) -> None:
        self._cells = cells

    def add(self, bundle: CellBundle) -> CellResource:
        """Keep a cell.

        Raises:
            AssetError: Something is wrong with it.
            BadInput: It is called as a shipped one is.
        """
        with _said_plainly():
            findings = examined(bundle, self._cells.folder, self._cells.shipped)
        stored, _ = self._cells.add(bundle, findings)
        return CellResource.of(stored, findings)

    def all(self) -> list[CellResource]:
        """Return the shipped cells and those that are kept."""
        shipped = [CellResource.of_shipped(cell) for _, cell in sorted(self._cells.shipped.items())]
        return [*shipped, *(CellResource.of(stored) for stored in self._cells.own())]

    def survey(self, name: str) -> tuple[SurveyFigures, Callable[[], bytes]]:
        """Return what a cell can do, and what draws it.

        Raises:
            BadInput: There is none of this name.
        """
        with _said_plainly():
            found = self._cells.survey(name, look_at)
        return found.figures(), lambda: draw_survey(found)

    def files(self, name: str) -> bytes:
        """Return all files of a cell as a zip.

        Raises:
            BadInput: There is none of this name, or it is shipped.
        """
        with _said_plainly():
            return self._cells.files(name)

    def delete(self, name: str) -> None:
        """Have a cell no more.

        Raises:
            BadInput: There is none of this name, or it is shipped.
        """
        with _said_plainly():
            self._cells.delete(name)


@contextmanager
def local_cells(settings: WorkerSettings) -> Iterator[LocalCells]:
    """Open the database in which cells are kept."""
    with closing(open_database(settings)) as database:
        yield LocalCells(CellCollection(load_cells(), CellStore(database, settings.cells_dir)))


class ServiceCells:
    """Has a service keep cells."""

    def __init__(self, address: str) -> None:
        self._client = ServiceClient(address)

    def add(self, bundle: CellBundle) -> CellResource:
        """Keep a cell.

        Raises:
            AssetError: Something is wrong with it.
            KeyMissing, ServiceRefused, ServiceAway: It was not accepted.
        """
        if bundle.faults:
            # What is sent lacks the files that something is wrong with.
            _checked(bundle)
        try:
            return self._client.understood(
                CellResource, self._client.post("/v1/cells", bundle.zip(), "application/zip")
            )
        except ServiceRefused as error:
            if not error.is_about_the_input:
                raise
            told = (
                AssetFault(each.detail, each.file or "", each.pointer, tuple(each.allowed or ()))
                for each in error.problems
            )
            raise AssetError(*map(bundle.as_given, told)) from error

    def all(self) -> list[CellResource]:
        """Return the shipped cells and those that are kept."""
        return self._client.read_as(CellList, "/v1/cells").cells

    def survey(self, name: str) -> tuple[SurveyFigures, Callable[[], bytes]]:
        """Return what a cell can do, and what draws it."""
        address = f"/v1/cells/{name}/survey"
        figures = self._client.read_as(SurveyFigures, address)
        return figures, lambda: self._client.read(f"{address}.png")

    def files(self, name: str) -> bytes:
        """Return all files of a cell as a zip."""
        return self._client.read(f"/v1/cells/{name}/files.zip")

    def delete(self, name: str) -> None:
        """Have a cell no more."""
        self._client.delete(f"/v1/cells/{name}")


@contextmanager
def _said_plainly() -> Iterator[None]:
    """Have what a service would answer with be said as bad input."""
    try:
        yield
    except ServiceError as error:
        raise BadInput(str(error)) from error


def _row(cell: CellResource) -> tuple[str, str, str, str]:
    added = "shipped" if cell.created_at is None else f"{cell.created_at:%Y-%m-%d %H:%M}"
    return cell.name, "" if cell.version is None else str(cell.version), cell.id, added


def _tell(figures: SurveyFigures) -> None:
    sys.stdout.write(f"{figures.cell}\n" + "".join(f"  {sentence}\n" for sentence in figures.sentences))


def _note(*notes: Iterable[str]) -> None:
    for note in dict.fromkeys(chain.from_iterable(notes)):
        sys.stderr.write(f"note: {note}\n")


def _refuse(error: AssetError, path: Path) -> int:
    return refuse([Problem.of_fault(each, str(path)) for each in error.faults], str(path))
