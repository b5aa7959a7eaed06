"""Cells that are kept, and what is left of them on a machine's disk."""

from __future__ import annotations

import os
import time
from contextlib import closing
from pathlib import Path

import pytest
import sqlalchemy as sa

from app.access.audit_log import AuditLog
from app.access.authenticator import OpenAccess
from app.access.caller import Caller, Scope
from app.access.key_store import KeyStore
from app.access.rate_limiter import RateLimiter
from app.access.session_store import SessionStore
from app.errors import CellIsShipped, PointNotFound
from app.resources.cell_collection import CellCollection, examined
from app.resources.plan_collection import PlanCollection
from app.resources.study_collection import StudyCollection
from app.routes.capabilities import Capabilities, get_capabilities
from app.settings import ServiceSettings
from planners.cell.bundle import CellBundle
from planners.cell.cell import load_cells
from planners.errors import AssetError
from planners.study.study import Study
from planners.survey.cell_limits import CellLimits
from tests.support.own_cell import station, written
from tests.support.service import task
from workers.engine.housekeeping import clear_cells
from workers.stores.cell_store import SETTLED_SECONDS, CellFindings, CellStore, StoredCell
from workers.stores.database import Database
from workers.stores.job_queue import JobQueue
from workers.stores.plan_store import PlanStore, Room
from workers.stores.plan_writer import PlanWriter
from workers.stores.study_store import StudyStore
from workers.stores.tables import CELLS


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


def examine(collection: CellCollection, each: CellBundle) -> CellFindings:
    """Return what is found in a cell, as whoever takes one in does before."""
    return examined(each, collection.folder, collection.shipped)


def add(collection: CellCollection, each: CellBundle) -> StoredCell:
    """Have a collection keep a cell."""
    stored, _ = collection.add(each, examine(collection, each))
    return stored


def told_of(collection: CellCollection, database: Database, folder: Path) -> Capabilities:
    """Return what a service with these cells says of itself."""
    doors = OpenAccess(KeyStore(database), SessionStore(database), AuditLog(database), RateLimiter(1.0, 1))
    return get_capabilities(collection, ServiceSettings(data_dir=folder), doors)


def long_ago(folder: Path) -> None:
    """Have all that is in a folder been there for longer than anybody may still want it."""
    for path in folder.iterdir():
        os.utime(path, (time.time() - 2.0 * SETTLED_SECONDS,) * 2)


@pytest.mark.slow
def test_what_is_checked_or_refused_leaves_nothing_behind(cells: CellStore, folder: Path) -> None:
    collection = CellCollection(load_cells(), cells)
    assert examine(collection, bundle()).cell == "station"
    assert found(folder) == []
    refused: list[tuple[CellBundle, type[Exception]]] = [
        (bundle(gravity=[0, 0, 0]), AssetError),
        (bundle(mount="nowhere"), AssetError),
        (bundle(name="dual_ur3e_lift"), CellIsShipped),
    ]
    for each, error in refused:
        with pytest.raises(error):
            examine(collection, each)
        assert found(folder) == []


@pytest.mark.slow
def test_a_cell_that_was_kept_is_unpacked_once_somebody_wants_it(cells: CellStore, folder: Path) -> None:
    kept = bundle()
    stored = add(CellCollection({}, cells), kept)
    loaded = cells.load(stored.id)
    assert loaded is not None
    assert found(folder) == [kept.digest]
    assert cells.unpacked(stored.id) == folder / kept.digest == loaded.shelf.folders[0]


@pytest.mark.slow
def test_files_that_belong_to_no_cell_are_removed_once_nobody_can_want_them(cells: CellStore, folder: Path) -> None:
    collection, kept, other = CellCollection({}, cells), bundle(), bundle(gravity=[0, 0, -9.8])
    stored = add(collection, kept)
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


@pytest.mark.slow
def test_a_cell_of_anybody_keeps_its_files_and_a_forgotten_one_comes_back_with_them(
    cells: CellStore, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = bundle()
    collections = [CellCollection({}, cells, Caller(None, owner, Scope.WRITE)) for owner in ("somebody", None)]
    ids = [add(collection, kept).id for collection in collections]
    assert cells.load(ids[0]) is not None
    monkeypatch.setattr("workers.stores.cell_store.KEPT_US", -1)
    for cell_id, left in zip(ids, ([kept.digest], []), strict=True):
        cells.delete(cell_id)
        long_ago(folder)
        clear_cells(cells)
        assert found(folder) == left
    again = add(collections[0], kept)
    loaded = cells.load(again.id)
    assert loaded is not None
    assert loaded.shelf.folders[0].is_dir()


def test_what_somebody_asks_for_again_is_not_removed_under_their_hands(cells: CellStore, folder: Path) -> None:
    stored = add(CellCollection({}, cells), bundle())
    place = cells.unpacked(stored.id)
    assert place is not None
    long_ago(folder)
    assert cells.unpacked(stored.id) == place
    assert place.stat().st_mtime > time.time() - SETTLED_SECONDS


@pytest.mark.slow
def test_limits_of_cells_are_told_without_loading_one(database: Database, cells: CellStore, folder: Path) -> None:
    add(CellCollection({}, cells), bundle())
    told = told_of(CellCollection({}, CellStore(database, folder)), database, folder)
    assert found(folder) == []
    expected = CellLimits.of(bundle().load(folder))
    assert told.cell_limits == {"station": expected}


@pytest.mark.slow
def test_limits_that_an_earlier_version_did_not_keep_are_looked_up_once(
    database: Database, cells: CellStore, folder: Path
) -> None:
    collection = CellCollection({}, cells)
    stored = add(collection, bundle())
    findings = collection.findings(stored)
    assert findings is not None
    with database.engine.begin() as transaction:
        transaction.execute(sa.update(CELLS).values(figures=findings.model_dump_json(exclude={"notes", "limits"})))
    expected = {"station": CellLimits.of(bundle().load(folder))}
    fresh = CellCollection({}, CellStore(database, folder))
    assert fresh.limits() == expected
    with database.engine.begin() as transaction:
        transaction.execute(sa.update(CELLS).values(zip=b"no zip"))
    assert fresh.limits() == expected


@pytest.mark.slow
def test_a_cell_that_cannot_be_loaded_any_more_hides_no_other_one(
    database: Database, cells: CellStore, folder: Path
) -> None:
    collection = CellCollection({}, cells)
    for name in ("sound", "broken"):
        stored = add(collection, bundle(name=name))
    findings = collection.findings(stored)
    assert findings is not None
    with database.engine.begin() as transaction:
        broken = sa.update(CELLS).where(CELLS.c.name == "broken")
        transaction.execute(broken.values(zip=b"no zip", figures=findings.model_dump_json(exclude={"notes", "limits"})))
    told = told_of(CellCollection({}, CellStore(database, folder)), database, folder)
    assert told.cells == ["broken", "sound"]
    assert set(told.cell_limits) == {"sound"}


@pytest.mark.slow
def test_a_deleted_cell_stays_while_a_study_is_in_it_and_then_no_point_can_be_planned(
    database: Database, cells: CellStore, queue: JobQueue, store: PlanStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("workers.stores.cell_store.KEPT_US", -1)
    collection, studies, room = CellCollection({}, cells), StudyStore(database, store, queue), Room(9, 9, 9)
    cell = add(collection, bundle())
    axes = [{"pointer": "/cup/max_force", "values": [20.0, 30.0]}]
    study = Study.read({"task": task("pb1.json", cell=cell.id), "axes": axes}, lambda sent: sent, 9)
    kept, forgotten = (studies.accept(study, None, None, "sent") for _ in range(2))
    cells.delete(cell.id)
    assert cells.forget_deleted() == 0
    settings = ServiceSettings(data_dir=cells.folder)
    with closing(PlanWriter(store, queue, room)) as writer:
        asked = StudyCollection(studies, queue, PlanCollection(store, queue, writer, room), settings)
        plan = asked.plan_point(kept.id, 0, collection.with_deleted())
        assert plan == asked.plan_point(kept.id, 0, collection.with_deleted())
        store.delete(plan.id)
        studies.delete(kept.id)
        assert cells.forget_deleted() == 0
        with database.engine.begin() as transaction:
            transaction.execute(sa.delete(CELLS))
        with pytest.raises(PointNotFound, match="no cell"):
            asked.plan_point(forgotten.id, 0, collection.with_deleted())


def test_a_deleted_cell_goes_with_the_last_study_in_it(
    database: Database, cells: CellStore, queue: JobQueue, store: PlanStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("workers.stores.cell_store.KEPT_US", -1)
    cell = add(CellCollection({}, cells), bundle())
    studies = StudyStore(database, store, queue)
    axes = [{"pointer": "/cup/max_force", "values": [20.0, 30.0]}]
    study = Study.read({"task": task("pb1.json", cell=cell.id), "axes": axes}, lambda sent: sent, 9)
    record = studies.accept(study, None, None, "sent")
    cells.delete(cell.id)
    assert cells.forget_deleted() == 0
    studies.delete(record.id)
    assert cells.forget_deleted() == 1


def test_no_version_of_a_name_is_given_twice(cells: CellStore, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever kept a note of version 2 must not find something else under it."""
    monkeypatch.setattr("workers.stores.cell_store.KEPT_US", -1)
    collection = CellCollection({}, cells)
    first, second = (add(collection, bundle(gravity=[0, 0, -9.8 - each])) for each in (0.0, 0.01))
    for each in (first, second):
        cells.delete(each.id)
    assert cells.forget_deleted() == 2
    assert cells.forget_deleted() == 0
    assert cells.load(second.id) is None
    third = add(collection, bundle(gravity=[0, 0, -9.82]))
    assert [each.version for each in (first, second, third)] == [1, 2, 3]
    again = add(collection, bundle(gravity=[0, 0, -9.81]))
    assert (again.id, again.version) == (second.id, 2)
    assert cells.load(again.id) is not None


def test_a_cell_that_is_forgotten_while_it_is_posted_again_is_there(
    cells: CellStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    collection, kept = CellCollection({}, cells), bundle()
    stored = add(collection, kept)
    looked_up = cells.get(stored.id)
    with cells._database.engine.begin() as transaction:
        transaction.execute(sa.delete(CELLS))
    with monkeypatch.context() as just_before:
        answers = iter([looked_up])
        look = cells.get
        just_before.setattr(cells, "get", lambda cell_id: next(answers, None) or look(cell_id))
        assert add(collection, kept).id == stored.id
    assert cells.load(stored.id) is not None
