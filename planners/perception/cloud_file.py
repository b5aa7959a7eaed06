"""From the bytes of PLY, PCD and NPY files to points; how many they state is looked at before any are read."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array
from planners.perception.picture_file import NPY
from planners.perception.refusal import ScanRefused

MOST_POINTS = 4_000_000
"""In a file [1]."""
MOST_NUMBERS = 100 * MOST_POINTS
"""That a side of an array may be said to have [1]: few enough to be counted with."""
LONGEST_HEADER = 16_384
"""[bytes]"""
PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


def read_cloud(content: bytes, unit: float, part: str = "cloud") -> Array:
    """Return the points of a file: (n, 3), or (h, w, 3) where it is organised in rows [m].

    Args:
        content: of the file.
        unit: of its numbers [m].
        part: what the file is called.

    Raises:
        ScanRefused: It is no such file, is damaged, or holds too many points.
    """
    if content.startswith(NPY):
        points = read_npy(content, part)
        if points.ndim not in (2, 3) or points.shape[-1] != 3:
            raise ScanRefused(part, f"an NPY cloud has the shape (n, 3) or (rows, columns, 3), not {points.shape}")
    elif content.startswith(b"ply"):
        points = _read_ply(content, part)
    elif content[:LONGEST_HEADER].lstrip().startswith((b"# .PCD", b"VERSION", b"FIELDS")):
        points = _read_pcd(content, part)
    else:
        raise ScanRefused(part, "the file is neither PLY, PCD nor NPY")
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = unit * points.astype(float)
    return np.where(np.isfinite(scaled), scaled, np.nan)


def read_npy(content: bytes, part: str) -> NDArray[np.generic]:
    """Return the array of real numbers in an NPY file.

    Raises:
        ScanRefused: It is no such file, or too large.
    """
    stream = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(stream)
        reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = reader(stream, max_header_size=LONGEST_HEADER)
    # Python gives up with one of the last three on a header that is nested deeply.
    except (ValueError, SyntaxError, TypeError, EOFError, TokenError, RecursionError, MemoryError) as error:
        raise ScanRefused(part, "the NPY file's header cannot be read") from error
    if dtype.kind not in "fiu":
        raise ScanRefused(part, f"an NPY file holds real numbers, not {dtype}")
    if len(shape) > 3 or not all(type(side) is int and 0 <= side <= MOST_NUMBERS for side in shape):
        raise ScanRefused(part, f"the shape of an NPY array is up to three counts, not {str(shape)[:80]}")
    count = math.prod(shape)
    _check_count(count // 3 if shape and shape[-1] == 3 else count, part)
    data = _numbers(content, stream.tell(), dtype, count, part)
    return data.reshape(shape, order="F" if fortran else "C")


def _check_count(count: int, part: str) -> None:
    if count > MOST_POINTS:
        raise ScanRefused(part, f"the file holds {count:,} points; at most {MOST_POINTS:,} are read: thin it out")


def _numbers(content: bytes, start: int, dtype: np.dtype[np.generic], count: int, part: str) -> NDArray[np.generic]:
    if len(content) - start < count * dtype.itemsize:
        raise ScanRefused(part, "the file is cut short: it holds fewer points than it says")
    return np.frombuffer(content, dtype, count, start)


def _header(content: bytes, end: bytes, part: str) -> tuple[list[list[str]], int]:
    """Return the words of a header's lines, the last one the line that begins with `end`, and where the data begin."""
    at, lines = 0, []
    while at < min(len(content), LONGEST_HEADER):
        stop = content.find(b"\n", at, LONGEST_HEADER)
        if stop < 0:
            break
        line = content[at:stop].decode("latin-1").split()
        at = stop + 1
        if line:
            lines.append(line)
        if line and line[0].encode("latin-1", "replace") == end:
            return lines, at
    raise ScanRefused(part, "the file's header does not end")


def _read_ply(content: bytes, part: str) -> Array:
    lines, start = _header(content, b"end_header", part)
    form = next((line[1] for line in lines if line[0] == "format" and len(line) > 1), "")
    elements = [line for line in lines if line[0] == "element" and len(line) == 3]
    if not elements or elements[0][1] != "vertex":
        raise ScanRefused(part, "a PLY cloud begins with the element vertex")
    count = _whole(elements[0][2], part)
    _check_count(count, part)
    first = lines.index(elements[0])
    last = lines.index(elements[1]) if len(elements) > 1 else len(lines)
    properties = [line for line in lines[first + 1 : last] if line[0] == "property"]
    if any(len(line) != 3 or line[1] not in PLY_TYPES for line in properties):
        raise ScanRefused(part, "the properties of a PLY cloud's vertices are single numbers")
    names = [line[2] for line in properties]
    if form == "ascii":
        return _ascii(content, start, names, count, part)
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(form)
    if order is None:
        raise ScanRefused(part, f"the PLY format {form[:40]!r} is not known")
    types = [order + PLY_TYPES[line[1]] for line in properties]
    return _columns(content, start, names, types, count, part)


def _read_pcd(content: bytes, part: str) -> Array:
    lines, start = _header(content, b"DATA", part)
    members = {line[0]: line[1:] for line in lines}
    names, form = members.get("FIELDS", []), "".join(members["DATA"])
    counts = [_whole(each, part) for each in members.get("COUNT", ["1"] * len(names))]
    width, height = (_whole("".join(members.get(name, ["1"])), part) for name in ("WIDTH", "HEIGHT"))
    count = width * height
    # A side may be long although the other one is 0.
    _check_count(max(width, height, count), part)
    if any(each != 1 for each in counts):
        raise ScanRefused(part, "the fields of a PCD cloud are single numbers")
    if form == "ascii":
        points = _ascii(content, start, names, count, part)
    elif form == "binary":
        sizes, kinds = members.get("SIZE", []), members.get("TYPE", [])
        types = [f"<{kind.lower()}{size}" for kind, size in zip(kinds, sizes, strict=False)]
        if len(types) != len(names) or any(each[1:] not in PLY_TYPES.values() for each in types):
            raise ScanRefused(part, "the PCD header's SIZE and TYPE do not fit its FIELDS")
        points = _columns(content, start, names, types, count, part)
    else:
        raise ScanRefused(part, f"PCD data {form[:40]!r} are not read; save them as binary or ascii")
    return points.reshape(height, width, 3) if height > 1 else points


def _whole(text: str, part: str) -> int:
    if not text.isdecimal() or len(text) > 12:
        raise ScanRefused(part, f"the header's count {text[:40]!r} is no number")
    return int(text)


def _xyz(names: Sequence[str], part: str) -> list[int]:
    if not {"x", "y", "z"} <= set(names) or len(set(names)) != len(names):
        raise ScanRefused(part, "a cloud's points have x, y and z, each once")
    return [list(names).index(name) for name in "xyz"]


def _ascii(content: bytes, start: int, names: Sequence[str], count: int, part: str) -> Array:
    columns = _xyz(names, part)
    lines = content[start:].split(b"\n", count)[:count]
    if len(lines) < count:
        raise ScanRefused(part, "the file is cut short: it holds fewer points than it says")
    try:
        return np.loadtxt(lines, dtype=float, usecols=columns, ndmin=2, comments=None) if count else np.empty((0, 3))
    except (ValueError, IndexError) as error:
        raise ScanRefused(part, "a point of the file is not made of numbers") from error


def _columns(content: bytes, start: int, names: Sequence[str], types: Sequence[str], count: int, part: str) -> Array:
    _xyz(names, part)
    table: Any = _numbers(content, start, np.dtype(list(zip(names, types, strict=True))), count, part)
    return np.column_stack([np.asarray(table[name], dtype=float) for name in "xyz"])
