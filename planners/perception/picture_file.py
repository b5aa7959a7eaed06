"""From the bytes of PNG and JPEG files to pictures and depth images; their sizes are looked at before they are read."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array
from planners.perception.refusal import ScanRefused

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


def read_colour(content: bytes, part: str = "colour") -> NDArray[np.uint8]:
    """Return (h, w, 3) blue, green, red of a PNG or JPEG file.

    Raises:
        ScanRefused: It is no such file, is too large, or far longer than wide.
    """
    _check_size(content, MOST_PIXELS, part)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise ScanRefused(part, "the picture is damaged: it cannot be decoded")
    return image.astype(np.uint8, copy=False)


def read_depth_png(content: bytes, unit: float, most_pixels: int, part: str = "depth") -> Array:
    """Return the (h, w) depths of a 16-bit PNG file, NaN where it is 0 [m].

    Args:
        content: of the file.
        unit: of its numbers [m].
        most_pixels: that are read [1].
        part: what the file is called.

    Raises:
        ScanRefused: It is no such file, is too large, or far longer than wide.
    """
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
