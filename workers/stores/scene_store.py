"""Perceived scenes, named by the scans they come from. A scene is never changed, and stays while a plan names it."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from planners.contract.scene_document import SceneDocument
from planners.perception.perceive import PerceivedScene
from planners.perception.seen_points import SeenPoints
from workers.stores.database import Database
from workers.stores.tables import PLANS, SCENES, Position, newest_first, now_us

GZIP_LEVEL = 6


@dataclass(frozen=True, eq=False)
class StoredScene:
    """A scene that is kept."""

    id: str
    owner: str | None
    """Whose key it was posted with; None where no keys were asked for."""
    created_us: int
    """Microseconds since 1970, UTC."""
    document: SceneDocument


_COLUMNS: list[sa.ColumnElement[Any]] = [SCENES.c.id, SCENES.c.owner, SCENES.c.created_us, SCENES.c.gzip]
_SCENES = sa.select(*_COLUMNS)


class SceneStore:
    """Reads and writes perceived scenes. Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, scene_id: str, perceived: PerceivedScene, owner: str | None = None) -> None:
        """Store a scene with its picture and its points; nothing happens if it is there already."""
        now = now_us()
        body = gzip.compress(perceived.document.model_dump_json().encode(), GZIP_LEVEL, mtime=0)
        points = None if perceived.points is None else gzip.compress(perceived.points.to_bytes(), GZIP_LEVEL, mtime=0)
        row = {
            "id": scene_id,
            "owner": owner,
            "created_us": now,
            "posted_us": now,
            "gzip": body,
            "preview": perceived.preview,
            "points": points,
        }
        try:
            self._database.write(sa.insert(SCENES).values(row))
        except IntegrityError:
            # The same scan gives the same scene.
            self._database.confirm()

    def touch(self, scene_id: str) -> None:
        """Note that the scan of a scene was posted again: from now on it is kept as long as a new one."""
        self._database.write(sa.update(SCENES).where(SCENES.c.id == scene_id).values(posted_us=now_us()))

    def get(self, scene_id: str) -> StoredScene | None:
        """Return a scene."""
        found = self._database.rows(_SCENES.where(SCENES.c.id == scene_id))
        return _stored(found[0]) if found else None

    def newest(self, most: int, before: Position | None, owner: str | None = None) -> list[StoredScene]:
        """Return at most `most` scenes, newest first, from behind the one at `before`.

        With an `owner`, only those that belong to it.
        """
        query = newest_first(_SCENES, SCENES, most, before)
        if owner is not None:
            query = query.where(SCENES.c.owner == owner)
        return [_stored(row) for row in self._database.rows(query)]

    def preview(self, scene_id: str) -> bytes | None:
        """Return the PNG picture of a scene."""
        return self._database.scalar(sa.select(SCENES.c.preview).where(SCENES.c.id == scene_id))

    def points(self, scene_id: str) -> SeenPoints | None:
        """Return what was measured in a scene; None where nothing was, or none of it was kept."""
        content = self._database.scalar(sa.select(SCENES.c.points).where(SCENES.c.id == scene_id))
        return None if content is None else SeenPoints.from_bytes(gzip.decompress(content))

    def delete(self, scene_id: str) -> None:
        """Remove a scene."""
        self._database.write(sa.delete(SCENES).where(SCENES.c.id == scene_id))

    def delete_before(self, time_us: int) -> int:
        """Remove all scenes that were last posted before a time and that no plan names; return how many there were."""
        named = sa.exists().where(PLANS.c.scene_id == SCENES.c.id)
        posted = sa.func.coalesce(SCENES.c.posted_us, SCENES.c.created_us)
        return self._database.write(sa.delete(SCENES).where(posted < time_us, ~named))


def _stored(row: Any) -> StoredScene:
    document = SceneDocument.model_validate_json(gzip.decompress(row.gzip))
    return StoredScene(row.id, row.owner, row.created_us, document)
