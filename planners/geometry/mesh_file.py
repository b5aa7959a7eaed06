"""From the bytes of an STL, PLY, OBJ or GLB file to triangles; nothing that a file refers to is opened."""

from __future__ import annotations

import io
import json
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import trimesh

from planners.errors import LiftwrightError
from planners.geometry.pose import Array
from planners.geometry.surface import Faces

MeshFormat = Literal["stl", "ply", "obj", "glb"]
MOST_TRIANGLES = 20_000
"""In a file; more than that make a plan document unwieldy and say nothing about grasping."""
MOST_VERTICES = 3 * MOST_TRIANGLES
MOST_NODES = 1000
"""Of a GLB's scene."""


class MeshRefused(LiftwrightError):
    """A mesh cannot be used; the message says why, and what to do about it."""


@dataclass(frozen=True)
class _Counts:
    """How much a file says it holds."""

    triangles: int
    vertices: int


def read_mesh_file(content: bytes, file_format: MeshFormat) -> tuple[Array, Faces]:
    """Return vertices (n, 3) and triangles (m, 3) of everything in a file, in its own unit.

    Args:
        content: of the file.
        file_format: what it is.

    Raises:
        MeshRefused: It is not such a file, is too large, or refers to other files.
    """
    counts = _COUNTERS[file_format](content)
    _check_counts(counts)
    # A file that is cut short or lies fails anywhere in the parser, and in many ways.
    try:
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=file_format, resolver={}, process=False, skip_materials=True
        )
        mesh = scene.to_mesh()
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, struct.error, OSError, LookupError) as error:
        raise MeshRefused(f"the file cannot be read as {file_format.upper()}: {error}") from error
    vertices, faces = np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64)
    if len(faces) == 0:
        raise MeshRefused("the file holds no triangles")
    _check_counts(_Counts(len(faces), len(vertices)))
    return vertices, faces


def _check_counts(counts: _Counts) -> None:
    if counts.triangles > MOST_TRIANGLES:
        raise MeshRefused(f"the mesh has {counts.triangles} triangles, at most {MOST_TRIANGLES} are taken: simplify it")
    if counts.vertices > MOST_VERTICES:
        raise MeshRefused(f"the mesh has {counts.vertices} vertices, at most {MOST_VERTICES} are taken: simplify it")


def _count_stl(content: bytes) -> _Counts:
    if len(content) >= 84:
        (triangles,) = struct.unpack_from("<I", content, 80)
        if len(content) == 84 + 50 * triangles:
            return _Counts(triangles, 3 * triangles)
    if not content.lstrip().startswith(b"solid"):
        raise MeshRefused("the file is no STL file: its length is not that of the triangles it announces")
    triangles = len(re.findall(rb"\bendfacet\b", content, re.IGNORECASE))
    return _Counts(triangles, 3 * triangles)


def _count_ply(content: bytes) -> _Counts:
    header, end, _ = content[:65536].partition(b"end_header")
    if not content.startswith(b"ply") or not end:
        raise MeshRefused("the file is no PLY file: it has no header")
    elements = dict(re.findall(rb"^element\s+(\w+)\s+(\d{1,12})\s*$", header, re.MULTILINE))
    for name, count in elements.items():
        if int(count) > MOST_VERTICES:
            raise MeshRefused(f"the file announces {int(count)} elements {name.decode()}: simplify the mesh")
    return _Counts(int(elements.get(b"face", 0)), int(elements.get(b"vertex", 0)))


def _count_obj(content: bytes) -> _Counts:
    faces = re.findall(rb"^\s*f\s+(.*)$", content, re.MULTILINE)
    triangles = sum(max(0, len(face.split()) - 2) for face in faces)
    return _Counts(triangles, len(re.findall(rb"^\s*v\s", content, re.MULTILINE)))


def _count_glb(content: bytes) -> _Counts:
    """Add up the accessors of every node: one mesh may be in a scene many times."""
    tree = _glb_tree(content)
    accessors, meshes, nodes = (_list_of(tree, name) for name in ("accessors", "meshes", "nodes"))
    if any("uri" in entry for name in ("buffers", "images") for entry in _list_of(tree, name)):
        raise MeshRefused("the file refers to other files; put everything into the GLB itself")
    if any("bufferView" not in accessor or "sparse" in accessor for accessor in accessors):
        raise MeshRefused("the file holds accessors without data or sparse ones, which are not taken")
    if len(nodes) > MOST_NODES:
        raise MeshRefused(f"the file has {len(nodes)} nodes, at most {MOST_NODES} are taken")
    if tree.get("extensionsRequired"):
        raise MeshRefused(f"the file needs extensions that are not read: {tree['extensionsRequired']}")
    try:
        children = [child for node in nodes for child in node.get("children", ())]
        meshes = [[_primitive(part, accessors) for part in mesh["primitives"]] for mesh in meshes]
        placed = [part for node in nodes if "mesh" in node for part in meshes[node["mesh"]]]
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise MeshRefused(f"the GLB file contradicts itself: {error!r}") from error
    if len(set(children)) != len(children):
        raise MeshRefused("a node of the file's scene has several parents")
    held = [part for mesh in meshes for part in mesh]
    return _Counts(
        max(sum(part.triangles for part in parts) for parts in (held, placed)),
        max(sum(part.vertices for part in parts) for parts in (held, placed)),
    )


def _primitive(primitive: Mapping[str, Any], accessors: list[Any]) -> _Counts:
    vertices = int(accessors[primitive["attributes"]["POSITION"]]["count"])
    corners = int(accessors[primitive["indices"]]["count"]) if "indices" in primitive else vertices
    # A strip or fan (modes 5 and 6) has a triangle for every corner.
    return _Counts(corners // 3 if primitive.get("mode", 4) == 4 else corners, vertices)


def _glb_tree(content: bytes) -> Mapping[str, Any]:
    try:
        magic, version, _, length, kind = struct.unpack_from("<4sIII4s", content)
        tree = json.loads(content[20 : 20 + length]) if (magic, version, kind) == (b"glTF", 2, b"JSON") else None
    except (struct.error, ValueError, RecursionError) as error:
        raise MeshRefused(f"the file is no GLB file: {error}") from error
    if not isinstance(tree, dict):
        raise MeshRefused("the file is no GLB file of version 2")
    return tree


def _list_of(tree: Mapping[str, Any], name: str) -> list[Any]:
    entries = tree.get(name, [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise MeshRefused(f"the GLB file's {name} are no list of objects")
    return entries


_COUNTERS: Mapping[MeshFormat, Callable[[bytes], _Counts]] = MappingProxyType(
    {"stl": _count_stl, "ply": _count_ply, "obj": _count_obj, "glb": _count_glb}
)
