"""Files of pictures and points: what was written is read, what lies is refused before it is believed."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from planners.perception.scan_files import (
    LARGEST_ASPECT,
    LONGEST_SIDE,
    MOST_PIXELS,
    MOST_POINTS,
    ScanRefused,
    read_cloud,
    read_colour,
    read_depth_png,
    read_npy,
)

POINTS = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3)).astype(np.float32)


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


def npy_of_shape(shape: str) -> bytes:
    """Return an NPY file of 12 bytes that says it has a shape."""
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(12)


def pcd(points: np.ndarray, form: str, width: int | None = None, height: int = 1) -> bytes:
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"
        f"WIDTH {len(points) if width is None else width}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA {form}\n"
    ).encode()
    if form == "ascii":
        return head + "\n".join(f"{x} {y} {z} 7" for x, y, z in points.tolist()).encode()
    rows = np.zeros(len(points), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
    for i, name in enumerate("xyz"):
        rows[name] = points[:, i]
    return head + rows.tobytes()


def ply(points: np.ndarray, encoding: str) -> bytes:
    content = trimesh.PointCloud(points).export(file_type="ply", encoding=encoding)
    assert isinstance(content, bytes)
    return content


@pytest.mark.parametrize(
    "content",
    [npy(POINTS), ply(POINTS, "binary"), ply(POINTS, "ascii"), pcd(POINTS, "binary"), pcd(POINTS, "ascii")],
    ids=["npy", "ply", "ply ascii", "pcd", "pcd ascii"],
)
def test_the_points_of_a_file_are_those_that_were_written(content: bytes) -> None:
    np.testing.assert_allclose(read_cloud(content, 1.0), POINTS, atol=1e-6)
    np.testing.assert_allclose(read_cloud(content, 0.001), 0.001 * POINTS, atol=1e-9)


def test_an_organised_cloud_keeps_its_rows() -> None:
    np.testing.assert_allclose(read_cloud(pcd(POINTS, "binary", 10, 5), 1.0), POINTS.reshape(5, 10, 3))
    np.testing.assert_allclose(read_cloud(npy(POINTS.reshape(5, 10, 3)), 1.0), POINTS.reshape(5, 10, 3))


def test_what_is_not_finite_becomes_not_measured() -> None:
    wild = np.array([[np.inf, 0.0, 1.0], [1e300, 0.0, 1e308], [0.0, np.nan, 1.0]])
    read = read_cloud(npy(wild), 1.0)
    assert not np.isinf(read).any()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (npy(np.array([{}, {}], dtype=object)), "real numbers"),
        (npy(np.zeros((5, 4))), "shape"),
        (npy(POINTS)[:-1], "cut short"),
        (b"\x93NUMPY\x01\x00\xff\xff" + b" " * 300, "header"),
        (ply(POINTS, "binary")[:-1], "cut short"),
        (ply(POINTS, "ascii")[:-600], "cut short"),
        (ply(POINTS, "ascii").replace(b".", b"x"), "PLY|numbers"),
        (pcd(POINTS, "binary", MOST_POINTS + 1), "at most"),
        (pcd(POINTS, "binary", 10**11), "at most"),
        (pcd(POINTS[:0], "binary", 0, 10**11), "at most"),
        (pcd(POINTS[:0], "ascii", 10**11, 0), "at most"),
        (pcd(POINTS, "binary_compressed"), "save them as binary"),
        (pcd(POINTS, "binary").replace(b"FIELDS x y z", b"FIELDS x y y"), "x, y and z"),
        (b"ply\n" + b"comment x\n" * 5000, "does not end"),
        (b"", "neither"),
    ],
)
def test_a_cloud_that_is_no_cloud_is_refused(content: bytes, said: str) -> None:
    with pytest.raises(ScanRefused, match=said):
        read_cloud(content, 1.0)


@pytest.mark.parametrize(
    "shape",
    [
        "(-1, -1, 3)", "(-5, 3)", "(-4, -2, 3)", "(True, 3)", "(False, 3)", f"({'9' * 400}, 3)", f"(0, {'9' * 400}, 3)",
        f"({'1, ' * 99})", f"({'9' * 5000}, 3)", "(1.0, 3)", "(1, '3')", "3", "-" * 9000 + "1", "(" * 300 + ")" * 300,
        "[" * 5000,
    ],
)  # fmt: skip
def test_a_shape_that_is_none_is_refused(shape: str) -> None:
    with pytest.raises(ScanRefused):
        read_npy(npy_of_shape(shape), "cloud")


@pytest.mark.parametrize("shape", ["(1, 3)", "(3,)", "(1, 1, 3)", "(3, 1)"])
def test_an_array_has_as_many_numbers_as_its_shape_says(shape: str) -> None:
    assert read_npy(npy_of_shape(shape), "depth").size == 3


def test_an_array_of_fewer_than_no_rows_is_not_read_past_the_most_points() -> None:
    many = npy_of_shape("(-1, 3)") + bytes(12 * MOST_POINTS)
    with pytest.raises(ScanRefused):
        read_npy(many, "cloud")


def test_a_depth_image_is_read_in_its_unit_and_zeros_are_no_measurements() -> None:
    numbers = np.random.default_rng(0).integers(0, 3, (20, 30)).astype(np.uint16) * 500
    read = read_depth_png(cv2.imencode(".png", numbers)[1].tobytes(), 0.001, MOST_PIXELS)
    np.testing.assert_array_equal(np.isnan(read), numbers == 0)
    np.testing.assert_allclose(np.nan_to_num(read), 0.001 * numbers)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_picture_is_read_and_a_damaged_one_refused(suffix: str) -> None:
    image = np.full((20, 30, 3), 100, np.uint8)
    content = cv2.imencode(suffix, image)[1].tobytes()
    assert read_colour(content).shape == (20, 30, 3)
    with pytest.raises(ScanRefused):
        read_colour(content[:30])


def png_that_says(width: int, height: int, bits: int = 8, colour: int = 2) -> bytes:
    """Return the header of a PNG, without a picture."""
    chunk = b"IHDR" + struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))


def jpeg_that_says(width: int, height: int) -> bytes:
    return b"\xff\xd8\xff\xc0" + struct.pack(">HBHHB", 8, 8, height, width, 0) + bytes(9)


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The lengths of all pictures that are decoded."""
    lengths: list[int] = []
    decode = cv2.imdecode
    monkeypatch.setattr(cv2, "imdecode", lambda data, flags: lengths.append(len(data)) or decode(data, flags))
    return lengths


@pytest.mark.parametrize("says", [png_that_says, jpeg_that_says])
@pytest.mark.parametrize(
    ("width", "height"),
    [(60_000, 60_000), (60_000, 100), (100, 60_000), (LONGEST_SIDE + 1, 2000), (801, 100), (100, 801), (15, 15)],
)
def test_a_picture_of_unheard_of_sides_is_refused_before_it_is_decoded(
    decoded: list[int], says: Any, width: int, height: int
) -> None:
    with pytest.raises(ScanRefused, match=f"{width} x {height} pixels.* 16 to .* at most {LARGEST_ASPECT} times"):
        read_colour(says(width, height))
    with pytest.raises(ScanRefused, match=f"{width} x {height} pixels"):
        read_depth_png(says(width, height), 0.001, MOST_PIXELS)
    assert decoded == []


@pytest.mark.parametrize(("bits", "colour"), [(8, 0), (8, 2), (16, 2), (16, 4), (16, 6)])
def test_a_picture_that_is_no_depth_image_is_refused_before_it_is_decoded(
    decoded: list[int], bits: int, colour: int
) -> None:
    for content in (png_that_says(64, 64, bits, colour), jpeg()):
        with pytest.raises(ScanRefused, match="16 bits with one channel"):
            read_depth_png(content, 0.001, MOST_PIXELS)
    assert decoded == []


def test_a_depth_image_of_more_pixels_than_are_read_is_refused_before_it_is_decoded(decoded: list[int]) -> None:
    with pytest.raises(ScanRefused, match="at most 8,000,000 pixels"):
        read_depth_png(png_that_says(4000, 2001, 16, 0), 0.001, 8_000_000)
    assert decoded == []


def jpeg() -> bytes:
    image = np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()


@pytest.mark.parametrize(
    "before",
    [b"\xff\xd0", b"\xff\x01", b"\xff\xd8", b"\xff\xe0\0\0", b"\xff\xe0\0\1", b"\xff" * 1_000_000],
    ids=["restart", "alone", "begin", "no length", "too little length", "fill"],
)
def test_what_hides_a_frame_from_its_reader_is_refused(before: bytes) -> None:
    whole = jpeg()
    small = b"\xff\xc0" + struct.pack(">HBHHB", 8, 8, 32, 32, 0)
    # Who takes the marker for one with a length steps over the first frame to the second.
    hidden = struct.pack(">H", len(whole)) + whole[2:] + small
    with pytest.raises(ScanRefused, match="neither"):
        read_colour(whole[:2] + before + hidden)


def test_a_picture_of_very_many_scans_is_refused_and_one_of_some_is_read(decoded: list[int]) -> None:
    whole = jpeg()
    assert read_colour(whole).shape == (64, 64, 3)
    last = whole[whole.rindex(b"\xff\xda") : -2]
    decoded.clear()
    with pytest.raises(ScanRefused, match="scans"):
        read_colour(whole[:-2] + last * 200 + whole[-2:])
    assert decoded == []


def test_an_array_that_is_too_large_is_refused_by_its_header() -> None:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"shape": (50_000_000, 3), "fortran_order": False, "descr": "<f4"})
    with pytest.raises(ScanRefused, match="50,000,000 points"):
        read_npy(stream.getvalue(), "cloud")
