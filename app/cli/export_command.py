"""`liftwright export PLAN --target …`: a certified plan as a program for the robot's controllers."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from app.cli.given_file import FileKind, read_given, refuse_other
from app.cli.output import BadInput
from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell, known_cells, load_cell
from planners.contract.strict_json import NotJson, parse_json
from planners.errors import AssetError
from planners.plan.plan import Plan
from planners.program import NotExportable, ProgramTarget, write_program
from planners.program.guard import physics_words
from planners.program.urscript import Handshake

EXPORTED, REFUSED = 0, 2


def export_file(path: Path, target: ProgramTarget, handshake: Handshake, site: Path | None, out: Path | None) -> int:
    """Write the program of a plan as a zip and return the exit code.

    Args:
        path: of the plan document.
        target: what it becomes.
        handshake: how two controllers wait for each other.
        site: folder, zip or file of the cell that is there; None: the plan's cell is a shipped one.
        out: where it goes; None: beside the plan.

    Raises:
        BadInput: A file cannot be made sense of.
        OSError: A file cannot be read or written.
    """
    document = read_given(str(path), FileKind.PLAN)
    with site_cell(document, path, site) as cell:
        try:
            program = write_program(document, cell, target, handshake)
        except NotExportable as why:
            sys.stderr.write(f"liftwright: {path}: {why}\n")
            return REFUSED
    place = out or path.with_name(f"{path.stem}.{target.value}.zip")
    place.write_bytes(program)
    sys.stdout.write(f"{place}: {len(program) / 1e3:.0f} kB, for {cell.name}; docs/robot.md says how to run it\n")
    sys.stdout.write(f"{physics_words(Plan.read(document))}\n")
    return EXPORTED


@contextmanager
def site_cell(document: bytes, path: Path, site: Path | None) -> Iterator[Cell]:
    """Have the cell that is there for the time of a block.

    Args:
        document: of the plan.
        path: where it was read from.
        site: folder, zip or file of the cell; None: the plan's cell is a shipped one.

    Raises:
        BadInput: There is no such cell, or it cannot be made sense of.
    """
    with TemporaryDirectory(prefix="liftwright-cell-") as folder:
        try:
            cell = load_cell(_cell_of(document, path)) if site is None else CellBundle.read(site).load(Path(folder))
        except AssetError as error:
            raise BadInput(f"{site or path}: {error}") from error
        yield cell


def _cell_of(document: bytes, path: Path) -> str:
    """Return the name of the cell in a plan, which must be a shipped one."""
    try:
        data = parse_json(document, "the file")
    except NotJson as error:
        raise BadInput(f"{path}: {error}") from error
    refuse_other(data, str(path), FileKind.PLAN)
    cell = data.get("cell") if isinstance(data, dict) else None
    name = cell.get("name") if isinstance(cell, dict) else None
    if not isinstance(name, str):
        raise BadInput(f"{path} is not a plan document: it names no cell")
    if name not in known_cells():
        raise BadInput(f"{path} is a plan for the cell {name}, which is not shipped: give yours as --cell PATH")
    return name
