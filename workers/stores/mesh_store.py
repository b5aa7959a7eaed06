"""Uploaded meshes, named by their content. Nothing is ever changed or removed, so that accepted jobs keep theirs."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterable
from functools import lru_cache

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from planners.geometry.solid_mesh import MeshDocument, SolidMesh
from workers.stores.database import Database
from workers.stores.tables import MESHES, now_us

GZIP_LEVEL = 6


class MeshStore:
    """Reads and writes meshes that were taken in. Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, mesh_id: str, mesh: SolidMesh) -> None:
        """Store a mesh; nothing happens if it is there already."""
        body = json.dumps(mesh.document(), separators=(",", ":"), allow_nan=False).encode()
        row = {"id": mesh_id, "created_us": now_us(), "gzip": gzip.compress(body, GZIP_LEVEL, mtime=0)}
        try:
            self._database.write(sa.insert(MESHES).values(row))
        except IntegrityError:
            # The same content has the same id.
            self._database.confirm()

    def get(self, mesh_id: str) -> SolidMesh | None:
        """Return a mesh."""
        query = sa.select(MESHES.c.gzip).where(MESHES.c.id == mesh_id)
        return next((_mesh_of(row.gzip) for row in self._database.rows(query)), None)

    def documents(self, mesh_ids: Iterable[str]) -> dict[str, MeshDocument]:
        """Return those meshes of some ids that there are, as JSON data, by id."""
        query = sa.select(MESHES.c.id, MESHES.c.gzip).where(MESHES.c.id.in_(sorted(mesh_ids)))
        return {row.id: json.loads(gzip.decompress(row.gzip)) for row in self._database.rows(query)}


@lru_cache(maxsize=16)
def _mesh_of(content: bytes) -> SolidMesh:
    """Return a stored mesh: one and the same for tasks that name it one after the other, which find its parts once."""
    return SolidMesh.from_document(json.loads(gzip.decompress(content)))
