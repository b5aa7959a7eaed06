"""What is drawn once for a cell stays from one plan to the next, and only then is drawn anew when it has to be."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.drawing.link_meshes import FULL, LIGHT, LinkMeshes
from app.viewer.drawing.plan_scene import NAME_GAP
from app.viewer.playback import Playback
from app.viewer.scene_servers import SceneServer
from planners.cell.cell import Cell
from tests.support.documents import plan_of
from tests.support.scaled_cell import scaled_cell


class CountedMeshes(LinkMeshes):
    """Counts how often a drawing is taken."""

    taken = 0

    def glb(self, *given: Any, **settings: Any) -> bytes:
        """Return the drawing."""
        self.taken += 1
        return super().glb(*given, **settings)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> CountedMeshes:
    return CountedMeshes(Path(tmp_path_factory.getbasetemp()) / "meshes")


@pytest.fixture
def server() -> Iterator[SceneServer]:
    with SceneServer() as server:
        yield server


def names(server: SceneServer) -> set[str]:
    """Return the names of all nodes of a scene."""
    return set(server._server.scene._handle_from_node_name)


def test_robots_are_drawn_once_for_the_cell_and_all_plans_in_it(
    server: SceneServer, meshes: CountedMeshes, document: dict[str, Any], cell: Cell
) -> None:
    server.show_cell(cell, meshes)
    taken, stage = meshes.taken, {name for name in names(server) if name.startswith("/stage")}
    assert taken > 0
    seen = []
    for _ in range(2):
        server.open(Playback(plan_of(document)), cell, meshes)
        assert stage <= names(server)
        seen.append({name for name in names(server) if name.startswith("/opened")})
    assert meshes.taken == taken
    assert not seen[0] & seen[1], "what the plan before had is gone, and no name comes again"


@pytest.mark.slow
def test_another_detail_draws_the_robots_anew(
    server: SceneServer, meshes: CountedMeshes, document: dict[str, Any], cell: Cell
) -> None:
    server.open(Playback(plan_of(document)), cell, meshes)
    before = {name for name in names(server) if name.startswith("/stage")}
    for detail in (LIGHT, FULL):
        taken, server.detail = meshes.taken, detail
        server.open(Playback(plan_of(document)), cell, meshes)
        assert meshes.taken > taken
    assert not before & names(server)


@pytest.mark.slow
def test_arrows_frames_and_the_distance_of_names_are_as_large_as_the_cell(
    server: SceneServer, meshes: CountedMeshes, document: dict[str, Any], cell: Cell, tmp_path: Path
) -> None:
    sizes, names_at = list[list[float]](), list[list[float]]()
    for each in (cell, scaled_cell(cell.name, 2.0, tmp_path)):
        server.open(Playback(plan_of(document)), each, meshes)
        nodes = server._server.scene._handle_from_node_name
        drawn = [handle for name, handle in nodes.items() if name.startswith(("/stage", "/opened"))]
        axes = [handle.axes_length for handle in drawn if isinstance(handle, viser.FrameHandle) and handle.show_axes]
        heads = [handle.head_length for handle in drawn if isinstance(handle, viser.ArrowsHandle)]
        assert axes
        assert heads
        sizes.append([*axes, *heads])
        names_at.append([handle.position[2] for handle in drawn if isinstance(handle, viser.LabelHandle)])
    assert np.allclose(2.0 * np.array(sizes[0]), sizes[1])
    assert np.allclose(np.array(names_at[0]) + NAME_GAP, names_at[1])
