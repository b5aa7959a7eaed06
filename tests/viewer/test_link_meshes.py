"""Drawings of robots are light, and still have the robots' shapes."""

from __future__ import annotations

import io
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import trimesh
import viser
from scipy.spatial import KDTree

from app.viewer.drawing import link_meshes
from app.viewer.drawing.body_drawing import ArmDrawing, Drawings, link_files
from app.viewer.drawing.link_meshes import FULL, LIGHT, Detail, LinkMeshes, thin_out, visual_path, write_pieces
from planners.cell.asset_files import CylinderLinkFile, LinkFile, MeshFile, MeshLinkFile
from planners.cell.asset_shelf import shipped_shelf
from planners.cell.cell import known_cells, load_cell
from planners.geometry.pose import transform
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import among

LIGHT_SHARE = 0.4
"""Of the bytes of a full drawing, that a light one takes at most."""
LARGEST_ARM_BYTES = 1_000_000


class CountedDrawings(Drawings):
    """Counts what it gives out."""

    sent = 0

    def link(self, link: LinkFile, reach: float) -> bytes:
        return self._counted(super().link(link, reach))

    def hand(self, mesh: MeshFile) -> bytes:
        return self._counted(super().hand(mesh))

    def _counted(self, drawn: bytes) -> bytes:
        # Drawings are frozen, which a count cannot be.
        object.__setattr__(self, "sent", self.sent + len(drawn))
        return drawn


@pytest.fixture(scope="module")
def folder(shelf: PlanShelf) -> Path:
    """Return where drawings are that services of other tests need as well."""
    return shelf.drawings


@pytest.mark.parametrize("cell", among(known_cells(), known_cells()[:1]))
def test_no_arm_with_its_hand_takes_more_than_a_megabyte(cell: str, folder: Path) -> None:
    """Cylinders stand in for arms of which no meshes are published, and are light however they are drawn."""
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        for name, arm in load_cell(cell).arms.items():
            full = CountedDrawings(LinkMeshes(folder), shipped_shelf(), FULL)
            ArmDrawing(server.scene, arm, full, f"/{name}")
            light = CountedDrawings(LinkMeshes(folder), shipped_shelf(), LIGHT)
            ArmDrawing(server.scene, arm, light, f"/{name}_light")
            assert 0 < full.sent <= LARGEST_ARM_BYTES
            if not any(isinstance(link, CylinderLinkFile) for link in link_files(arm, shipped_shelf())):
                assert full.sent > 100_000
                assert light.sent < LIGHT_SHARE * full.sent
    finally:
        server.stop()


def test_a_drawing_that_several_ask_for_at_once_is_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shelf = shipped_shelf()
    link = link_files(load_cell("dual_ur3e_lift").arms["left"], shelf)[3]
    assert isinstance(link, MeshLinkFile)
    meshes, together, made = LinkMeshes(tmp_path), threading.Barrier(4), []
    write = link_meshes._write_glb
    monkeypatch.setattr(link_meshes, "_write_glb", lambda *given: made.append(given) or write(*given))

    def ask(_: int) -> bytes:
        together.wait()
        return meshes.glb(link.mesh, shelf, np.eye(4), LIGHT.links)

    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(ask, range(4)))) == 1
    assert len(made) == 1
    assert [path.suffix for path in tmp_path.iterdir()] == [".glb"]


def test_drawings_that_nobody_asks_for_any_more_are_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Everyone may bring cells: neither memory nor folder grows without end, and what is asked for last stays."""
    shelf = shipped_shelf()
    link = link_files(load_cell("dual_ur3e_lift").arms["left"], shelf)[3]
    assert isinstance(link, MeshLinkFile)
    made = list[object]()
    monkeypatch.setattr(link_meshes, "_write_glb", lambda *given: made.append(given) or bytes(1000))
    monkeypatch.setattr(link_meshes, "MOST_READ", 3500)
    monkeypatch.setattr(link_meshes, "MOST_KEPT", 3500)
    meshes = LinkMeshes(tmp_path)
    for place in (0, 1, 2, 0, 3, 0, 4, 5):
        meshes.glb(link.mesh, shelf, transform(position=np.array([float(place), 0.0, 0.0])), LIGHT.links)
    assert len(made) == 6
    assert sum(map(len, meshes._read.values())) <= 3500
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 3500
    meshes.glb(link.mesh, shelf, np.eye(4), LIGHT.links)
    assert len(made) == 6


@pytest.mark.parametrize("detail", [FULL, LIGHT], ids=["full", "light"])
def test_what_is_drawn_is_nowhere_far_from_the_mesh(folder: Path, detail: Detail) -> None:
    """Both ways: nothing sticks out, and nothing is lost."""
    arm = load_cell("dual_ur3e_lift").arms["left"]
    link = link_files(arm, shipped_shelf())[2]
    assert isinstance(link, MeshLinkFile)
    glb = LinkMeshes(folder).glb(link.mesh, shipped_shelf(), np.eye(4), detail.links)
    drawn = trimesh.load(io.BytesIO(glb), file_type="glb", force="mesh")
    whole = trimesh.load(visual_path(link.mesh, shipped_shelf()), force="mesh", process=False)
    points = [trimesh.sample.sample_surface(mesh, 20_000, seed=1)[0] for mesh in (drawn, whole)]
    diagonal = np.sqrt(3.0) * detail.links.cell
    for a, b in (points, points[::-1]):
        assert KDTree(a).query(b)[0].max() < 1.5 * diagonal


def test_thinning_keeps_the_volume_of_a_closed_body() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    vertices, faces = thin_out(np.asarray(ball.vertices), np.asarray(ball.faces), 0.01)
    assert len(faces) < 0.25 * len(ball.faces)
    thinned = trimesh.Trimesh(vertices, faces, process=False)
    assert thinned.volume == pytest.approx(ball.volume, rel=0.02)


def test_convex_pieces_are_drawn_as_they_are() -> None:
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    ball.apply_translation([1.0, 0.0, 0.0])
    drawn = trimesh.load(io.BytesIO(write_pieces([box.vertices.tolist(), ball.vertices.tolist()])), file_type="glb")
    assert isinstance(drawn, trimesh.Scene)
    volumes = sorted(part.convex_hull.volume for part in drawn.geometry.values())
    assert volumes == pytest.approx(sorted([box.volume, ball.volume]), rel=1e-5)
    np.testing.assert_allclose(drawn.bounds, trimesh.util.concatenate([box, ball]).bounds, atol=1e-6)
