"""From the bytes of a scan's files to pictures, depths and points; what they state is looked at before any is read."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Sequence
from tokenize import TokenError
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from planners.errors import LiftwrightError
from planners.geometry.pose import Array


class ScanRefused(LiftwrightError):
    """Sensor data cannot be used; `part` names which: "description", "colour", "depth" or "cloud"."""

    def __init__(self, part: str, detail: str) -> None:
        self.part, self.detail = part, detail
        super().__init__(f"{part}: {detail}")


MOST_PIXELS = 25_000_000
"""Of a picture [1]."""
SHORTEST_SIDE, LONGEST_SIDE = 16, 10_000
"""Of a picture or depth image [px]."""
LARGEST_ASPECT = 8
"""The longer side over the shorter one, at most [1]: wider than any camera's, and what is drawn of it stays small."""
MOST_SEGMENTS = 2000
"""Of a JPEG before its frame [1]."""
MOST_SCANS = 100
"""Of a JPEG [1]: each goes over the whole picture, and may be a few bytes long. Cameras write one, or ten."""
PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"
NPY = b"\x93NUMPY"
GREY_OF_16_BITS = b"\x10\x00"
"""Bit depth and colour type in the header of such a PNG."""
NO_DEPTH = "a depth image is a PNG of 16 bits with one channel, or an NPY file"


def check_sides(width: int, height: int, most_pixels: int, part: str) -> None:
    """Look at the sides that a file's header states, before anything of that size is made.

    Args:
        width: columns [px].
        height: rows [px].
        most_pixels: of such an image [1].
        part: what the file is called.

    Raises:
        ScanRefused: They are too short, too long, too different, or too large together.
    """
    shorter, longer = sorted((width, height))
    fits = SHORTEST_SIDE <= shorter and longer <= LONGEST_SIDE
    if not fits or longer > LARGEST_ASPECT * shorter or width * height > most_pixels:
        raise ScanRefused(
            part,
            f"the image has {width} x {height} pixels; its sides are {SHORTEST_SIDE} to {LONGEST_SIDE:,} pixels long, "
            f"the longer one at most {LARGEST_ASPECT} times the shorter, and it has at most {most_pixels:,} pixels",
        )


def read_colour(content: bytes) -> NDArray[np.uint8]:
    """Return (h, w, 3) blue, green, red of a PNG or JPEG file.

    Raises:
        ScanRefused: It is no such file, is too large, or far longer than wide.
    """
    _check_size(content, MOST_PIXELS, "colour")
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise ScanRefused("colour", "the picture is damaged: it cannot be decoded")
    return image.astype(np.uint8, copy=False)


def read_depth_png(content: bytes, unit: float, most_pixels: int) -> Array:
    """Return the (h, w) depths of a 16-bit PNG file, NaN where it is 0 [m].

    Args:
        content: of the file.
        unit: of its numbers [m].
        most_pixels: that are read [1].

    Raises:
        ScanRefused: It is no such file, is too large, or far longer than wide.
    """
    part = "depth"
    _check_size(content, most_pixels, part)
    # Eight times as many bytes would be decoded of a coloured picture, to be refused then.
    if content.startswith(JPEG) or content[24:26] != GREY_OF_16_BITS:
        raise ScanRefused(part, NO_DEPTH)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ScanRefused(part, "the picture is damaged: it cannot be decoded")
    # A file may still name a colour that is transparent, which makes four channels of one.
    if image.dtype != np.uint16 or image.ndim != 2:
        raise ScanRefused(part, NO_DEPTH)
    return np.where(image > 0, unit * image.astype(float), np.nan)


def _check_size(content: bytes, most_pixels: int, part: str) -> None:
    size = _png_size(content) if content.startswith(PNG) else _jpeg_size(content) if content.startswith(JPEG) else None
    if size is None:
        raise ScanRefused(part, "the file is neither a PNG nor a JPEG picture, or is cut short")
    if content.startswith(JPEG) and content.count(b"\xff\xda") > MOST_SCANS:
        raise ScanRefused(part, f"the picture is refined more than {MOST_SCANS} times: save it with fewer scans")
    check_sides(*size, most_pixels, part)


def _png_size(content: bytes) -> tuple[int, int] | None:
    if len(content) < 26 or content[12:16] != b"IHDR":
        return None
    width, height = struct.unpack(">II", content[16:24])
    return width, height


def _jpeg_size(content: bytes) -> tuple[int, int] | None:
    """Walk over a JPEG's segments up to the one that begins a frame; None also for what decoders walk otherwise."""
    at = 2
    for _ in range(MOST_SEGMENTS):
        if at + 9 > len(content) or content[at] != 0xFF:
            return None
        marker = content[at + 1]
        if marker == 0xFF:
            at += 1
            continue
        length = struct.unpack(">H", content[at + 2 : at + 4])[0]
        # Markers that stand alone have no length and no business before a frame.
        if marker <= 0x01 or 0xD0 <= marker <= 0xD9 or length < 2:
            return None
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", content[at + 5 : at + 9])
            return width, height
        at += 2 + length
    return None


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


def read_cloud(content: bytes, unit: float) -> Array:
    """Return the points of a file: (n, 3), or (h, w, 3) where it is organised in rows [m].

    Args:
        content: of the file.
        unit: of its numbers [m].

    Raises:
        ScanRefused: It is no such file, is damaged, or holds too many points.
    """
    part = "cloud"
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
    """Return the array of real numbers in an NPY file, of up to three dimensions.

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
