"""What is kept on disk is trusted only as far as it proves itself."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from planners.progress import Report
from planners.regrasp.grasps.handover_place import HandoverPlaceSettings
from planners.regrasp.grasps.handovers import HandoverDatabase, HandoverSettings, find_handovers
from planners.regrasp.grasps.tool_grasps import ToolGraspSettings
from workers.stores.handover_store import HandoverStore

SMALL = HandoverSettings(
    ToolGraspSettings(rolls=4), HandoverPlaceSettings(step=0.2, finest=0.2, grasps=16, best=2), axis_rolls=1
)


@pytest.fixture(scope="module")
def database(cell, short_tool) -> HandoverDatabase:
    return find_handovers(cell, short_tool, SMALL)


@pytest.fixture
def store(tmp_path) -> HandoverStore:
    return HandoverStore(tmp_path / "handovers")


def only_file(tmp_path):
    (path,) = (tmp_path / "handovers").iterdir()
    return path


class Heard:
    """Progress that remembers whether anything was computed."""

    def __init__(self) -> None:
        self.anything = False

    def __call__(self, _: Report, /) -> None:
        self.anything = True


def test_a_database_is_computed_once_and_then_read(cell, short_tool, store, tmp_path, database):
    first, second = Heard(), Heard()
    computed = store.get(cell, short_tool, SMALL, first)
    read = HandoverStore(tmp_path / "handovers").get(cell, short_tool, SMALL, second)
    assert first.anything
    assert not second.anything
    assert computed.to_bytes() == read.to_bytes() == database.to_bytes()


@pytest.mark.parametrize("damage", ["cut", "foreign", "garbage", "empty"])
def test_a_file_that_cannot_be_trusted_is_computed_again(cell, short_tool, store, tmp_path, database, damage):
    store.save(database)
    path = only_file(tmp_path)
    good = path.read_bytes()
    contents = {
        "cut": good[:-100],
        "foreign": replace(database, key="f" * 64).to_bytes(),
        "garbage": b"garbage",
        "empty": b"",
    }
    path.write_bytes(contents[damage])
    assert store.load(database.key) is None
    heard = Heard()
    assert store.get(cell, short_tool, SMALL, heard).to_bytes() == good
    assert heard.anything
    assert path.read_bytes() == good


def test_what_was_never_kept_is_not_there(store):
    assert store.load("0" * 64) is None


def test_nothing_but_whole_files_is_ever_seen_while_many_write(store, database, tmp_path):
    def write_and_read(_: int) -> bool:
        store.save(database)
        found = store.load(database.key)
        return found is not None and found.key == database.key

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(write_and_read, range(20)))
    assert only_file(tmp_path).read_bytes() == database.to_bytes()


def test_a_folder_that_cannot_be_made_costs_no_plan(cell, short_tool, tmp_path, database):
    (tmp_path / "file").write_text("in the way")
    store = HandoverStore(tmp_path / "file" / "handovers")
    assert store.get(cell, short_tool, SMALL).to_bytes() == database.to_bytes()


def test_those_not_used_for_longest_are_forgotten(tmp_path, database):
    store = HandoverStore(tmp_path, most_bytes=2 * len(database.to_bytes()) + 1)
    for age, name in ((30, "a"), (20, "b")):
        store.save(replace(database, key=name * 64))
        os.utime(tmp_path / f"{name * 64}.handovers", (age, age))
    assert store.load("a" * 64) is not None
    store.save(replace(database, key="c" * 64))
    assert store.load("b" * 64) is None
    assert store.load("a" * 64) is not None
    assert store.load("c" * 64) is not None
