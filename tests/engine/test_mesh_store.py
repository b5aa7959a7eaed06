"""Uploaded meshes on a database of their own."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
import trimesh

from planners.geometry.solid_mesh import SolidMesh, take_mesh
from workers.stores.database import Database
from workers.stores.mesh_store import MeshStore


@pytest.fixture
def store(database: Database) -> MeshStore:
    return MeshStore(database)


@pytest.fixture(scope="module")
def mesh() -> SolidMesh:
    return take_mesh(trimesh.creation.icosphere(2, 0.1).export(file_type="stl"), "stl")


def test_a_mesh_comes_back_as_it_was_stored(store: MeshStore, mesh: SolidMesh) -> None:
    assert store.get("a") is None
    store.add("a", mesh)
    again = store.get("a")
    assert again is not None
    assert again.document() == mesh.document()
    assert store.get("a") is again, "its parts are found once for all tasks that name it"


def test_one_mesh_is_stored_once_however_many_bring_it_at_once(store: MeshStore, mesh: SolidMesh) -> None:
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: store.add("a", mesh), range(16)))
    assert list(store.documents(["a", "b"])) == ["a"]


def test_asking_for_no_mesh_gives_none(store: MeshStore) -> None:
    assert store.documents([]) == {}
