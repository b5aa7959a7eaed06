"""Perceived scenes, named by the scans they come from. Nothing is ever changed, so that tasks keep what they name."""

from __future__ import annotations

import gzip
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from planners.contract.scene_document import SceneDocument
from workers.database import Database
from workers.tables import SCENES
from workers.time_stamp import now_us

GZIP_LEVEL = 6


@dataclass(frozen=True, eq=False)
class StoredScene:
    """A scene that is kept."""

    id: str
    created_us: int
    """Microseconds since 1970, UTC."""
    document: SceneDocument


class SceneStore:
    """Reads and writes perceived scenes. Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._engine = database.engine

    def add(self, scene_id: str, document: SceneDocument, preview: bytes) -> None:
        """Store a scene with its picture; nothing happens if it is there already."""
        body = gzip.compress(document.model_dump_json().encode(), GZIP_LEVEL, mtime=0)
        row = {"id": scene_id, "created_us": now_us(), "gzip": body, "preview": preview}
        try:
            with self._engine.begin() as transaction:
                transaction.execute(sa.insert(SCENES).values(row))
        except IntegrityError:
            pass  # The same scan gives the same scene.

    def get(self, scene_id: str) -> StoredScene | None:
        """Return a scene."""
        query = sa.select(SCENES.c.created_us, SCENES.c.gzip).where(SCENES.c.id == scene_id)
        with self._engine.connect() as connection:
            row = connection.execute(query).one_or_none()
        if row is None:
            return None
        return StoredScene(scene_id, row.created_us, SceneDocument.model_validate_json(gzip.decompress(row.gzip)))

    def document(self, scene_id: str) -> SceneDocument | None:
        """Return what was perceived in a scene."""
        scene = self.get(scene_id)
        return None if scene is None else scene.document

    def preview(self, scene_id: str) -> bytes | None:
        """Return the PNG picture of a scene."""
        with self._engine.connect() as connection:
            return connection.scalar(sa.select(SCENES.c.preview).where(SCENES.c.id == scene_id))
