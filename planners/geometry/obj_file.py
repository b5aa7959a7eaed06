"""Triangles of OBJ files: of all that such a file can say, its vertices `v` and its faces `f`."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator

import numpy as np

from planners.geometry.pose import Array
from planners.geometry.surface import Faces

LONGEST_LINE = 100_000
"""[bytes]"""
# What follows a line's start is matched in one way only: the time is that of reading the file once.
_VERTEX_OR_FACE = re.compile(rb"^[ \t]*([vf])[ \t]+([^\n]*)", re.MULTILINE)


def count_obj(content: bytes) -> tuple[int, int]:
    """Return how many triangles and vertices a file has.

    Raises:
        ValueError: A line is too long.
    """
    triangles = vertices = 0
    for kind, rest in _lines(content):
        if kind == b"v":
            vertices += 1
        else:
            triangles += max(0, len(rest.split()) - 2)
    return triangles, vertices


def read_obj(content: bytes) -> tuple[Array, Faces]:
    """Return vertices (n, 3) and triangles (m, 3), in the file's own unit; a face of more corners is a fan of them.

    Raises:
        ValueError: A vertex or a face is not made of numbers, or there is no such vertex.
    """
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
