"""Convex parts that together cover a solid: it is cut by planes where its hull reaches too far beyond it.

Every part is the hull of what the solid has in one cell of a partition of space, so that nothing is ever left
uncovered; how far the parts reach beyond the solid is measured. A solid whose faces are flat is cut along them, and
then its parts are exact.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from planners.geometry.pose import Array
from planners.geometry.surface import Faces, distance, triangle_normals, winding_numbers


@dataclass(frozen=True)
class CoverSettings:
    """How closely parts follow a solid, and how much is spent on it."""

    tolerance: float = 0.01
    """A part may reach this far beyond the solid, as a share of the solid's diagonal [1]: 3 mm of 0.3 m."""
    most_parts: int = 32
    """Collision is asked of every part."""
    samples: int = 20_000
    """Points on the surface that distances are measured to."""
    probes: int = 400
    """Points in the hull of a part that may be far from the solid."""
    verified: int = 12
    """The farthest probes that are checked for being outside."""
    seed: int = 0


@dataclass(frozen=True, eq=False)
class ConvexCover:
    """Convex parts that contain a solid."""

    parts: tuple[Array, ...]
    """The corners (n, 3) of each part [m]."""
    excess: float
    """The farthest that a part was found to reach beyond the solid [m]."""


@dataclass(frozen=True, eq=False)
class _Cell:
    """A convex region of space, and what the solid has in it."""

    planes: Array
    """(k, 4) rows n, d: n·x <= d in the region."""
    triangles: Array
    """(t, 3, 3) the surface in the region."""
    hull: ConvexHull
    """Of the solid in the region."""
    excess: float
    """How far the hull reaches beyond the solid [m]."""
    farthest: Array
    """(3,) where it does."""


def cover(vertices: Array, faces: Faces, settings: CoverSettings | None = None) -> ConvexCover:
    """Cover the solid inside a closed, outward surface by convex parts.

    Args:
        vertices: (n, 3) [m].
        faces: (m, 3) counter-clockwise from outside.
        settings: how closely.
    """
    settings = settings or CoverSettings()
    solid = _Solid(vertices, faces, settings)
    root = solid.cell(np.empty((0, 4)), vertices[faces])
    assert root is not None
    tolerance = settings.tolerance * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    number = itertools.count()
    # The cell that reaches farthest beyond the solid is cut first.
    queue = [(-root.excess, next(number), root)]
    done: list[tuple[float, int, _Cell]] = []
    while queue and len(queue) + len(done) < settings.most_parts and -queue[0][0] > tolerance:
        worst = heapq.heappop(queue)
        pieces = solid.cut(worst[2])
        if len(pieces) < 2:
            done.append(worst)
        for cell in pieces if len(pieces) == 2 else ():
            heapq.heappush(queue, (-cell.excess, next(number), cell))
    cells = [cell for _, _, cell in sorted(queue + done, key=lambda entry: entry[1])]
    parts = tuple(cell.hull.points[cell.hull.vertices] for cell in cells)
    return ConvexCover(parts, max(cell.excess for cell in cells))


class _Solid:
    """What the cells of one solid are made from."""

    def __init__(self, vertices: Array, faces: Faces, settings: CoverSettings) -> None:
        self.vertices, self.faces, self.settings = vertices, faces, settings
        self.rounding = 1e-9 * float(np.linalg.norm(np.ptp(vertices, axis=0)))
        self.rng = np.random.default_rng(settings.seed)
        self.samples, self.owners = self._sample()
        self.normals = triangle_normals(vertices, faces)[0][self.owners]
        self.tree = KDTree(self.samples)

    def cell(self, planes: Array, triangles: Array) -> _Cell | None:
        """Return a region with what the solid has in it; None if that has no volume."""
        points = np.vstack([triangles.reshape(-1, 3), self._corners_inside(planes)])
        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError):
            return None
        excess, farthest = self._excess(hull)
        return _Cell(planes, triangles, hull, excess, farthest)

    def cut(self, cell: _Cell) -> list[_Cell]:
        """Cut a cell by the plane after which the hulls on both sides are smallest together."""
        ranked = sorted(self._planes_for(cell), key=lambda plane: self._cost(cell, plane))
        low, high = (self.cell(*side) for side in self._sides(cell, ranked[0]))
        return [side for side in (low, high) if side is not None]

    def _cost(self, cell: _Cell, plane: Array) -> tuple[float, float]:
        """Return the volume of both hulls over that of the cell's [1], and for ties the larger of the two [m³]."""
        volumes = []
        for planes, triangles in self._sides(cell, plane):
            points = np.vstack([triangles.reshape(-1, 3), self._corners_inside(planes)])
            try:
                volumes.append(float(ConvexHull(points).volume))
            except (QhullError, ValueError):
                volumes.append(0.0)
        # A plane that cuts nothing off leaves the cell as it was.
        useless = min(volumes) <= 1e-9 * cell.hull.volume
        return (2.0 if useless else round(sum(volumes) / cell.hull.volume, 3), max(volumes))

    def _sides(self, cell: _Cell, plane: Array) -> Iterator[tuple[Array, Array]]:
        for row in (plane, -plane):
            yield np.vstack([cell.planes, row]), _clipped(cell.triangles, row, self.rounding)

    def _planes_for(self, cell: _Cell) -> list[Array]:
        """Return planes (4,) that may cut the hollow at `cell.farthest` off: of faces near it, and right through it."""
        _, near = self.tree.query(cell.farthest, k=min(64, len(self.samples)))
        planes: list[Array] = []
        chosen: list[Array] = []
        for k in np.atleast_1d(near):
            normal = self.normals[k]
            if len(chosen) < 4 and all(abs(normal @ other) < 0.966 for other in chosen):
                chosen.append(normal)
                planes.append(np.append(normal, normal @ self.samples[k]))
        axes = np.linalg.svd(cell.hull.points[cell.hull.vertices] - cell.farthest, full_matrices=False)[2]
        return planes + [np.append(axis, axis @ cell.farthest) for axis in (*axes, *np.eye(3))]

    def _corners_inside(self, planes: Array) -> Array:
        """Return the corners of a region that are inside the solid: (k, 3)."""
        corners = []
        for three in itertools.combinations(range(len(planes)), 3):
            normals, offsets = planes[list(three), :3], planes[list(three), 3]
            if abs(np.linalg.det(normals)) < 1e-6:
                continue
            corner = np.linalg.solve(normals, offsets)
            if np.all(planes[:, :3] @ corner <= planes[:, 3] + self.rounding):
                corners.append(corner)
        points = np.array(corners).reshape(-1, 3)
        return points[winding_numbers(self.vertices[self.faces], points) > 0.5]

    def _excess(self, hull: ConvexHull) -> tuple[float, Array]:
        """Return how far a hull reaches beyond the solid [m], and the (3,) point where it does."""
        probes = self._probes(hull)
        distances, near = (np.asarray(found) for found in self.tree.query(probes, k=min(8, len(self.samples))))
        heights = np.einsum("pki,pki->pk", probes[:, None] - self.samples[near], self.normals[near])
        may_be_outside = heights.max(axis=1) > self.rounding
        candidates = np.flatnonzero(may_be_outside)[np.argsort(-distances[may_be_outside, 0], kind="stable")]
        excess, farthest = 0.0, probes[0]
        for k in candidates[: self.settings.verified]:
            if distances[k, 0] <= excess:
                break
            if winding_numbers(self.vertices[self.faces], probes[k][None])[0] < 0.5:
                nearest = distance(self.vertices, self.faces[self.owners[near[k]]], probes[k])
                if nearest > excess:
                    excess, farthest = nearest, probes[k]
        return excess, farthest

    def _probes(self, hull: ConvexHull) -> Array:
        """Return points (p, 3) in a hull: on its faces, and anywhere inside."""
        corners = hull.points[hull.simplices]
        areas = triangle_normals(hull.points, hull.simplices.astype(np.int64))[1]
        count = self.settings.probes // 2
        chosen = self.rng.choice(len(corners), count, p=areas / areas.sum())
        weights = self.rng.dirichlet(np.ones(3), count)
        on_faces = np.einsum("pk,pki->pi", weights, corners[chosen])
        center = hull.points[hull.vertices].mean(axis=0)
        depth = self.rng.random((count, 1)) ** (1.0 / 3.0)
        return np.vstack([corners.mean(axis=1), on_faces, center + depth * (on_faces - center)])

    def _sample(self) -> tuple[Array, Faces]:
        """Return points (s, 3) spread over the surface, and the triangle (s,) that each is on."""
        _, areas = triangle_normals(self.vertices, self.faces)
        whole = np.flatnonzero(areas > 0.0)
        extra = self.rng.choice(len(areas), self.settings.samples, p=areas / areas.sum())
        chosen = np.concatenate([whole, extra])
        weights = np.vstack([np.full((len(whole), 3), 1.0 / 3.0), self.rng.dirichlet(np.ones(3), len(extra))])
        return np.einsum("pk,pki->pi", weights, self.vertices[self.faces[chosen]]), chosen


def _clipped(triangles: Array, plane: Array, rounding: float) -> Array:
    """Return the part (t, 3, 3) of triangles where n·x <= d; one in the plane belongs to the side of its solid."""
    heights = triangles @ plane[:3] - plane[3]
    heights[np.abs(heights) <= rounding] = 0.0
    inside, outside = np.all(heights <= 0.0, axis=1), np.all(heights >= 0.0, axis=1)
    flat = inside & outside
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inside &= ~flat | (normals @ plane[:3] > 0.0)
    crossing = ~(inside | outside)
    pieces = [_cut_triangle(corners, at) for corners, at in zip(triangles[crossing], heights[crossing], strict=True)]
    return np.concatenate([triangles[inside], *pieces]) if pieces else triangles[inside]


def _cut_triangle(corners: Array, heights: Array) -> Array:
    """Return the (t, 3, 3) triangles below a plane of one (3, 3) that crosses it, with `heights` (3,) above it."""
    kept: list[Array] = []
    for k in range(3):
        here, there = heights[k], heights[(k + 1) % 3]
        if here <= 0.0:
            kept.append(corners[k])
        if here * there < 0.0:
            kept.append(corners[k] + here / (here - there) * (corners[(k + 1) % 3] - corners[k]))
    return np.array([[kept[0], kept[k], kept[k + 1]] for k in range(1, len(kept) - 1)])
