"""Memory that perception takes: so much for each point and pixel, and no more."""

from __future__ import annotations

import io
import tracemalloc
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from planners.cell.cell import load_cell
from planners.contract.scan_spec import read_scan
from planners.perception.camera import Camera
from planners.perception.perceive import MOST_DEPTH_PIXELS, perceive
from planners.perception.preview import HEIGHT, WIDEST, draw_preview
from planners.perception.scan_files import MOST_PIXELS, MOST_POINTS, ScanRefused
from tests.benchmarks.bench_perception_bounds import CASES

SHARE = 0.02
"""Of the largest scans: small enough that nothing of them is thinned out."""
BYTES = 260.0
"""For each point or pixel [bytes]; benchmarks measure the largest scans."""
COUNTS = {"depth image": MOST_DEPTH_PIXELS, "picture of noise": MOST_PIXELS}
"""Points or pixels of the largest scans [1]; of clouds `MOST_POINTS`."""


def perceived(scan: tuple[dict[str, Any], dict[str, bytes]]) -> str:
    description, files = scan
    try:
        return f"{len(perceive(read_scan(description), files, load_cell('dual_ur3e_tool')).document.objects)} objects"
    except ScanRefused as refused:
        return str(refused)


def memory_while(work: Callable[[], object]) -> int:
    """Return how many bytes are taken at most while something is done."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def memory_of(name: str, share: float) -> int:
    """Return how many bytes are taken at most while a scan is perceived."""
    scan = CASES[name](share)
    return memory_while(lambda: perceived(scan))


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def png(array: np.ndarray) -> bytes:
    return cv2.imencode(".png", array)[1].tobytes()


@pytest.mark.parametrize("name", [name for name in CASES if name != "50 million points"])
def test_a_point_or_pixel_takes_no_more_memory_than_it_may(name: str) -> None:
    assert memory_of(name, SHARE) < BYTES * SHARE * COUNTS.get(name, MOST_POINTS)


def test_a_scan_that_says_it_is_far_too_large_costs_nothing() -> None:
    assert "50,000,000 points" in perceived(CASES["50 million points"](1.0))
    assert memory_of("50 million points", 1.0) < 20e6


@pytest.mark.parametrize("name", ["depth image", "heap of points", "organised cloud", "cloud as text"])
def test_scans_of_every_kind_show_the_same_objects(name: str) -> None:
    assert perceived(CASES[name](SHARE)) == "3 objects"


INTRINSICS = {"fx": 938.0, "fy": 938.0, "cx": 639.5, "cy": 359.5}
ABOVE = {"intrinsics": INTRINSICS, "pose": [0.3, 0, 1.7, 0, 1, 0, 0]}
LONG = {
    "a picture": ({"colour": ABOVE}, lambda: {"colour": png(np.zeros((100, 60_000, 3), np.uint8))}),
    "a longer picture": ({"colour": ABOVE}, lambda: {"colour": png(np.zeros((40, 100_000, 3), np.uint8))}),
    "a high picture": ({"colour": ABOVE}, lambda: {"colour": png(np.zeros((60_000, 100, 3), np.uint8))}),
    "a depth image": ({"depth": ABOVE}, lambda: {"depth": png(np.full((100, 60_000), 600, np.uint16))}),
    "a depth array": ({"depth": ABOVE}, lambda: {"depth": npy(np.full((20, 150_000), 600, np.uint16))}),
}  # fmt: skip


@pytest.mark.parametrize("name", LONG)
def test_an_image_far_longer_than_wide_is_refused_and_costs_nothing(name: str) -> None:
    """Drawn as high as the preview, such pictures of 18 kB were as wide as 1.3 billion pixels are many."""
    description, files = LONG[name]
    scan = ({"tool": None, **description}, files())
    assert "at most 8 times the shorter" in perceived(scan)
    assert memory_while(lambda: perceived(scan)) < 20e6


@pytest.mark.parametrize("points", [(16, 100_000), (100_000, 16), (1_600_000,)])
@pytest.mark.slow
def test_the_preview_of_a_cloud_is_bounded_whatever_its_sides_and_its_extent(points: tuple[int, ...]) -> None:
    """A strip of the table, seen as one long line; its points are said to have rows and columns, or none."""
    rng = np.random.default_rng(0)
    count = int(np.prod(points))
    x, y = rng.uniform(-2.4, 2.4, count), rng.uniform(-1e-3, 1e-3, count)
    strip = np.stack([x, y, np.full(count, 0.606)], axis=-1).astype("<f4").reshape(*points, 3)
    description = {"tool": None, "cloud": {"pose": ABOVE["pose"]}}
    scan = perceive(read_scan(description), {"cloud": npy(strip)}, load_cell("dual_ur3e_tool"))
    image = cv2.imdecode(np.frombuffer(scan.preview, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape[0] == HEIGHT
    assert image.shape[1] <= WIDEST


@pytest.mark.parametrize("sides", [(100, 60_000), (16, 10_000), (720, 1280), (60_000, 100)])
def test_drawing_a_picture_takes_memory_as_it_has_pixels_whatever_its_sides(sides: tuple[int, int]) -> None:
    picture = np.full((*sides, 3), 255, np.uint8)
    camera = Camera(938.0, 938.0, 639.5, 359.5, np.eye(4))
    drawn: list[bytes] = []
    taken = memory_while(lambda: drawn.append(draw_preview(picture, camera, None, None, None)))
    assert taken < 2 * picture.size + 8 * 3 * HEIGHT * WIDEST
    image = cv2.imdecode(np.frombuffer(drawn[0], np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    height, width = image.shape[:2]
    assert (height, width <= WIDEST) == (HEIGHT, True)
    shown = np.argwhere(image.max(axis=2) > 128)
    rows, columns = shown.max(axis=0) - shown.min(axis=0) + 1
    scale = max(rows, columns) / max(sides)
    assert (rows, columns) == pytest.approx(scale * np.array(sides), abs=1.0), "nothing is stretched"
