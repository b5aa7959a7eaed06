"""From the bytes of an STL, PLY, OBJ or GLB file to triangles; nothing that a file refers to is opened."""

from __future__ import annotations

import io
import itertools
import json
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from planners.errors import LiftwrightError
from planners.geometry.pose import Array
from planners.geometry.surface import Faces

MeshFormat = Literal["stl", "ply", "obj", "glb"]
MOST_TRIANGLES = 20_000
"""In a file; more than that make a plan document unwieldy and say nothing about grasping."""
MOST_VERTICES = 3 * MOST_TRIANGLES
MOST_NODES = 1000
"""Of a GLB's scene; so many parts of meshes may hang at them."""
MOST_ENTRIES = 20 * MOST_VERTICES
"""Of a GLB's accessors together: every vertex has a normal and the like, and all are read, needed or not."""
LONGEST_HEADER = {"ply": 16_384, "glb": 2_000_000}
"""What a file says of itself, of a GLB its JSON [bytes]."""
MOST_PROPERTIES = 100
"""Of a PLY's elements together."""
MOST_ROWS_BEHIND = 1000
"""Lines that a PLY of text may have behind those it announces: every one is parsed."""
LONGEST_LINE = 100_000
"""Of an OBJ [bytes]."""
_STL_BEGIN = 84
"""Of a binary STL's triangles, behind its title and their number [bytes]."""
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# What follows a line's start is matched in one way only: the time is that of reading the file once.
_VERTEX_OR_FACE = re.compile(rb"^[ \t]*([vf])[ \t]+([^\n]*)", re.MULTILINE)
_CORNER = re.compile(rb"^[ \t]*vertex[ \t]+([^\n]{0,200})", re.MULTILINE | re.IGNORECASE)


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
    try:
        counts = _COUNTERS[file_format](content)
        _check_counts(counts)
        vertices, faces = _READERS[file_format](content)
    # A file that is cut short or lies fails anywhere in the parser, and in many ways.
    except _BROKEN as error:
        raise MeshRefused(f"the file cannot be read as {file_format.upper()}: {error}") from error
    if len(faces) == 0:
        raise MeshRefused("the file holds no triangles")
    _check_counts(_Counts(len(faces), len(vertices)))
    return vertices, faces


def _check_counts(counts: _Counts) -> None:
    if counts.triangles > MOST_TRIANGLES:
        raise MeshRefused(f"the mesh has {counts.triangles} triangles, at most {MOST_TRIANGLES} are taken: simplify it")
    if counts.vertices > MOST_VERTICES:
        raise MeshRefused(f"the mesh has {counts.vertices} vertices, at most {MOST_VERTICES} are taken: simplify it")


def _count_ply(content: bytes) -> _Counts:
    """Add up what the header announces, word for word as the parser will read it."""
    elements: dict[str, int] = {}
    properties = 0
    header = _ply_header(content)
    for words in header:
        if b"element" in words[0]:
            _, name, count = words
            elements[name.decode()] = _whole(count)
        properties += b"property" in words[0]
    if properties > MOST_PROPERTIES:
        raise MeshRefused(f"the file's elements have {properties} properties, at most {MOST_PROPERTIES} are taken")
    for name, count in elements.items():
        if count > MOST_VERTICES:
            raise MeshRefused(f"the file announces {count} elements {name[:40]}: simplify the mesh")
    if b"ascii" in b" ".join(header[1]).lower() and _ply_rows(content) > sum(elements.values()) + MOST_ROWS_BEHIND:
        raise MeshRefused("the file goes on for many lines behind those that it announces")
    return _Counts(elements.get("face", 0), elements.get("vertex", 0))


def _ply_header(content: bytes) -> list[list[bytes]]:
    """Return the words of a PLY file's lines up to the one with which its header ends."""
    if not content.startswith(b"ply"):
        raise MeshRefused("the file is no PLY file: it has no header")
    lines = [line.split() for line in content[: LONGEST_HEADER["ply"]].split(b"\n")]
    end = next((number for number, words in enumerate(lines) if b"end_header" in words), None)
    if end is None:
        raise MeshRefused("the file is no PLY file: its header does not end")
    return lines[:end]


def _ply_rows(content: bytes) -> int:
    """Return how many lines a PLY file of text has behind its header, as its reader will divide it."""
    return len(content.partition(b"end_header")[2].decode("utf-8").splitlines())


def _whole(count: object) -> int:
    """Return a count of a header, which nothing can be taken away from."""
    if isinstance(count, bytes) and count.isdigit() and len(count) <= 12:
        return int(count)
    if type(count) is int and 0 <= count:
        return count
    raise ValueError(f"{str(count)[:40]!r} is no count")


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
        entries = sum(_whole(accessor["count"]) for accessor in accessors)
        viewed = sum(_whole(view["byteLength"]) for view in _list_of(tree, "bufferViews"))
        children = [child for node in nodes for child in node.get("children", ())]
        parts = [[_primitive(part, accessors) for part in mesh["primitives"]] for mesh in meshes]
        held = [part for mesh in parts for part in mesh]
        placed = [part for node in nodes if "mesh" in node for part in parts[node["mesh"]]]
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise MeshRefused(f"the GLB file contradicts itself: {error!r}") from error
    if len(set(children)) != len(children):
        raise MeshRefused("a node of the file's scene has several parents")
    if max(len(held), len(placed)) > MOST_NODES:
        raise MeshRefused(
            f"the file has {max(len(held), len(placed))} parts, at most {MOST_NODES} are taken: join them"
        )
    # Accessors and views that overlap would make much of a small file.
    if entries > MOST_ENTRIES or viewed > 2 * len(content):
        raise MeshRefused("the file says that it holds far more than it does, or than is needed for a mesh")
    return _Counts(
        max(sum(part.triangles for part in parts) for parts in (held, placed)),
        max(sum(part.vertices for part in parts) for parts in (held, placed)),
    )


def _primitive(primitive: Mapping[str, Any], accessors: list[Any]) -> _Counts:
    vertices = _whole(accessors[primitive["attributes"]["POSITION"]]["count"])
    corners = _whole(accessors[primitive["indices"]]["count"]) if "indices" in primitive else vertices
    # A strip or fan (modes 5 and 6) has a triangle for every corner.
    return _Counts(corners // 3 if primitive.get("mode", 4) == 4 else corners, vertices)


def _read_scene(content: bytes, file_format: MeshFormat) -> tuple[Array, Faces]:
    # Takes a third of a second to import, and is needed for files of these kinds alone.
    import trimesh

    scene = trimesh.load_scene(
        io.BytesIO(content), file_type=file_format, resolver={}, process=False, skip_materials=True
    )
    mesh = scene.to_mesh()
    return np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64)


def _glb_tree(content: bytes) -> Mapping[str, Any]:
    try:
        magic, version, _, length, kind = struct.unpack_from("<4sIII4s", content)
        if length > LONGEST_HEADER["glb"]:
            raise MeshRefused(f"the file has {length} bytes of JSON, at most {LONGEST_HEADER['glb']} are taken")
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


def _count_obj(content: bytes) -> _Counts:
    triangles = vertices = 0
    for kind, rest in _lines(content):
        if kind == b"v":
            vertices += 1
        else:
            triangles += max(0, len(rest.split()) - 2)
    return _Counts(triangles, vertices)


def obj_vertices(content: bytes) -> Array:
    """Return the vertices (n, 3) of an OBJ file, in its order and unit.

    Raises:
        ValueError: A vertex is not made of numbers, or a line is too long.
    """
    rows = [rest.split()[:3] for kind, rest in _lines(content) if kind == b"v"]
    return np.array(rows, dtype=float).reshape(-1, 3)


def _read_obj(content: bytes) -> tuple[Array, Faces]:
    """Return vertices and triangles; a face of more corners is a fan of them."""
    vertices: list[tuple[float, float, float]] = []
    triangles: list[tuple[int, int, int]] = []
    for kind, rest in _lines(content):
        if kind == b"v":
            x, y, z = rest.split()[:3]
            vertices.append((float(x), float(y), float(z)))
        else:
            corners = [_place(word, len(vertices)) for word in rest.split()]
            triangles += [(corners[0], b, c) for b, c in itertools.pairwise(corners[1:])]
    faces = np.array(triangles, dtype=np.int64).reshape(-1, 3)
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ValueError("a face names a vertex that there is not")
    return np.array(vertices, dtype=float).reshape(-1, 3), faces


def _lines(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the first word and the rest of every line of a vertex or a face; a backslash joins a line to the next."""
    joined = content.replace(b"\r\n", b"\n").replace(b"\\\n", b" ")
    for line in _VERTEX_OR_FACE.finditer(joined):
        if line.end() - line.start() > LONGEST_LINE:
            raise ValueError(f"a line is longer than {LONGEST_LINE} bytes")
        yield line[1], line[2].partition(b"#")[0]


def _place(word: bytes, so_far: int) -> int:
    """Return the place of the vertex of a corner like 7/1/2, or -1 for the last one there is so far."""
    number = int(word.partition(b"/")[0])
    return number - 1 if number > 0 else so_far + number if number < 0 else -1


def _count_stl(content: bytes) -> _Counts:
    if _is_binary(content):
        triangles = (len(content) - _STL_BEGIN) // _STL_TRIANGLE.itemsize
    elif content[:1000].lstrip().lower().startswith(b"solid"):
        triangles = sum(1 for _ in _CORNER.finditer(content)) // 3
    else:
        raise MeshRefused("the file is no STL file: its length is not that of the triangles it announces")
    return _Counts(triangles, 3 * triangles)


def _read_stl(content: bytes) -> tuple[Array, Faces]:
    """Return vertices, three for every triangle, and triangles; solids of a text are taken together."""
    if _is_binary(content):
        vertices = np.frombuffer(content, _STL_TRIANGLE, offset=_STL_BEGIN)["corners"].astype(float).reshape(-1, 3)
    else:
        corners = [[float(word) for word in line[1].split()[:3]] for line in _CORNER.finditer(content)]
        vertices = np.array(corners, dtype=float).reshape(-1, 3)
    return vertices, np.arange(len(vertices), dtype=np.int64).reshape(-1, 3)


def _is_binary(content: bytes) -> bool:
    if len(content) < _STL_BEGIN:
        return False
    (triangles,) = struct.unpack_from("<I", content, 80)
    return len(content) == _STL_BEGIN + _STL_TRIANGLE.itemsize * triangles


_BROKEN = (
    ValueError, KeyError, IndexError, TypeError, AttributeError, AssertionError, OverflowError, struct.error, OSError,
    LookupError,
)  # fmt: skip
_COUNTERS: Mapping[MeshFormat, Callable[[bytes], _Counts]] = MappingProxyType(
    {"stl": _count_stl, "ply": _count_ply, "obj": _count_obj, "glb": _count_glb}
)
_READERS: Mapping[MeshFormat, Callable[[bytes], tuple[Array, Faces]]] = MappingProxyType(
    {
        "stl": _read_stl,
        "obj": _read_obj,
        "ply": lambda content: _read_scene(content, "ply"),
        "glb": lambda content: _read_scene(content, "glb"),
    }
)
