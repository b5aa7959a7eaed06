"""Facets: nearly flat, overlapping regions of a triangle mesh (overlapping growth of Wan et al., used by paper A).

Triangles are joined to *patches* first, connected triangles in one plane. Growing patches instead of triangles makes
facets independent of how a plane is triangulated, and of slivers, whose own normals mean nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.errors import LiftwrightError
from planners.geometry.pose import Array, Transform, frame_from_z, transform
from planners.geometry.surface import side_neighbours

Indices = NDArray[np.int64]

_STRAIGHT = 1e-4
"""Sine of the turn below which a corner of an outline is none."""
_NO_LENGTH = 1e-9
"""Length below which a side of an outline is none [m]."""
_TIE = 1e6
"""One over the relative difference below which sizes are equal: rounding does not decide what comes first."""

_ANGLE_ROUNDING = 1e-6
"""Angles within it of the largest are not below it [rad]: of a prism with 24 sides, all or no two are joined."""


@dataclass(frozen=True)
class FacetSettings:
    """How facets grow."""

    largest_angle: float = math.radians(15.0)
    """Between a patch and the seed, and between neighbours [rad]; the authors' value."""
    coplanar: float = 1e-5
    """Distance from a plane within which vertices are in it [m]; our choice: a hundred times what files round off."""
    least_area: float = 0.0
    """Facets below it are left out [m²]."""

    def __post_init__(self) -> None:
        if not (0.0 < self.largest_angle < 0.5 * math.pi and self.coplanar > 0.0 and self.least_area >= 0.0):
            raise LiftwrightError("facets grow by an angle between 0 and 90 degrees and a positive distance")


@dataclass(frozen=True, eq=False)
class Facet:
    """A connected region whose normals differ little from that of the patch it grew from."""

    T_body_facet: Transform
    """z: outward normal of the seed; x: along the longest side; origin: centroid, in the seed's plane."""
    area: float
    """Of its triangles [m²]."""
    triangles: Indices
    """(k,) numbers of its triangles."""
    normals: Array
    """(k, 3) outward unit normals of the planes the triangles lie in, in the body frame."""
    flat: bool
    """Whether all triangles lie in the seed's plane."""
    loops: tuple[Array, ...]
    """(n, 3) corners of the border each, in the body frame; the facet is on the left, seen from outside [m]."""

    @cached_property
    def border(self) -> Array:
        """(b, 2, 3) straight pieces of the border, in the facet frame [m]."""
        T = self.T_body_facet
        pieces = np.concatenate([np.stack([loop, np.roll(loop, -1, axis=0)], axis=1) for loop in self.loops])
        return (pieces - T[:3, 3]) @ T[:3, :3]

    @cached_property
    def extent(self) -> tuple[Array, Array]:
        """Least and greatest x and y, (2,) each, in the facet frame [m]."""
        corners = self.border[:, 0, :2]
        return corners.min(axis=0), corners.max(axis=0)


def find_facets(vertices: Array, faces: Indices, settings: FacetSettings | None = None) -> tuple[Facet, ...]:
    """Cover a surface with facets.

    The largest patch that no facet covers yet is the next seed; what grows from it may overlap earlier facets.

    Args:
        vertices: (n, 3) in the body frame [m].
        faces: (m, 3) vertex numbers, counter-clockwise from outside.
        settings: when patches belong together.

    Returns:
        Facets by falling area of their seeds. Triangles without area that touch nothing flat are in none.
    """
    settings = settings or FacetSettings()
    if len(faces) == 0:
        return ()
    mesh = _Mesh.read(np.ascontiguousarray(vertices, dtype=float), np.ascontiguousarray(faces, dtype=np.int64))
    patches = _Patches.of(mesh, settings.coplanar)
    return tuple(_facets(mesh, patches, settings))


@dataclass(frozen=True, eq=False)
class _Mesh:
    """Triangles with what growth asks of them."""

    vertices: Array
    faces: Indices
    crosses: Array
    """(m, 3) normals, twice as long as the triangle is large."""
    neighbours: Indices

    @staticmethod
    def read(vertices: Array, faces: Indices) -> _Mesh:
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        return _Mesh(vertices, faces, np.cross(b - a, c - a), side_neighbours(faces))

    @cached_property
    def areas(self) -> Array:
        return 0.5 * np.linalg.norm(self.crosses, axis=1)

    @cached_property
    def altitudes(self) -> Array:
        """(m,) least heights of the triangles: below a tolerance the normal means nothing."""
        corners = self.vertices[self.faces]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        return 2.0 * self.areas / np.where(longest > 0.0, longest, 1.0)


@dataclass(frozen=True, eq=False)
class _Patches:
    """Connected triangles in one plane."""

    patch_of: Indices
    """(m,) patch of each triangle."""
    normals: Array
    """(p, 3) unit, zero for a patch without area."""
    areas: Array
    order: Indices
    """(p,) patches by falling area."""

    @staticmethod
    def of(mesh: _Mesh, coplanar: float) -> _Patches:
        units = mesh.crosses / np.where(mesh.areas > 0.0, 2.0 * mesh.areas, 1.0)[:, None]
        seeds = _by_falling_size(mesh.areas, np.arange(len(mesh.areas)))
        thin = mesh.altitudes < coplanar
        patch_of = _grow_patches(mesh.vertices, mesh.faces, units, thin, mesh.neighbours, seeds, coplanar)
        count = int(patch_of.max()) + 1
        sums = np.column_stack([np.bincount(patch_of, mesh.crosses[:, k], count) for k in range(3)])
        length = np.linalg.norm(sums, axis=1)
        areas: Array = np.bincount(patch_of, mesh.areas, count).astype(np.float64)
        first = np.full(count, len(patch_of), dtype=np.int64)
        np.minimum.at(first, patch_of, np.arange(len(patch_of)))
        normals = sums / np.where(length > 0.0, length, 1.0)[:, None]
        return _Patches(patch_of, normals, areas, _by_falling_size(areas, first))

    def adjacency(self, neighbours: Indices) -> tuple[Indices, Indices]:
        """Return (starts, others): patch p touches `others[starts[p]:starts[p + 1]]` along a side."""
        here = np.repeat(self.patch_of, 3)
        there = np.where(neighbours.ravel() >= 0, self.patch_of[neighbours.ravel()], here)
        count = len(self.areas)
        pairs = np.unique((here * count + there)[here != there])
        return np.searchsorted(pairs, np.arange(count + 1) * count), pairs % count

    def triangles(self) -> tuple[Indices, Indices]:
        """Return (starts, triangles): patch p has `triangles[starts[p]:starts[p + 1]]`."""
        members = np.argsort(self.patch_of, kind="stable")
        return np.searchsorted(self.patch_of[members], np.arange(len(self.areas) + 1)), members


def _facets(mesh: _Mesh, patches: _Patches, settings: FacetSettings) -> Iterator[Facet]:
    starts, others = patches.adjacency(mesh.neighbours)
    least_cosine = math.cos(settings.largest_angle - _ANGLE_ROUNDING)
    bounds, members = _grow_facets(patches.order, patches.normals, starts, others, least_cosine)
    areas = np.add.reduceat(patches.areas[members], bounds[:-1]) if len(members) else np.empty(0)
    first, triangles = patches.triangles()
    inside = np.zeros(len(mesh.faces), dtype=bool)
    for k in np.flatnonzero(areas >= settings.least_area):
        grown = members[bounds[k] : bounds[k + 1]]
        chosen = np.concatenate([triangles[first[p] : first[p + 1]] for p in grown])
        inside[chosen] = True
        yield _facet(mesh, patches, chosen, inside, settings.coplanar)
        inside[chosen] = False


def _facet(mesh: _Mesh, patches: _Patches, triangles: Indices, inside: NDArray[np.bool_], coplanar: float) -> Facet:
    """Assemble the facet of triangles (k,), of which the first belongs to the seed."""
    normals = patches.normals[patches.patch_of[triangles]]
    normal, areas = normals[0], mesh.areas[triangles]
    corners = mesh.vertices[mesh.faces[triangles]]
    centroid = areas @ corners.mean(axis=1) / areas.sum()
    seed = patches.patch_of[triangles] == patches.patch_of[triangles[0]]
    level = float(np.average(corners[seed].mean(axis=1) @ normal, weights=areas[seed]))
    origin = centroid + (level - float(centroid @ normal)) * normal
    # The patch's plane was its largest triangle's, the mean's may be once more as far away.
    flat = bool(np.abs(corners @ normal - level).max() <= 2.0 * coplanar)
    loops = tuple(mesh.vertices[loop] for loop in _border_loops(mesh, triangles, inside))
    loops = tuple(_without_straight_corners(loop) for loop in loops)
    R = frame_from_z(normal, _longest_side(loops, normal))
    return Facet(transform(R, origin), float(areas.sum()), triangles, normals, flat, loops)


def _border_loops(mesh: _Mesh, triangles: Indices, inside: NDArray[np.bool_]) -> list[list[int]]:
    """Chain the sides without a neighbour inside to closed loops of vertex numbers that visit no vertex twice."""
    beyond = mesh.neighbours[triangles]
    rows, sides = np.nonzero((beyond < 0) | ~inside[beyond])
    tails, heads = mesh.faces[triangles[rows], sides], mesh.faces[triangles[rows], (sides + 1) % 3]
    following: dict[int, list[int]] = {}
    for tail, head in sorted(zip(tails.tolist(), heads.tolist(), strict=True), reverse=True):
        following.setdefault(tail, []).append(head)
    loops: list[list[int]] = []
    for start in sorted(following):
        while following[start]:
            loops += _walk(start, following)
    return loops


def _walk(start: int, following: dict[int, list[int]]) -> Iterator[list[int]]:
    """Follow sides from a vertex until they return to it; where the way crosses itself, a loop is split off.

    Every triangle is a closed way itself, so as many sides end at a vertex as begin there.
    """
    way, place = [start], {start: 0}
    while way:
        vertex = following[way[-1]].pop()
        if vertex not in place:
            place[vertex] = len(way)
            way.append(vertex)
            continue
        loop = way[place[vertex] :]
        for passed in loop:
            del place[passed]
        del way[-len(loop) :]
        yield loop
        if way:
            place[vertex] = len(way)
            way.append(vertex)


def _without_straight_corners(loop: Array) -> Array:
    """Drop the corners of an (n, 3) loop at which it does not turn."""
    before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    lengths = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
    turns = np.linalg.norm(np.cross(before, after), axis=1) > _STRAIGHT * lengths[0] * lengths[1]
    # A needle's point turns back on itself and stays.
    back = np.einsum("ij,ij->i", before, after) < 0.0
    kept = (turns | back) & (lengths[0] > _NO_LENGTH)
    return loop[kept] if kept.sum() >= 3 else loop


def _longest_side(loops: tuple[Array, ...], normal: Array) -> Array:
    """Return the (3,) direction of the longest straight piece of the border, square to the normal."""
    sides = np.concatenate([np.roll(loop, -1, axis=0) - loop for loop in loops]) if loops else np.empty((0, 3))
    sides = sides - np.outer(sides @ normal, normal)
    lengths = np.linalg.norm(sides, axis=1)
    if len(sides) == 0 or lengths.max() < _NO_LENGTH:
        return np.eye(3)[int(np.argmin(np.abs(normal)))]
    return sides[_by_falling_size(lengths, np.arange(len(lengths)))[0]]


def _by_falling_size(sizes: Array, ties: Indices) -> Indices:
    """Return the order (n,) of falling size; of equal ones, up to rounding, the lower tie comes first."""
    largest = sizes.max(initial=0.0)
    if largest <= 0.0:
        return np.argsort(ties)
    steps = np.round(_TIE * np.log(np.maximum(sizes / largest, 1e-30)))
    return np.lexsort((ties, -steps))


@njit(cache=True, nogil=True)
def _grow_patches(
    vertices: Array,
    faces: Indices,
    units: Array,
    thin: NDArray[np.bool_],
    neighbours: Indices,
    seeds: Indices,
    coplanar: float,
) -> Indices:
    """Flood every plane from its largest triangle; return the patch of each triangle (m,).

    A triangle belongs to the plane when its three corners are in it; its normal decides only which side it faces.
    """
    patch_of = np.full(len(faces), -1, dtype=np.int64)
    stack = np.empty(len(faces), dtype=np.int64)
    patch = 0
    for seed in seeds:
        if patch_of[seed] >= 0:
            continue
        nx, ny, nz = units[seed]
        corner = vertices[faces[seed, 0]]
        level = corner[0] * nx + corner[1] * ny + corner[2] * nz
        patch_of[seed] = patch
        stack[0] = seed
        size = 1
        while size > 0:
            size -= 1
            face = stack[size]
            for side in range(3):
                other = neighbours[face, side]
                if other < 0 or patch_of[other] >= 0:
                    continue
                facing = units[other, 0] * nx + units[other, 1] * ny + units[other, 2] * nz
                if facing <= 0.0 and not thin[other]:
                    continue
                joins = True
                for k in range(3):
                    v = vertices[faces[other, k]]
                    joins = joins and abs(v[0] * nx + v[1] * ny + v[2] * nz - level) <= coplanar
                if joins:
                    patch_of[other] = patch
                    stack[size] = other
                    size += 1
        patch += 1
    return patch_of


@njit(cache=True, nogil=True)
def _grow_facets(
    order: Indices, normals: Array, starts: Indices, others: Indices, least_cosine: float
) -> tuple[Indices, Indices]:
    """Grow a facet from every patch, in order, that no earlier facet covers.

    Returns:
        (bounds, members): facet k has the patches `members[bounds[k]:bounds[k + 1]]`, its seed first.
    """
    covered = np.zeros(len(order), dtype=np.bool_)
    reached = np.full(len(order), -1, dtype=np.int64)
    members = np.empty(2 * len(order), dtype=np.int64)
    bounds = np.zeros(len(order) + 1, dtype=np.int64)
    facet, end = 0, 0
    for seed in order:
        n = normals[seed]
        if covered[seed] or (n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0):
            continue
        if end + len(order) > len(members):
            members = np.concatenate((members, np.empty(len(members), dtype=np.int64)))
        first = end
        members[end] = seed
        end += 1
        reached[seed] = facet
        at = first
        while at < end:
            patch = members[at]
            at += 1
            covered[patch] = True
            m = normals[patch]
            for k in range(starts[patch], starts[patch + 1]):
                other = others[k]
                w = normals[other]
                to_seed = w[0] * n[0] + w[1] * n[1] + w[2] * n[2]
                to_neighbour = w[0] * m[0] + w[1] * m[1] + w[2] * m[2]
                if reached[other] < facet and to_seed > least_cosine and to_neighbour > least_cosine:
                    reached[other] = facet
                    members[end] = other
                    end += 1
        facet += 1
        bounds[facet] = end
    return bounds[: facet + 1], members[:end]
