"""Who gets a scene, and that its place is given back."""

from __future__ import annotations

import asyncio
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from app.resources.cell_collection import CellCollection
from app.viewer.drawing.camera import VIEWS
from app.viewer.drawing.link_meshes import LinkMeshes
from app.viewer.scene_servers import SceneServer, SceneServers, WatcherRoom
from app.work.workbench import Workbench
from planners.cell.cell import ShippedCells
from workers.settings import WorkerSettings
from workers.stores.cell_store import CellStore
from workers.stores.database import open_database


def test_a_scene_that_cannot_be_told_of_is_closed_and_its_place_given_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed: list[SceneServer] = []
    close = SceneServer.close

    def close_and_count(server: SceneServer) -> None:
        closed.append(server)
        close(server)

    monkeypatch.setattr(SceneServer, "close", close_and_count)

    async def enter_twice(cells: CellCollection) -> None:
        addresses = tmp_path / "watched"
        servers = SceneServers(cells, tmp_path / "drawings", addresses, WatcherRoom(1, 1), Workbench(2**30))
        addresses.rmdir()
        with pytest.raises(FileNotFoundError):
            await servers.enter("mes")
        assert len(closed) == 1
        addresses.mkdir()
        server = await servers.enter("mes")
        assert servers.address(server.key) == server.address
        # Of a process that was killed, whose number another one has by now.
        left = addresses / server.key[::-1]
        left.write_text((addresses / server.key).read_text())
        assert servers.address(left.name) is None
        again = SceneServers(cells, tmp_path / "drawings", addresses, WatcherRoom(1, 1), Workbench(2**30))
        assert not left.exists()
        assert again.address(server.key) == server.address
        await servers.close()
        assert again.address(server.key) is None

    with closing(open_database(WorkerSettings(data_dir=tmp_path))) as database:
        asyncio.run(enter_twice(CellCollection(ShippedCells(), CellStore(database, tmp_path / "cells"))))


def test_whoever_comes_after_a_view_was_chosen_sees_that_view(tmp_path: Path) -> None:
    """A browser that still reads the scene has told of itself, and takes the scene's first camera when it is read."""
    cell = ShippedCells()["dual_ur3e_lift"]
    with SceneServer() as server:
        server.look(VIEWS["top"])
        server.show_cell(cell, LinkMeshes(tmp_path))
        for view in VIEWS.values():
            server.look(view)
            first = server._server.initial_camera
            position, target = server._place(view)
            np.testing.assert_allclose([first.position, first.look_at], [position, target])
