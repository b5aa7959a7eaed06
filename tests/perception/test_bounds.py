"""Memory that perception takes: so much for each point and pixel, and no more."""

from __future__ import annotations

import tracemalloc
from typing import Any

import pytest

from planners.contract.scan_spec import read_scan
from planners.perception.cloud_file import MOST_POINTS
from planners.perception.perceive import MOST_DEPTH_PIXELS, perceive
from planners.perception.picture_file import MOST_PIXELS
from planners.perception.refusal import ScanRefused
from planners.scene.cell import load_cell
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


def memory_of(name: str, share: float) -> int:
    """Return how many bytes are taken at most while a scan is perceived."""
    scan = CASES[name](share)
    tracemalloc.start()
    try:
        perceived(scan)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", [name for name in CASES if name != "50 million points"])
def test_a_point_or_pixel_takes_no_more_memory_than_it_may(name: str) -> None:
    assert memory_of(name, SHARE) < BYTES * SHARE * COUNTS.get(name, MOST_POINTS)


def test_a_scan_that_says_it_is_far_too_large_costs_nothing() -> None:
    assert "50,000,000 points" in perceived(CASES["50 million points"](1.0))
    assert memory_of("50 million points", 1.0) < 20e6


@pytest.mark.parametrize("name", ["depth image", "heap of points", "organised cloud", "cloud as text"])
def test_scans_of_every_kind_show_the_same_objects(name: str) -> None:
    assert perceived(CASES[name](SHARE)) == "3 objects"
