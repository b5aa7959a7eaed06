"""Whether a round pad seals on a facet: its border, its curvature, and what else of the object is in the way."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planners.geometry.facets import Facet, Indices
from planners.geometry.pose import Array
from planners.geometry.surface import side_neighbours, winding_numbers

Mask = NDArray[np.bool_]

_ROUNDING = 1e-9
"""Lengths within it are equal [m]: a pad may be exactly as far from the border as it must be."""


class PadFit(IntEnum):
    """How a pad sits."""

    SEALS = 0
    OFF = 1
    """Its centre is not on the facet."""
    BORDER = 2
    """It is too near to the facet's border."""
    CURVED = 3
    """The surface under it is not flat enough."""


_SEALS, _OFF, _BORDER, _CURVED = (int(fit) for fit in (PadFit.SEALS, PadFit.OFF, PadFit.BORDER, PadFit.CURVED))


@dataclass(frozen=True)
class Pad:
    """A round pad and what it asks of a surface."""

    radius: float
    """[m]"""
    clearance: float
    """Least distance of its centre from the border, at least the radius [m]."""
    flatness: float
    """Most distance of the surface under it from its plane [m]."""
    stand_off: float
    """Height above it in which there is nothing else [m]."""


@dataclass(frozen=True, eq=False)
class PadFits:
    """Pads at n places of a facet, in the body frame."""

    points: Array
    """(n, 3) on the surface [m]."""
    normals: Array
    """(n, 3) outward unit normals of the pads' planes."""
    fits: Indices
    """(n,) of `PadFit`."""
    clearances: Array
    """(n,) distances of the centres from the border, along the pads' planes [m]."""
    deviations: Array
    """(n,) largest distances of the surface from the pads' planes; zero where the border was too near [m]."""


@dataclass(frozen=True, eq=False)
class PadSurface:
    """A surface that pads may sit on: several closed shells, which may overlap."""

    vertices: Array
    """(n, 3) in the body frame [m]."""
    faces: Indices
    """(m, 3) counter-clockwise from outside."""

    def fit(self, facet: Facet, samples: Array, pad: Pad) -> PadFits:
        """Put pads on a facet at samples (n, 2) of the facet frame [m]."""
        R, origin = facet.T_body_facet[:3, :3], facet.T_body_facet[:3, 3]
        fitted = _fit_flat(samples, facet.border, pad) if facet.flat else self._fit_curved(facet, samples, pad)
        places, normals, fits, clearances, deviations = fitted
        return PadFits(places @ R.T + origin, normals @ R.T, fits, clearances, deviations)

    def _fit_curved(self, facet: Facet, samples: Array, pad: Pad) -> _Fitted:
        R, origin = facet.T_body_facet[:3, :3], facet.T_body_facet[:3, 3]
        corners = (self.vertices[self.faces[facet.triangles]] - origin) @ R
        return _fit_curved(samples, corners, facet.normals @ R, facet.border, pad.radius, pad.clearance, pad.flatness)

    def covered(self, facet: Facet, points: Array, normals: Array, pad: Pad) -> Mask:
        """Return (k,) whether another part of the surface is above pads, or these are inside another shell.

        Args:
            facet: that the pads sit on.
            points: (k, 3) their centres, in the body frame [m].
            normals: (k, 3) square to them, outward.
            pad: each of them.
        """
        if len(points) == 0:
            return np.zeros(0, dtype=bool)
        others = np.ones(len(self.faces), dtype=bool)
        others[facet.triangles] = False
        reach = math.hypot(pad.radius, pad.stand_off)
        low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
        near = others & np.all((self._lows <= high) & (self._highs >= low), axis=1)
        covered = _something_above(points, normals, self._corners[near], pad.radius, pad.flatness, pad.stand_off)
        return covered | self._buried(facet, points + 0.5 * pad.stand_off * normals)

    def _buried(self, facet: Facet, points: Array) -> Mask:
        """Return (k,) whether points are inside a shell that the facet does not belong to."""
        shells, count = self._shells
        buried = np.zeros(len(points), dtype=bool)
        for shell in range(count):
            mine = shells == shell
            if shell == shells[facet.triangles[0]]:
                continue
            low, high = self._lows[mine].min(axis=0), self._highs[mine].max(axis=0)
            near = np.flatnonzero(np.all((points > low) & (points < high), axis=1))
            buried[near] |= winding_numbers(self._corners[mine], points[near]) > 0.5
        return buried

    @cached_property
    def _corners(self) -> Array:
        return self.vertices[self.faces]

    @cached_property
    def _lows(self) -> Array:
        return self._corners.min(axis=1)

    @cached_property
    def _highs(self) -> Array:
        return self._corners.max(axis=1)

    @cached_property
    def _shells(self) -> tuple[Indices, int]:
        """(m,) shell of each triangle, and how many shells there are."""
        neighbours = side_neighbours(self.faces)
        rows, sides = np.nonzero(neighbours >= 0)
        links = coo_array((np.ones(len(rows)), (rows, neighbours[rows, sides])), shape=(len(self.faces),) * 2)
        count, shells = connected_components(links, directed=False)
        return shells, int(count)


def narrow_places(facet: Facet, spacing: float, finest: float, clearance: float) -> Array:
    """Return samples (n, 2) of the facet frame at least `clearance` from the border that a grid may have missed.

    The grid's cells are quartered as long as one of them may contain such a place, until some are found or the cells
    are smaller than `finest`: depth below the border changes by no more than the way.
    """
    cells: Array = facet_grid(facet, spacing).astype(np.float64) * spacing
    size = spacing
    while size > finest and len(cells):
        inside, distances = _depths(cells, facet.border)
        depths = np.where(inside, distances, -distances)
        found = depths >= clearance - _ROUNDING
        if found.any():
            return cells[found]
        cells = cells[depths + math.sqrt(0.5) * size >= clearance]
        size *= 0.5
        cells = np.asarray(cells[:, None] + 0.5 * size * _QUARTERS, dtype=np.float64).reshape(-1, 2)
    return np.empty((0, 2))


def facet_grid(facet: Facet, spacing: float) -> Indices:
    """Return the (n, 2) numbers of steps from the facet's centroid at which a grid is within its extent."""
    low, high = facet.extent
    steps = [np.arange(math.ceil(a / spacing), math.floor(b / spacing) + 1) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)


_QUARTERS = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
_Fitted = tuple[Array, Array, Indices, Array, Array]
"""Places and normals (n, 3) in the facet frame, fits, clearances and deviations (n,)."""


def _fit_flat(samples: Array, border: Array, pad: Pad) -> _Fitted:
    inside, clearances = _depths(samples, border)
    fits = np.where(clearances >= pad.clearance - _ROUNDING, PadFit.SEALS, PadFit.BORDER).astype(np.int64)
    fits[~inside] = PadFit.OFF
    places = np.column_stack([samples, np.zeros(len(samples))])
    normals = np.tile([0.0, 0.0, 1.0], (len(samples), 1))
    return places, normals, fits, clearances, np.zeros(len(samples))


@njit(cache=True, nogil=True)
def _depths(samples: Array, border: Array) -> tuple[Mask, Array]:
    """Return whether points (n, 2) are enclosed by the border, and their distance from it."""
    inside = np.zeros(len(samples), dtype=np.bool_)
    distances = np.empty(len(samples))
    for i in range(len(samples)):
        x, y = samples[i]
        least = np.inf
        odd = False
        for k in range(len(border)):
            ax, ay = border[k, 0, 0] - x, border[k, 0, 1] - y
            bx, by = border[k, 1, 0] - x, border[k, 1, 1] - y
            least = min(least, _distance_from_origin(ax, ay, bx, by))
            if (ay > 0.0) != (by > 0.0) and ax + (bx - ax) * ay / (ay - by) > 0.0:
                odd = not odd
        inside[i], distances[i] = odd, least
    return inside, distances


@njit(cache=True, nogil=True)
def _distance_from_origin(ax: float, ay: float, bx: float, by: float) -> float:
    """Return the distance of the origin from a straight piece."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    part = 0.0 if square == 0.0 else min(1.0, max(0.0, -(ax * dx + ay * dy) / square))
    return math.hypot(ax + part * dx, ay + part * dy)


@njit(cache=True, nogil=True)
def _fit_curved(
    samples: Array, corners: Array, normals: Array, border: Array, radius: float, clearance: float, flatness: float
) -> tuple[Array, Array, Indices, Array, Array]:
    """Put pads on a facet that is not flat: everything in the facet frame, `corners` (k, 3, 3) of its triangles.

    A pad lies in the plane of the triangle under its centre or, if the surface deviates too much from that, square to
    the mean normal of the triangles around.
    """
    places = np.zeros((len(samples), 3))
    axes = np.zeros((len(samples), 3))
    axes[:, 2] = 1.0
    fits = np.full(len(samples), _OFF, dtype=np.int64)
    clearances = np.zeros(len(samples))
    deviations = np.zeros(len(samples))
    local, balls = np.empty((len(corners), 3, 3)), _balls(corners)
    for i in range(len(samples)):
        triangle, height = _triangle_at(samples[i, 0], samples[i, 1], corners)
        if triangle < 0:
            continue
        places[i, 0], places[i, 1], places[i, 2] = samples[i, 0], samples[i, 1], height
        axes[i] = normals[triangle]
        for _ in range(2):
            frame = _pad_axes(axes[i])
            clearances[i] = _clearance(places[i], frame, border)
            if clearances[i] < clearance - _ROUNDING:
                fits[i] = _BORDER
                break
            near = _localise(places[i], frame, corners, balls, radius, local)
            low, high = _heights(local[:near], radius)
            deviations[i] = max(high, -low)
            fits[i] = _SEALS if deviations[i] <= flatness else _CURVED
            if fits[i] == _SEALS:
                break
            axes[i] = _mean_normal(local[:near], frame, radius)
    return places, axes, fits, clearances, deviations


@njit(cache=True, nogil=True)
def _triangle_at(x: float, y: float, corners: Array) -> tuple[int, float]:
    """Return the triangle above or below (x, y) and its height there; -1 if there is none."""
    for k in range(len(corners)):
        a, b, c = corners[k]
        if min(a[0], b[0], c[0]) > x or max(a[0], b[0], c[0]) < x or min(a[1], b[1], c[1]) > y:
            continue
        double = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if double <= 0.0:
            continue
        wb = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / double
        wc = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / double
        if wb >= -1e-9 and wc >= -1e-9 and wb + wc <= 1.0 + 1e-9:
            return k, a[2] + wb * (b[2] - a[2]) + wc * (c[2] - a[2])
    return -1, 0.0


@njit(cache=True, nogil=True)
def _pad_axes(normal: Array) -> Array:
    """Return rows u, v, n: a right-handed frame with n along the normal."""
    n = normal / math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    frame = np.empty((3, 3))
    frame[2] = n
    k = np.argmin(np.abs(n))
    u = -n[k] * n
    u[k] += 1.0
    frame[0] = u / math.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
    frame[1, 0] = n[1] * frame[0, 2] - n[2] * frame[0, 1]
    frame[1, 1] = n[2] * frame[0, 0] - n[0] * frame[0, 2]
    frame[1, 2] = n[0] * frame[0, 1] - n[1] * frame[0, 0]
    return frame


@njit(cache=True, nogil=True)
def _along(axis: Array, point: Array, origin: Array) -> float:
    return axis[0] * (point[0] - origin[0]) + axis[1] * (point[1] - origin[1]) + axis[2] * (point[2] - origin[2])


@njit(cache=True, nogil=True)
def _clearance(place: Array, frame: Array, border: Array) -> float:
    """Return the distance from the border (b, 2, 3) projected along the pad's normal."""
    least = np.inf
    for k in range(len(border)):
        a, b = border[k]
        least = min(
            least,
            _distance_from_origin(
                _along(frame[0], a, place),
                _along(frame[1], a, place),
                _along(frame[0], b, place),
                _along(frame[1], b, place),
            ),
        )
    return least


@njit(cache=True, nogil=True)
def _balls(corners: Array) -> Array:
    """Return (k, 4) centre and radius of a ball about each triangle."""
    balls = np.zeros((len(corners), 4))
    for k in range(len(corners)):
        for axis in range(3):
            balls[k, axis] = (corners[k, 0, axis] + corners[k, 1, axis] + corners[k, 2, axis]) / 3.0
        for j in range(3):
            square = 0.0
            for axis in range(3):
                square += (corners[k, j, axis] - balls[k, axis]) ** 2
            balls[k, 3] = max(balls[k, 3], math.sqrt(square))
    return balls


@njit(cache=True, nogil=True)
def _localise(place: Array, frame: Array, corners: Array, balls: Array, radius: float, local: Array) -> int:
    """Write the triangles that may be over the pad into `local`, in the pad's axes; return how many there are."""
    count = 0
    for k in range(len(corners)):
        u, v = _along(frame[0], balls[k], place), _along(frame[1], balls[k], place)
        if u * u + v * v > (radius + balls[k, 3]) ** 2:
            continue
        for j in range(3):
            for axis in range(3):
                local[count, j, axis] = _along(frame[axis], corners[k, j], place)
        count += 1
    return count


@njit(cache=True, nogil=True)
def _heights(triangles: Array, radius: float) -> tuple[float, float]:
    """Return the least and the greatest height of triangles (k, 3, 3) over the disc; (inf, -inf) if none is there."""
    low, high = np.inf, -np.inf
    for k in range(len(triangles)):
        least, most = _height_range(triangles[k], radius)
        low, high = min(low, least), max(high, most)
    return low, high


@njit(cache=True, nogil=True)
def _height_range(triangle: Array, radius: float) -> tuple[float, float]:
    """Return the exact range of heights of a triangle over the disc of the radius about the origin.

    A linear function on the part of a triangle within a circle is extreme where a side begins, ends or crosses the
    circle, or where the circle is farthest along the gradient.
    """
    low, high = np.inf, -np.inf
    for k in range(3):
        a, b = triangle[k], triangle[(k + 1) % 3]
        dx, dy = b[0] - a[0], b[1] - a[1]
        square = dx * dx + dy * dy
        along = a[0] * dx + a[1] * dy
        outside = a[0] ** 2 + a[1] ** 2 - radius**2
        if square == 0.0:
            first, last = (0.0, 1.0) if outside <= 0.0 else (1.0, 0.0)
        else:
            root = along * along - square * outside
            if root < 0.0:
                continue
            first = max(0.0, (-along - math.sqrt(root)) / square)
            last = min(1.0, (-along + math.sqrt(root)) / square)
        if first <= last:
            one, other = a[2] + first * (b[2] - a[2]), a[2] + last * (b[2] - a[2])
            low, high = min(low, one, other), max(high, one, other)
    for sign in (-1.0, 1.0):
        inside, height = _height_along_gradient(triangle, sign * radius)
        if inside:
            low, high = min(low, height), max(high, height)
    return low, high


@njit(cache=True, nogil=True)
def _height_along_gradient(triangle: Array, way: float) -> tuple[bool, float]:
    """Return whether the triangle is above the origin moved along its gradient by `way`, and its height there."""
    a, b, c = triangle
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    double = ux * vy - uy * vx
    if double == 0.0:
        return False, 0.0
    gx, gy = (uz * vy - vz * uy) / double, (vz * ux - uz * vx) / double
    slope = math.hypot(gx, gy)
    x, y = (way * gx / slope, way * gy / slope) if slope > 0.0 else (0.0, 0.0)
    wb = ((x - a[0]) * vy - (y - a[1]) * vx) / double
    wc = (ux * (y - a[1]) - uy * (x - a[0])) / double
    return wb >= 0.0 and wc >= 0.0 and wb + wc <= 1.0, a[2] + wb * uz + wc * vz


@njit(cache=True, nogil=True)
def _mean_normal(triangles: Array, frame: Array, radius: float) -> Array:
    """Return the mean normal, by area, of the triangles whose centroid is over the disc; the pad's if there is none.

    Triangles in the pad's axes, the normal in those that `frame` is given in.
    """
    total = np.zeros(3)
    for k in range(len(triangles)):
        a, b, c = triangles[k]
        if math.hypot(a[0] + b[0] + c[0], a[1] + b[1] + c[1]) > 3.0 * radius:
            continue
        u, v = b - a, c - a
        total[0] += u[1] * v[2] - u[2] * v[1]
        total[1] += u[2] * v[0] - u[0] * v[2]
        total[2] += u[0] * v[1] - u[1] * v[0]
    length = math.sqrt(total[0] ** 2 + total[1] ** 2 + total[2] ** 2)
    if length == 0.0:
        return frame[2].copy()
    return (total[0] * frame[0] + total[1] * frame[1] + total[2] * frame[2]) / length


@njit(cache=True, nogil=True)
def _something_above(points: Array, normals: Array, corners: Array, radius: float, low: float, high: float) -> Mask:
    """Return (n,) whether a triangle of `corners` (k, 3, 3) is above a pad, between two heights."""
    found = np.zeros(len(points), dtype=np.bool_)
    local, balls = np.empty((len(corners), 3, 3)), _balls(corners)
    for i in range(len(points)):
        near = _localise(points[i], _pad_axes(normals[i]), corners, balls, radius, local)
        for k in range(near):
            least, most = _height_range(local[k], radius)
            found[i] = found[i] or (most > low and least < high)
    return found
