"""Triangles of STL files, binary and text: of both their corners only."""

from __future__ import annotations

import re
import struct

import numpy as np

from planners.geometry.pose import Array
from planners.geometry.surface import Faces

_BEGIN = 84
"""Of a binary file's triangles, behind its title and their number [bytes]."""
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# What follows a line's start is matched in one way only: the time is that of reading the file once.
_CORNER = re.compile(rb"^[ \t]*vertex[ \t]+([^\n]{0,200})", re.MULTILINE | re.IGNORECASE)


def count_stl(content: bytes) -> int:
    """Return how many triangles a file has.

    Raises:
        ValueError: It is neither as long as the triangles it announces, nor text.
    """
    if _is_binary(content):
        return (len(content) - _BEGIN) // _TRIANGLE.itemsize
    if not content[:1000].lstrip().lower().startswith(b"solid"):
        raise ValueError("its length is not that of the triangles it announces")
    return sum(1 for _ in _CORNER.finditer(content)) // 3


def read_stl(content: bytes) -> tuple[Array, Faces]:
    """Return vertices (3 m, 3) and triangles (m, 3), in the file's own unit; solids of a text are taken together.

    Raises:
        ValueError: A vertex of a text is not made of three numbers, or they are not three for every triangle.
    """
    if _is_binary(content):
        vertices = np.frombuffer(content, _TRIANGLE, offset=_BEGIN)["corners"].astype(float).reshape(-1, 3)
    else:
        corners = [[float(word) for word in line[1].split()[:3]] for line in _CORNER.finditer(content)]
        vertices = np.array(corners, dtype=float).reshape(-1, 3)
    return vertices, np.arange(len(vertices), dtype=np.int64).reshape(-1, 3)


def _is_binary(content: bytes) -> bool:
    if len(content) < _BEGIN:
        return False
    (triangles,) = struct.unpack_from("<I", content, 80)
    return len(content) == _BEGIN + _TRIANGLE.itemsize * triangles
