"""All that watchers share: plans and perceived scenes, the cells, the drawings of robots; and who watches."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
from anyio import CapacityLimiter
from starlette.concurrency import run_in_threadpool

from app.errors import CellNotDrawn, TheatreFull
from app.resources.plan_collection import PlanCollection
from app.resources.scene_collection import SceneCollection
from app.viewer.link_meshes import LinkMeshes
from app.viewer.perceived_words import tell_perceived
from app.viewer.recording import record
from app.viewer.room import Room
from app.viewer.sources import Sources
from app.viewer.story import tell_story
from planners.cell.cell import Cell

MOST_ROOMS = 24
"""Each room is a server with a scene in memory, some 10 MB."""


class Theatre:
    """Opens rooms and puts plans and perceived scenes into them."""

    def __init__(self, cells: dict[str, Cell], folder: Path) -> None:
        self._cells = cells
        self._meshes = LinkMeshes(folder)
        self._rooms: dict[str, Room] = {}
        self._recorders = CapacityLimiter(1)

    async def enter(self) -> Room:
        """Open a room.

        Raises:
            TheatreFull: There are too many.
        """
        if len(self._rooms) >= MOST_ROOMS:
            raise TheatreFull(MOST_ROOMS)
        room = await run_in_threadpool(Room)
        self._rooms[room.key] = room
        return room

    async def leave(self, room: Room) -> None:
        """Close a room."""
        self._rooms.pop(room.key, None)
        await run_in_threadpool(room.close)

    def room(self, key: str) -> Room | None:
        """Return the room of a key."""
        return self._rooms.get(key)

    def open(self, room: Room, desk: PlanCollection, plan_id: str) -> dict[str, Any]:
        """Put a plan into a room and return its story. Blocks.

        Raises:
            PlanNotFound: There is no plan of that id.
            DocumentNotReady: Its job has not succeeded.
            CellNotDrawn: There are no drawings of its cell.
        """
        document, sources, cell = self._load(desk, plan_id)
        room.open(document, sources, cell, self._meshes)
        return tell_story(document, sources)

    def open_perceived(self, room: Room, scenes: SceneCollection, scene_id: str) -> dict[str, Any]:
        """Put a perceived scene into a room and return what the page tells of it. Blocks.

        Raises:
            SceneNotFound: There is no scene of that id.
            CellNotDrawn: There are no drawings of its cell.
        """
        document, points = scenes.scene(scene_id).document, scenes.points(scene_id)
        room.open_perceived(document, points, self._cell(document.cell), self._meshes)
        return tell_perceived(scene_id, document, points)

    def record(self, desk: PlanCollection, plan_id: str) -> str:
        """Return a page that plays a plan without any server. Blocks for some seconds.

        Raises:
            PlanNotFound: There is no plan of that id.
            DocumentNotReady: Its job has not succeeded.
            CellNotDrawn: There are no drawings of its cell.
        """
        document, sources, cell = self._load(desk, plan_id)
        with Room() as room:
            room.open(document, sources, cell, self._meshes)
            return record(room, sources, tell_story(document, sources))

    @property
    def recorders(self) -> CapacityLimiter:
        """One recording at a time: each keeps a core busy."""
        return self._recorders

    async def close(self) -> None:
        """Close all rooms."""
        for room in list(self._rooms.values()):
            await self.leave(room)

    def _load(self, desk: PlanCollection, plan_id: str) -> tuple[dict[str, Any], Sources, Cell]:
        document = json.loads(gzip.decompress(desk.document(plan_id).gzip))
        cell = self._cell(document["cell"]["name"])
        start = document["task"]["start_positions"]
        return document, Sources.of(document, cell.home if start is None else np.array(start)), cell

    def _cell(self, name: str) -> Cell:
        if name not in self._cells:
            raise CellNotDrawn(name, sorted(self._cells))
        return self._cells[name]
