"""Meshes light enough for a browser: read with their materials, thinned out, written as binary glTF.

Vertices that share a cell of a grid become one, at the point that fits the planes of the faces around them best
(Lindstrom, "Out-of-core simplification of large polygonal models", 2000). An arm of 10 MB comes out at
0.77 MB, and at 0.99 MB with a gripper on it.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.gltf import export_glb
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

from planners.cell.asset_files import MeshFile
from planners.cell.asset_shelf import AssetShelf
from planners.errors import AssetError
from planners.geometry.pose import Array, Transform
from planners.geometry.surface import Faces, hull_with_faces
from workers.kept_files import KeptFiles

NEAR_REACH = 0.5
"""Of the arm that the settings of links are made for [m]."""
Colour = tuple[float, float, float]
_CREASE = np.radians(45.0)
GREY: Colour = (0.32, 0.34, 0.37)
"""Of parts without a material."""


@dataclass(frozen=True)
class ThinningSettings:
    """How coarse the drawing is."""

    cell: float = 4.2e-3
    """Edge of a grid cell [m]: smaller details are lost. Of a link: of an arm that reaches `NEAR_REACH`, and in
    proportion of a longer one, which is looked at from farther away."""
    crease: float = 35.0
    """Faces that meet at a larger angle have a sharp edge between them [deg]."""


@dataclass(frozen=True, eq=False)
class Piece:
    """The faces of one material."""

    vertices: Array
    """(n, 3) [m]"""
    faces: Faces
    """(m, 3), counter-clockwise from outside."""
    colour: Colour
    """Linear, 0 to 1."""


@dataclass(frozen=True)
class Detail:
    """How much a scene asks of the machine that draws it."""

    links: ThinningSettings
    hands: ThinningSettings
    shadows: bool
    """Shadows, and light that mirrors surroundings."""


FULL = Detail(ThinningSettings(), ThinningSettings(cell=1.7e-3), shadows=True)
LIGHT = Detail(ThinningSettings(cell=11e-3, crease=50.0), ThinningSettings(cell=5e-3, crease=50.0), shadows=False)
"""For machines without a graphics card: an eighth of the triangles."""


MOST_READ = 100_000_000
"""So much is kept in memory, of what was drawn last [bytes]: everyone may bring cells of their own."""
MOST_KEPT = 400_000_000
"""So much is kept in the folder, likewise [bytes]. A cell that is shipped takes some 10 MB."""


class LinkMeshes:
    """Drawings of meshes, kept in a folder so that each is made once, and in memory for the next watcher."""

    def __init__(self, folder: Path) -> None:
        self._kept = KeptFiles(folder, ".glb", MOST_KEPT)
        self._read = OrderedDict[str, bytes]()
        """The one that was asked for last is the last."""
        # Two watchers of one cell ask for the same drawing at the same time, and either takes seconds.
        self._drawing, self._reading = threading.Lock(), threading.Lock()

    def glb(self, mesh: MeshFile, shelf: AssetShelf, T_frame_mesh: Transform, settings: ThinningSettings) -> bytes:
        """Return a mesh as binary glTF, in the frame that it moves with.

        Args:
            mesh: what collides; what is drawn is its twin in the folder "visual", where the package has one.
            shelf: where it is looked for.
            T_frame_mesh: where the mesh is in that frame.
            settings: how coarse the drawing is.

        Raises:
            AssetError: There is no such mesh.
        """
        path = visual_path(mesh, shelf)
        asked = repr((path, settings, mesh.scale, T_frame_mesh.round(9).tolist()))
        drawn = self._read_before(asked)
        if drawn is None:
            with self._drawing:
                drawn = self._read_before(asked) or self._drawn(path, mesh, T_frame_mesh, settings)
                self._remember(asked, drawn)
        return drawn

    def _read_before(self, asked: str) -> bytes | None:
        with self._reading:
            if asked in self._read:
                self._read.move_to_end(asked)
            return self._read.get(asked)

    def _remember(self, asked: str, drawn: bytes) -> None:
        with self._reading:
            self._read[asked] = drawn
            size = sum(map(len, self._read.values()))
            while size > MOST_READ and len(self._read) > 1:
                _, oldest = self._read.popitem(last=False)
                size -= len(oldest)

    def _drawn(self, path: Path, mesh: MeshFile, T_frame_mesh: Transform, settings: ThinningSettings) -> bytes:
        key = hashlib.sha256(path.read_bytes())
        key.update(repr((settings, mesh.scale, T_frame_mesh.round(9).tolist())).encode())
        name = key.hexdigest()[:32]
        drawn = self._kept.read(name)
        if drawn is None:
            drawn = _write_glb(path, mesh.scale, T_frame_mesh, settings)
            self._kept.keep(name, drawn)
        return drawn


def visual_path(mesh: MeshFile, shelf: AssetShelf) -> Path:
    """Return the drawing that belongs to a collision mesh, or the collision mesh if there is no drawing."""
    try:
        return shelf.mesh_path(mesh.model_copy(update={"path": mesh.path.replace("/collision/", "/visual/")}))
    except AssetError:
        return shelf.mesh_path(mesh)


def thin_out(vertices: Array, faces: Faces, cell: float) -> tuple[Array, Faces]:
    """Merge the vertices of each grid cell and drop the faces that vanish.

    Args:
        vertices: (n, 3) [m].
        faces: (m, 3).
        cell: edge of a grid cell [m].

    Returns:
        Vertices and faces; every vertex is within a cell's diagonal of those it stands for.
    """
    _, owner, count = np.unique(np.floor(vertices / cell), axis=0, return_inverse=True, return_counts=True)
    owner = owner.reshape(-1)
    merged = _best_points(vertices, faces, owner, len(count), cell)
    new_faces = owner[faces]
    distinct = (new_faces != np.roll(new_faces, 1, axis=1)).all(axis=1)
    new_faces = new_faces[distinct]
    _, first = np.unique(np.sort(new_faces, axis=1), axis=0, return_index=True)
    return merged, new_faces[np.sort(first)]


def _best_points(vertices: Array, faces: Faces, owner: Faces, n: int, cell: float) -> Array:
    """Minimise, per cell, the squared distances to the planes of its faces, weighted by their areas."""
    means = np.stack([np.bincount(owner, vertices[:, k], n) for k in range(3)], axis=1)
    means /= np.bincount(owner, minlength=n)[:, None]
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    A, b = np.zeros((n, 3, 3)), np.zeros((n, 3))
    for corner in range(3):
        cells = owner[faces[:, corner]]
        offset = np.einsum("ij,ij->i", normals, corners[:, corner] - means[cells])
        np.add.at(A, cells, normals[:, :, None] * normals[:, None, :])
        np.add.at(b, cells, normals * offset[:, None])
    # Flat and straight places leave directions open: there the point stays at the mean.
    weight = np.trace(A, axis1=1, axis2=2)[:, None, None] * 1e-2 + 1e-30
    shift = np.linalg.solve(A + weight * np.eye(3), b[:, :, None])[:, :, 0]
    return means + np.clip(shift, -0.5 * cell, 0.5 * cell)


def _write_glb(path: Path, scale: float, T_frame_mesh: Transform, settings: ThinningSettings) -> bytes:
    scene = trimesh.Scene()
    for index, piece in enumerate(_read_pieces(path)):
        vertices = (piece.vertices * scale) @ T_frame_mesh[:3, :3].T + T_frame_mesh[:3, 3]
        vertices, faces = thin_out(vertices, piece.faces, settings.cell)
        if not len(faces):
            continue
        vertices, faces, normals = _with_creases(vertices, faces, np.radians(settings.crease))
        # A metal without surroundings to mirror would come out black.
        material = PBRMaterial(
            name=f"material_{index}", baseColorFactor=[*piece.colour, 1.0], metallicFactor=0.0, roughnessFactor=0.55
        )
        drawn = trimesh.Trimesh(vertices, faces, vertex_normals=normals, process=False)
        drawn.visual = TextureVisuals(material=material)
        scene.add_geometry(drawn, geom_name=f"piece_{index}")
    return export_glb(scene, include_normals=True)


def write_cylinders(cylinders: Sequence[tuple[Sequence[float], Sequence[float], float]]) -> bytes:
    """Return cylinders as binary glTF, in grey: each the centres of its ends (3,) and its radius [m]."""
    return _write_grey(
        trimesh.creation.cylinder(radius, segment=np.array([start, end]), sections=48)
        for start, end, radius in cylinders
    )


def write_pieces(pieces: Sequence[Sequence[Sequence[float]]]) -> bytes:
    """Return convex pieces as binary glTF, in grey: each the corners (n, 3) of one [m]."""
    return _write_grey(trimesh.Trimesh(*hull_with_faces(np.array(corners))) for corners in pieces)


def _write_grey(solids: Iterable[trimesh.Trimesh]) -> bytes:
    scene = trimesh.Scene()
    material = PBRMaterial(baseColorFactor=[*GREY, 1.0], metallicFactor=0.0, roughnessFactor=0.55)
    for index, solid in enumerate(solids):
        vertices, faces, normals = _with_creases(np.asarray(solid.vertices), np.asarray(solid.faces), _CREASE)
        drawn = trimesh.Trimesh(vertices, faces, vertex_normals=normals, process=False)
        drawn.visual = TextureVisuals(material=material)
        scene.add_geometry(drawn, geom_name=f"solid_{index}")
    return export_glb(scene, include_normals=True)


def _with_creases(vertices: Array, faces: Faces, crease: float) -> tuple[Array, Faces, Array]:
    """Give each vertex one normal per smooth group of the faces around it."""
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = areas / np.maximum(np.linalg.norm(areas, axis=1), 1e-30)[:, None]
    around: list[list[int]] = [[] for _ in vertices]
    for index, face in enumerate(faces.tolist()):
        for vertex in face:
            around[vertex].append(index)
    cosine = np.cos(crease)
    points: list[Array] = []
    normals: list[Array] = []
    known: dict[tuple[int, int], int] = {}
    new_faces = np.empty_like(faces)
    for index, face in enumerate(faces.tolist()):
        for corner, vertex in enumerate(face):
            mates = np.array(around[vertex])
            smooth = mates[flat[mates] @ flat[index] >= cosine]
            normal = areas[smooth].sum(axis=0)
            length = np.linalg.norm(normal)
            normal = normal / length if length > 0.0 else flat[index]
            key = (vertex, int(np.dot(np.round(normal * 50.0).astype(int), (1, 1000, 1000000))))
            if key not in known:
                known[key] = len(points)
                points.append(vertices[vertex])
                normals.append(normal)
            new_faces[index, corner] = known[key]
    return np.array(points), new_faces, np.array(normals)


def _read_pieces(path: Path) -> Iterator[Piece]:
    """Read a mesh file; an OBJ material by material."""
    if path.suffix.lower() == ".obj":
        scene = trimesh.load_scene(path, process=False, split_objects=False, group_material=True)
    else:
        scene = trimesh.load_scene(path, process=False)
    for mesh in scene.geometry.values():
        # A corner has a vertex of its own for every normal and texture coordinate that it appears with.
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        material = getattr(mesh.visual, "material", None)
        diffuse = getattr(material, "diffuse", None)
        colour = GREY if diffuse is None else tuple(diffuse[:3] / 255.0)
        yield Piece(np.asarray(mesh.vertices), np.asarray(mesh.faces), colour)
