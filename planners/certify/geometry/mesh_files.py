"""The meshes that are shipped for tasks, read here a second time: not as the planners read and repair them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planners.errors import AssetError
from planners.geometry.pose import Array


def load_meshes(folder: Path) -> dict[str, Array]:
    """Return the triangles of every OBJ file of a folder by the file's name: (m, 3, 3) corners, outward [m].

    Raises:
        AssetError: One cannot be read.
    """
    # Takes a third of a second to import, and is needed when there is a plan to certify.
    import trimesh

    found = {}
    for path in sorted(folder.glob("*.obj")):
        try:
            mesh = trimesh.load_mesh(path, process=False, maintain_order=True, skip_materials=True)
        except (OSError, ValueError) as error:
            raise AssetError(f"{path.name} cannot be read: {error}") from error
        found[path.stem] = np.array(mesh.vertices)[np.array(mesh.faces)]
    return found
