"""Stations spread evenly along the rim of a plate: where grips and pushes are generated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.geometry.polygon import centroid, inward_normals, side_directions, side_lengths
from planners.geometry.pose import Array

REFERENCE_RIM = 2.4
"""Length of rim at which a sampling takes its stated count, over what the arm reaches by its data sheet [1]: the 0.3 m
square of paper B, and its arms."""


@dataclass(frozen=True, eq=False)
class RimStation:
    """A place on the rim of an outline."""

    side: int
    point: Array
    """(2,) on the rim, in the outline's axes [m]."""
    along: Array
    """(2,) unit vector along the side, counter-clockwise."""
    inward: Array
    """(2,) unit normal of the side, into the outline."""


@dataclass(frozen=True)
class RimPatch:
    """The rectangle at a station that has to lie within the outline."""

    half_width: float
    """To either side along the rim [m]."""
    depth_from: float
    """From the rim inward [m]."""
    depth_to: float
    """[m]"""


def station_count(reference_count: int, rim: float, reach: float) -> int:
    """Return how many stations a rim gets: the largest even count within √rim of the reference.

    The spacing grows with the square root of the plate's size, and an even count lets the stations be symmetric about
    both axes of a plate. 30 grips and 16 push stations on paper B's 0.3 m square make 36 and 18 on its 0.4 by 0.5 m
    plate, which are the paper's counts (Table III). What an arm can do from one place to the next along a rim changes
    the less, the larger the arm is: a plate and an arm that are both twice as large have as many stations.

    Args:
        reference_count: stations on the rim of the paper's plate.
        rim: its length [m].
        reach: of the arm that comes to it, as its maker states it [m].
    """
    return 2 * math.floor(0.5 * reference_count * math.sqrt(rim / (REFERENCE_RIM * reach)) + 1e-9)


def rim_stations(outline: Array, reference_count: int, patch: RimPatch, reach: float) -> tuple[RimStation, ...]:
    """Spread stations evenly over the part of the rim where the patch lies within the outline.

    They are symmetric about the plate's x axis whenever the outline is, and about its y axis if it is about both.

    Args:
        outline: (n, 2) corners, counter-clockwise [m].
        reference_count: stations on the rim of the paper's plate.
        patch: that a finger presses on.
        reach: of the arm, as its maker states it [m].

    Returns:
        The stations, counter-clockwise from the first side; none where the patch fits nowhere.
    """
    usable = np.array([_usable(outline, side, patch) for side in range(len(outline))])
    ends = np.cumsum(usable[:, 1] - usable[:, 0])
    total = float(ends[-1])
    count = station_count(reference_count, float(np.sum(side_lengths(outline))), reach)
    if total <= 0.0 or count == 0:
        return ()
    starts = ends - (usable[:, 1] - usable[:, 0])
    return tuple(
        _station(outline, side, float(usable[side, 0] + (place - starts[side])))
        for place in _places(outline, usable, ends, count)
        for side in [min(int(np.searchsorted(ends, place, side="right")), len(outline) - 1)]
    )


def _places(outline: Array, usable: Array, ends: Array, count: int) -> Array:
    """Return sorted coordinates (count,) along the joined usable rim [m]: even, and symmetric about the plate's +x.

    Of an outline (k, 2) in the plate's axes, `usable` has the intervals (k, 2) on its sides [m], and `ends` (k,) where
    these end when they are joined [m].

    A station sits there or half a step beside: whichever keeps the stations farther from where the rim is interrupted.
    """
    total = float(ends[-1])
    anchor = _anchor(outline, usable, ends)
    at_anchor, beside_it = (
        np.sort((anchor + (np.arange(count) + offset) * total / count) % total).astype(np.float64)
        for offset in (0.0, 0.5)
    )
    interruptions = np.concatenate([[0.0], ends])
    return beside_it if _gap(beside_it, interruptions) > _gap(at_anchor, interruptions) + 1e-9 else at_anchor


def _gap(places: Array, others: Array) -> float:
    """Return the smallest distance between a place (n,) and one of the others (m,) along a line [m]."""
    return float(np.abs(places[:, None] - others[None, :]).min())


def _anchor(outline: Array, usable: Array, ends: Array) -> float:
    """Return where the rim's point in +x direction from the centroid is along the usable rim [m]; see `_places`."""
    centre = centroid(outline)
    normals = inward_normals(outline)
    depths = np.sum((centre - outline) * normals, axis=1)
    slopes = -normals[:, 0]
    with np.errstate(divide="ignore"):
        ways = np.where(slopes > 1e-12, depths / slopes, np.inf)
    side = int(np.argmin(ways))
    along = side_directions(outline)[side]
    place = float((centre - outline[side]) @ along + ways[side] * along[0])
    low, high = usable[side]
    return float(ends[side]) - (high - min(max(place, low), high))


def _usable(outline: Array, side: int, patch: RimPatch) -> tuple[float, float]:
    """Return the interval of places on a side [m from its first corner] at which the patch lies within the outline.

    The outline is convex, so each of its sides bounds the place of each corner of the patch from one end.
    """
    along, inward = side_directions(outline)[side], inward_normals(outline)[side]
    low, high = 0.0, float(side_lengths(outline)[side])
    for width in (-patch.half_width, patch.half_width):
        for depth in (patch.depth_from, patch.depth_to):
            corner = outline[side] + width * along + depth * inward
            for start, normal in zip(outline, inward_normals(outline), strict=True):
                slope, room = float(normal @ along), float(normal @ (corner - start))
                if slope > 1e-12:
                    low = max(low, -room / slope)
                elif slope < -1e-12:
                    high = min(high, -room / slope)
                elif room < -1e-12:
                    return 0.0, 0.0
    return (low, high) if low < high else (0.0, 0.0)


def _station(outline: Array, side: int, place: float) -> RimStation:
    """Return the station at a place on a side of an outline (k, 2) [m from its first corner, plate axes]."""
    along = side_directions(outline)[side]
    return RimStation(side, outline[side] + place * along, along, inward_normals(outline)[side])
