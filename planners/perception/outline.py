"""Outlines of tops: a rectangle or a disc, whichever lies better on the top's edge."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planners.geometry import polygon
from planners.geometry.pose import Array
from planners.perception.perception_settings import PerceptionSettings
from planners.perception.top_facets import TopFacet

ROUNDS = 8
DISC_CORNERS = 48
FEWEST_EDGE_POINTS = 12


@dataclass(frozen=True, eq=False)
class Rectangle:
    """A rectangle in the table's frame."""

    center: Array
    """(2,) [m]"""
    yaw: float
    """Of its longer side, in (-pi/2, pi/2] [rad]."""
    size: tuple[float, float]
    """Longer and shorter side [m]."""
    residual: float
    """Root of the mean square of the edge's distances [m]."""
    fitting: float
    """Share of the seen edge that lies on it [1]."""
    sides_seen: float
    """Share of the side that is seen least [1]."""
    edge_std: tuple[float, float]
    """Uncertainties of where the edges are that bound the longer and the shorter extent [m]."""
    yaw_std: float
    """[rad]"""

    @property
    def axes(self) -> Array:
        """(2, 2) unit directions of the longer and the shorter side, as columns."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s], [s, c]])

    def corners(self, beyond: float = 0.0) -> Array:
        """Return the (4, 2) corners, counter-clockwise, moved out by `beyond` along both sides [m]."""
        x, y = (side + 2.0 * beyond for side in self.size)
        return polygon.rectangle(x, y) @ self.axes.T + self.center

    def beyond(self, points: Array) -> Array:
        """Return how far (n, 2) points lie outside, negative inside [m]."""
        return np.max(np.abs((points - self.center) @ self.axes) - 0.5 * np.array(self.size), axis=1)


@dataclass(frozen=True, eq=False)
class DiscOutline:
    """A disc in the table's frame."""

    center: Array
    """(2,) [m]"""
    radius: float
    """[m]"""
    residual: float
    """Root of the mean square of the edge's distances [m]."""
    fitting: float
    """Share of the seen edge that lies on it [1]."""
    sides_seen: float
    """Share of the quarter that is seen least [1]."""
    edge_std: float
    """Uncertainty of the radius [m]."""

    def corners(self, beyond: float = 0.0) -> Array:
        """Return (n, 2) points of the rim, counter-clockwise, moved out by `beyond` [m]."""
        return self.center + polygon.circle(self.radius + beyond, DISC_CORNERS)

    def beyond(self, points: Array) -> Array:
        """Return how far (n, 2) points lie outside, negative inside [m]."""
        return np.linalg.norm(points - self.center, axis=1) - self.radius


Outline = Rectangle | DiscOutline


def fit_outline(facet: TopFacet, settings: PerceptionSettings) -> Outline | None:
    """Return the rectangle or disc that lies best on a top's edge; None if too little of the edge is seen.

    Where something higher stands at the edge, it may stand on the top: that edge counts only where the rest does not
    suffice.
    """
    free = facet.edge[~facet.hidden & ~facet.beside]
    outline = _best(facet, free, settings)
    if facet.beside.any() and (outline is None or outline.sides_seen < settings.seen_side):
        return _best(facet, facet.edge[~facet.hidden], settings) or outline
    return outline


def _best(facet: TopFacet, seen: Array, settings: PerceptionSettings) -> Outline | None:
    if len(seen) < FEWEST_EDGE_POINTS:
        return None
    fits = [_fit_rectangle(facet, seen, settings), _fit_disc(facet, seen, settings)]
    known = [fit for fit in fits if fit is not None]
    return min(known, key=lambda fit: fit.residual, default=None)


def _fit_rectangle(facet: TopFacet, seen: Array, settings: PerceptionSettings) -> Rectangle | None:
    (cx, cy), (width, height), degrees = cv2.minAreaRect(facet.edge.astype(np.float32))
    center, yaw, size = np.array([cx, cy], dtype=float), math.radians(degrees), np.array([width, height], dtype=float)
    if float(size.min()) < settings.least_side:
        return None
    # The edge of noisy pixels is frayed; the box round all of it is too large and lies a little askew.
    size = size - facet.pitch
    for round_ in range(ROUNDS):
        tolerance = facet.pitch * (3.0 if round_ < 3 else 1.5)
        step = _line_step(seen, center, yaw, size, tolerance)
        if step is None:
            return None
        center, yaw, size = step
        if float(size.min()) < settings.least_side:
            return None
    axes = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    local = (seen - center) @ axes
    side, off = _nearest_side(local, size)
    tolerance = settings.edge_tolerance * facet.pitch
    on = np.abs(off) <= tolerance
    seen_sides = min(_seen_of_side(local[on & (side == k)], k, size, facet.pitch) for k in range(4))
    residual = float(np.sqrt(np.mean(np.minimum(np.abs(off), 3.0 * facet.pitch) ** 2)))
    stds = [_edge_std(size[1 - k], yaw + 0.5 * math.pi * (1 - k), facet, settings) for k in (0, 1)]
    yaw_std = _yaw_std(size, yaw, facet, settings)
    size = size + 2.0 * settings.edge_inset * facet.pitch
    if size[1] > size[0]:
        size, yaw, stds = size[::-1], yaw + 0.5 * math.pi, stds[::-1]
    yaw = yaw - math.pi * math.ceil((yaw - 0.5 * math.pi) / math.pi)
    return Rectangle(
        center, yaw, (float(size[0]), float(size[1])), residual, float(on.mean()), seen_sides,
        (stds[0], stds[1]), yaw_std,
    )  # fmt: skip


def _line_step(
    seen: Array, center: Array, yaw: float, size: Array, tolerance: float
) -> tuple[Array, float, Array] | None:
    """Turn and resize a rectangle so that its four sides are the least-squares lines of the edge near them."""
    axes = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    local = (seen - center) @ axes
    side, off = _nearest_side(local, size)
    axis = side // 2
    along = np.take_along_axis(local, (1 - axis)[:, None], axis=1)[:, 0]
    # Near a corner the edge belongs to both sides.
    far_from_corner = np.abs(along) < 0.5 * size[1 - axis] - tolerance
    used = (np.abs(off) <= tolerance) & far_from_corner
    if min(int((used & (side == k)).sum()) for k in range(4)) < 2:
        return None
    outward = np.where(side % 2 == 0, 1.0, -1.0)
    # A small turn moves the place `along` a side of axis 0 by -turn * along, of axis 1 by +turn * along.
    lever = np.where(axis == 0, -1.0, 1.0) * along * outward
    unknowns = np.column_stack([lever, *((side == k).astype(float) for k in range(4))])[used]
    turn, *moves = np.linalg.lstsq(unknowns, off[used], rcond=None)[0]
    right, left, up, down = moves
    shift = 0.5 * np.array([right - left, up - down])
    return center + axes @ shift, yaw + float(turn), size + np.array([right + left, up + down])


def _nearest_side(local: Array, size: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the side (0: +x, 1: -x, 2: +y, 3: -y) that each point is nearest to, and how far outside it is."""
    x, y = local.T
    off = np.column_stack([x - 0.5 * size[0], -x - 0.5 * size[0], y - 0.5 * size[1], -y - 0.5 * size[1]])
    side = np.argmin(np.abs(off), axis=1)
    return side, off[np.arange(len(local)), side]


def _seen_of_side(local: Array, side: int, size: Array, pitch: float) -> float:
    """Return the share of a side's length near which its edge, (n, 2) in the rectangle's axes, was seen [1]."""
    length = float(size[1 - side // 2])
    bins = max(3, int(length / (2.0 * pitch)))
    at = ((local[:, 1 - side // 2] / length + 0.5) * bins).astype(np.int64)
    return len(np.unique(at[(at >= 0) & (at < bins)])) / bins


def _edge_std(length: float, direction: float, facet: TopFacet, settings: PerceptionSettings) -> float:
    """Return the uncertainty of where a side of `length` is [m].

    Pixels tell an edge to within their pitch; an edge across the image's rows crosses many, at evenly spread phases.
    """
    return math.hypot(settings.edge_floor, facet.pitch / math.sqrt(12.0 * _phases(length, direction, facet)))


def _phases(length: float, direction: float, facet: TopFacet) -> float:
    """Return how many rows or columns of pixels an edge crosses [1]: so many times it is measured anew."""
    slant = math.atan2(facet.grid[1], facet.grid[0]) - direction
    return 1.0 + length * min(abs(math.sin(slant)), abs(math.cos(slant))) / facet.pitch


def _yaw_std(size: Array, yaw: float, facet: TopFacet, settings: PerceptionSettings) -> float:
    """Return the uncertainty of the yaw [rad]: that of two lines as long as the longer side."""
    longer = int(np.argmax(size))
    phases = _phases(float(size[longer]), yaw + 0.5 * math.pi * longer, facet)
    return math.hypot(settings.yaw_floor, facet.pitch / (float(size[longer]) * math.sqrt(2.0 * phases)))


def _fit_disc(facet: TopFacet, seen: Array, settings: PerceptionSettings) -> DiscOutline | None:
    points, center, radius, off = seen, seen.mean(axis=0), 0.0, np.zeros(len(seen))
    for round_ in range(ROUNDS):
        unknowns = np.column_stack([2.0 * (points - center), np.ones(len(points))])
        squares = np.sum((points - center) ** 2, axis=1)
        (dx, dy, c), *_ = np.linalg.lstsq(unknowns, squares, rcond=None)
        square = float(c + dx * dx + dy * dy)
        center = center + np.array([dx, dy])
        if square <= 0.25 * settings.least_side**2:
            return None
        radius = math.sqrt(square)
        off = np.linalg.norm(seen - center, axis=1) - radius
        kept = np.abs(off) <= facet.pitch * (3.0 if round_ < 3 else 1.5)
        if int(kept.sum()) < FEWEST_EDGE_POINTS:
            return None
        points = seen[kept]
    on = np.abs(off) <= settings.edge_tolerance * facet.pitch
    quarters = np.floor(np.arctan2(*(seen[on] - center).T) / (0.5 * math.pi)).astype(np.int64)
    expected = 0.25 * 2.0 * math.pi * radius / facet.pitch
    least = min(int((quarters == k).sum()) for k in range(-2, 2)) / expected
    residual = float(np.sqrt(np.mean(np.minimum(np.abs(off), 3.0 * facet.pitch) ** 2)))
    spread = facet.pitch / math.sqrt(12.0 * max(1.0, 0.25 * on.sum()))
    std = math.hypot(settings.edge_floor, spread)
    radius += settings.edge_inset * facet.pitch
    return DiscOutline(center, radius, residual, float(on.mean()), min(1.0, least), std)
