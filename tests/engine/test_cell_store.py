"""Cells that are kept, and what is left of them on a machine's disk."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from support.own_cell import station, written

from app.errors import CellIsShipped
from app.resources.cell_collection import CellCollection
from planners.cell.bundle import CellBundle
from planners.cell.cell import load_cells
from planners.errors import AssetError
from workers.engine.housekeeping import clear_cells
from workers.stores.cell_store import SETTLED_SECONDS, CellStore
from workers.stores.database import Database


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "cells"


@pytest.fixture
def cells(database: Database, folder: Path) -> CellStore:
    return CellStore(database, folder)


def bundle(**members: object) -> CellBundle:
    return CellBundle.of_text(written(station(**members)))


def found(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []


def long_ago(folder: Path) -> None:
    """Have all that is in a folder been there for longer than anybody may still want it."""
    for path in folder.iterdir():
        os.utime(path, (time.time() - 2.0 * SETTLED_SECONDS,) * 2)


def test_what_is_checked_or_refused_leaves_nothing_behind(cells: CellStore, folder: Path) -> None:
    collection = CellCollection(load_cells(), cells)
    assert collection.examine(bundle()).cell == "station"
    assert found(folder) == []
    refused: list[tuple[Callable[[CellBundle], object], CellBundle, type[Exception]]] = [
        (collection.examine, bundle(gravity=[0, 0, 0]), AssetError),
        (collection.add, bundle(gravity=[0, 0, 0]), AssetError),
        (collection.add, bundle(mount="nowhere"), AssetError),
        (collection.add, bundle(name="dual_ur3e_lift"), CellIsShipped),
    ]
    for take, each, error in refused:
        with pytest.raises(error):
            take(each)
        assert found(folder) == []


def test_a_cell_that_was_kept_is_unpacked_once_somebody_wants_it(cells: CellStore, folder: Path) -> None:
    kept = bundle()
    stored, _ = CellCollection({}, cells).add(kept)
    loaded = cells.load(stored.id)
    assert loaded is not None
    assert found(folder) == [kept.digest]
    assert cells.unpacked(stored.id) == folder / kept.digest == loaded.shelf.folders[0]


def test_files_that_belong_to_no_cell_are_removed_once_nobody_can_want_them(cells: CellStore, folder: Path) -> None:
    collection, kept, other = CellCollection({}, cells), bundle(), bundle(gravity=[0, 0, -9.8])
    stored, _ = collection.add(kept)
    cells.load(stored.id)
    other.unpack(folder)
    (folder / ".unpacking-killed").mkdir()
    (folder / "notes").mkdir()
    everything = found(folder)
    clear_cells(cells)
    assert found(folder) == everything
    long_ago(folder)
    clear_cells(cells)
    assert found(folder) == sorted([kept.digest, "notes"])


def test_a_cell_of_anybody_keeps_its_files_and_a_forgotten_one_comes_back_with_them(
    cells: CellStore, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept, figures = bundle(), CellCollection({}, cells).examine(bundle())
    ids = [cells.add(kept, figures, owner)[0].id for owner in ("somebody", None)]
    assert cells.load(ids[0]) is not None
    monkeypatch.setattr("workers.stores.cell_store.KEPT_US", -1)
    for cell_id, left in zip(ids, ([kept.digest], []), strict=True):
        cells.delete(cell_id)
        long_ago(folder)
        clear_cells(cells)
        assert found(folder) == left
    again, _ = cells.add(kept, figures, "somebody")
    loaded = cells.load(again.id)
    assert loaded is not None
    assert loaded.shelf.folders[0].is_dir()


def test_what_somebody_asks_for_again_is_not_removed_under_their_hands(cells: CellStore, folder: Path) -> None:
    stored, _ = CellCollection({}, cells).add(bundle())
    place = cells.unpacked(stored.id)
    assert place is not None
    long_ago(folder)
    assert cells.unpacked(stored.id) == place
    assert place.stat().st_mtime > time.time() - SETTLED_SECONDS
