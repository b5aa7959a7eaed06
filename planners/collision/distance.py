"""Distance between two convex shapes: GJK on their cores, with certified bounds from both sides.

Gilbert, Johnson, Keerthi, "A fast procedure for computing the distance between complex objects in
three-dimensional space" (1988). A core is the hull of a shape's vertices; the radius that grows it is taken off
afterwards. Every direction that is tried gives a lower bound (the gap between the two support planes), every
simplex an upper bound (the length of its point nearest the origin). A question "farther apart than h?" ends as soon
as either bound answers it, and neither bound leans on the other: a stalled iteration leaves them apart, which
callers read as a collision.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array, Transform, inverse

PairIndices = NDArray[np.int32]

MAX_ITERATIONS = 64
TOLERANCE = 1e-11
"""Bounds closer than this are one number [m]."""
DEGENERATE = 1e-13
"""A tetrahedron whose height over a face, relative to its size, is below this counts as flat."""


class Cores(NamedTuple):
    """The cores of shapes, each in a frame of its own."""

    vertices: Array
    """(v, 3) of all shapes [m]."""
    vertex_range: PairIndices
    """(s, 2), first vertex of a shape and end."""
    normals: Array
    """(n, 3), normals of the faces of all cores, outward."""
    normal_range: PairIndices
    """(s, 2), first normal of a shape and end."""


@njit(cache=True, nogil=True)
def support(vertices: Array, start: int, end: int, x: float, y: float, z: float) -> int:
    """Return the number of the vertex, of `vertices[start:end]` (n, 3), that reaches farthest along (x, y, z)."""
    best = start
    farthest = vertices[start, 0] * x + vertices[start, 1] * y + vertices[start, 2] * z
    for i in range(start + 1, end):
        along = vertices[i, 0] * x + vertices[i, 1] * y + vertices[i, 2] * z
        if along > farthest:
            farthest = along
            best = i
    return best


@njit(cache=True, nogil=True)
def relative_transform(frames: Array, a: int, b: int, T_a_b: Array) -> None:
    """Write the upper three rows of `T_a_b` into (3, 4), from the frames' `T_world_frame` (n, 4, 4)."""
    x = frames[b, 0, 3] - frames[a, 0, 3]
    y = frames[b, 1, 3] - frames[a, 1, 3]
    z = frames[b, 2, 3] - frames[a, 2, 3]
    for i in range(3):
        ax, ay, az = frames[a, 0, i], frames[a, 1, i], frames[a, 2, i]
        for j in range(3):
            T_a_b[i, j] = ax * frames[b, 0, j] + ay * frames[b, 1, j] + az * frames[b, 2, j]
        T_a_b[i, 3] = ax * x + ay * y + az * z


@njit(cache=True, nogil=True)
def _nearest_on_segment(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> tuple[float, float, float, int]:
    """Return the point of segment ab nearest the origin, and which of a (1) and b (2) carry it."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    along = -(ax * ux + ay * uy + az * uz)
    length = ux * ux + uy * uy + uz * uz
    if along <= 0.0:
        return ax, ay, az, 1
    if along >= length:
        return bx, by, bz, 2
    t = along / length
    return ax + t * ux, ay + t * uy, az + t * uz, 3


@njit(cache=True, nogil=True)
def _nearest_on_triangle(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, cx: float, cy: float, cz: float
) -> tuple[float, float, float, int]:
    """Return the point of triangle abc nearest the origin, and which of a (1), b (2), c (4) carry it.

    Ericson, Real-Time Collision Detection, 5.1.5: the Voronoi regions in turn.
    """
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    d1 = -(ux * ax + uy * ay + uz * az)
    d2 = -(vx * ax + vy * ay + vz * az)
    if d1 <= 0.0 and d2 <= 0.0:
        return ax, ay, az, 1
    d3 = -(ux * bx + uy * by + uz * bz)
    d4 = -(vx * bx + vy * by + vz * bz)
    if d3 >= 0.0 and d4 <= d3:
        return bx, by, bz, 2
    d5 = -(ux * cx + uy * cy + uz * cz)
    d6 = -(vx * cx + vy * cy + vz * cz)
    if d6 >= 0.0 and d5 <= d6:
        return cx, cy, cz, 4
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = nx * nx + ny * ny + nz * nz
    inside_c = d1 * d4 - d3 * d2
    inside_b = d5 * d2 - d1 * d6
    inside_a = d3 * d6 - d5 * d4
    if inside_a > 0.0 and inside_b > 0.0 and inside_c > 0.0 and area > 0.0:
        # Through the normal rather than the weights: the direction stays sharp when the origin is far away.
        t = (nx * ax + ny * ay + nz * az) / area
        return t * nx, t * ny, t * nz, 7
    px, py, pz, mask = _nearest_on_segment(ax, ay, az, bx, by, bz)
    least = px * px + py * py + pz * pz
    qx, qy, qz, which = _nearest_on_segment(ax, ay, az, cx, cy, cz)
    square = qx * qx + qy * qy + qz * qz
    if square < least:
        px, py, pz, least = qx, qy, qz, square
        mask = (which & 1) | ((which & 2) << 1)
    qx, qy, qz, which = _nearest_on_segment(bx, by, bz, cx, cy, cz)
    square = qx * qx + qy * qy + qz * qz
    if square < least:
        px, py, pz = qx, qy, qz
        mask = which << 1
    return px, py, pz, mask


@njit(cache=True, nogil=True)
def _faces_origin(simplex: Array, i: int, j: int, k: int, apex: int) -> bool:
    """Say whether the origin lies beyond face ijk, seen from the apex, or the tetrahedron is too flat to tell."""
    ax, ay, az = simplex[i, 0], simplex[i, 1], simplex[i, 2]
    ux, uy, uz = simplex[j, 0] - ax, simplex[j, 1] - ay, simplex[j, 2] - az
    vx, vy, vz = simplex[k, 0] - ax, simplex[k, 1] - ay, simplex[k, 2] - az
    wx, wy, wz = simplex[apex, 0] - ax, simplex[apex, 1] - ay, simplex[apex, 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    height = nx * wx + ny * wy + nz * wz
    size = math.sqrt((nx * nx + ny * ny + nz * nz) * (wx * wx + wy * wy + wz * wz))
    if abs(height) <= DEGENERATE * size:
        return True
    return -(nx * ax + ny * ay + nz * az) * height < 0.0


@njit(cache=True, nogil=True)
def _nearest_on_tetrahedron(simplex: Array) -> tuple[float, float, float, int]:
    """Return the point of the tetrahedron nearest the origin (the origin and 15 when it is inside)."""
    px, py, pz, mask = 0.0, 0.0, 0.0, 15
    least = math.inf
    for face in range(4):
        i, j, k = (1 if face == 0 else 0), (1 if face > 1 else 2), (2 if face == 3 else 3)
        if _faces_origin(simplex, i, j, k, face):
            qx, qy, qz, which = _nearest_on_triangle(
                simplex[i, 0],
                simplex[i, 1],
                simplex[i, 2],
                simplex[j, 0],
                simplex[j, 1],
                simplex[j, 2],
                simplex[k, 0],
                simplex[k, 1],
                simplex[k, 2],
            )
            square = qx * qx + qy * qy + qz * qz
            if square < least:
                least = square
                px, py, pz = qx, qy, qz
                mask = ((which & 1) << i) | (((which >> 1) & 1) << j) | (((which >> 2) & 1) << k)
    return px, py, pz, mask


@njit(cache=True, nogil=True)
def _nearest_on_simplex(simplex: Array, count: int) -> tuple[float, float, float, int]:
    """Return the point of `count` vertices of (4, 3) nearest the origin, and a bit for each that carries it."""
    ax, ay, az = simplex[0, 0], simplex[0, 1], simplex[0, 2]
    if count == 1:
        return ax, ay, az, 1
    bx, by, bz = simplex[1, 0], simplex[1, 1], simplex[1, 2]
    if count == 2:
        return _nearest_on_segment(ax, ay, az, bx, by, bz)
    if count == 3:
        return _nearest_on_triangle(ax, ay, az, bx, by, bz, simplex[2, 0], simplex[2, 1], simplex[2, 2])
    return _nearest_on_tetrahedron(simplex)


@njit(cache=True, nogil=True)
def _keep(simplex: Array, count: int, mask: int) -> int:
    """Move the vertices named by `mask` to the front; return how many they are."""
    kept = 0
    for i in range(count):
        if (mask >> i) & 1:
            if kept != i:
                simplex[kept, 0] = simplex[i, 0]
                simplex[kept, 1] = simplex[i, 1]
                simplex[kept, 2] = simplex[i, 2]
            kept += 1
    return kept


@njit(cache=True, nogil=True)
def _holds(simplex: Array, count: int, x: float, y: float, z: float) -> bool:
    for i in range(count):
        if simplex[i, 0] == x and simplex[i, 1] == y and simplex[i, 2] == z:
            return True
    return False


@njit(cache=True, nogil=True)
def core_bounds(
    cores: Cores, a: int, b: int, T_a_b: Array, near: float, far: float, axis: Array, simplex: Array
) -> tuple[float, float]:
    """Bound the distance between two cores from below and above, as sharply as the question needs.

    The question is which of three holds: at most `near`, more than `far`, or in between. With near = -inf and
    far = nan no answer is good enough, and the bounds close in on the distance itself.

    Args:
        cores: of all shapes.
        a: one shape.
        b: the other.
        T_a_b: (3, 4), b's frame in a's.
        near: no need to look closer than this [m].
        far: no need to look farther than this [m].
        axis: (3,) unit vector in a's frame from a towards b that is tried first; the best one found is written back.
        simplex: (4, 3) work space.

    Returns:
        (lower, upper): the distance lies between them. `lower` is negative while no plane parts the cores.
    """
    vertices = cores.vertices
    a_start, a_end = cores.vertex_range[a, 0], cores.vertex_range[a, 1]
    b_start, b_end = cores.vertex_range[b, 0], cores.vertex_range[b, 1]
    nx, ny, nz = axis[0], axis[1], axis[2]
    lower, upper = -math.inf, math.inf
    count = int(np.int64(0))
    for _ in range(MAX_ITERATIONS):
        i = support(vertices, a_start, a_end, nx, ny, nz)
        j = support(
            vertices,
            b_start,
            b_end,
            -(T_a_b[0, 0] * nx + T_a_b[1, 0] * ny + T_a_b[2, 0] * nz),
            -(T_a_b[0, 1] * nx + T_a_b[1, 1] * ny + T_a_b[2, 1] * nz),
            -(T_a_b[0, 2] * nx + T_a_b[1, 2] * ny + T_a_b[2, 2] * nz),
        )
        bx, by, bz = vertices[j, 0], vertices[j, 1], vertices[j, 2]
        x = T_a_b[0, 0] * bx + T_a_b[0, 1] * by + T_a_b[0, 2] * bz + T_a_b[0, 3] - vertices[i, 0]
        y = T_a_b[1, 0] * bx + T_a_b[1, 1] * by + T_a_b[1, 2] * bz + T_a_b[1, 3] - vertices[i, 1]
        z = T_a_b[2, 0] * bx + T_a_b[2, 1] * by + T_a_b[2, 2] * bz + T_a_b[2, 3] - vertices[i, 2]
        gap = nx * x + ny * y + nz * z
        if gap > lower:
            lower = gap
            axis[0], axis[1], axis[2] = nx, ny, nz
        if lower > far or (lower > near and upper <= far) or upper - lower <= TOLERANCE:
            break
        if _holds(simplex, count, x, y, z):
            break
        simplex[count, 0], simplex[count, 1], simplex[count, 2] = x, y, z
        x, y, z, mask = _nearest_on_simplex(simplex, count + 1)
        count = _keep(simplex, count + 1, mask)
        length = math.sqrt(x * x + y * y + z * z)
        if length >= upper:
            break
        upper = length
        if upper <= near or upper <= TOLERANCE:
            break
        nx, ny, nz = x / length, y / length, z / length
    return lower, upper


@njit(cache=True, nogil=True)
def _gap_along(cores: Cores, a: int, b: int, T_a_b: Array, x: float, y: float, z: float) -> float:
    """Return the gap of cores a and b along the unit vector (x, y, z) of a's frame [m]; negative where they overlap."""
    vertices = cores.vertices
    i = support(vertices, cores.vertex_range[a, 0], cores.vertex_range[a, 1], x, y, z)
    local_x = T_a_b[0, 0] * x + T_a_b[1, 0] * y + T_a_b[2, 0] * z
    local_y = T_a_b[0, 1] * x + T_a_b[1, 1] * y + T_a_b[2, 1] * z
    local_z = T_a_b[0, 2] * x + T_a_b[1, 2] * y + T_a_b[2, 2] * z
    j = support(vertices, cores.vertex_range[b, 0], cores.vertex_range[b, 1], -local_x, -local_y, -local_z)
    near_b = local_x * vertices[j, 0] + local_y * vertices[j, 1] + local_z * vertices[j, 2]
    far_a = x * vertices[i, 0] + y * vertices[i, 1] + z * vertices[i, 2]
    return near_b + x * T_a_b[0, 3] + y * T_a_b[1, 3] + z * T_a_b[2, 3] - far_a


@njit(cache=True, nogil=True)
def face_gap(cores: Cores, a: int, b: int, T_a_b: Array, lower: float, enough: float, axis: Array) -> float:
    """Sharpen a lower bound on the gap of overlapping cores by the normals of their faces.

    A bound of -d says that moving b by d parts them. Pairs of edges are not tried, so the bound may be too low.

    Args:
        cores: of all shapes.
        a: one shape.
        b: the other.
        T_a_b: (3, 4), b's frame in a's.
        lower: what is known already [m].
        enough: no need to look for a larger one [m].
        axis: (3,), receives the direction of the bound returned.
    """
    normals, normal_range = cores.normals, cores.normal_range
    for i in range(normal_range[a, 0], normal_range[a, 1]):
        if lower > enough:
            return lower
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        gap = _gap_along(cores, a, b, T_a_b, x, y, z)
        if gap > lower:
            lower = gap
            axis[0], axis[1], axis[2] = x, y, z
    for i in range(normal_range[b, 0], normal_range[b, 1]):
        if lower > enough:
            return lower
        x = -(T_a_b[0, 0] * normals[i, 0] + T_a_b[0, 1] * normals[i, 1] + T_a_b[0, 2] * normals[i, 2])
        y = -(T_a_b[1, 0] * normals[i, 0] + T_a_b[1, 1] * normals[i, 1] + T_a_b[1, 2] * normals[i, 2])
        z = -(T_a_b[2, 0] * normals[i, 0] + T_a_b[2, 1] * normals[i, 1] + T_a_b[2, 2] * normals[i, 2])
        gap = _gap_along(cores, a, b, T_a_b, x, y, z)
        if gap > lower:
            lower = gap
            axis[0], axis[1], axis[2] = x, y, z
    return lower


def distance(shape_a: ConvexShape, T_world_a: Transform, shape_b: ConvexShape, T_world_b: Transform) -> float:
    """Return how far apart two placed shapes are [m]; at most 0 where they touch or overlap.

    The value is the certified lower bound, within 1e-9 of the distance. Depth of penetration is not measured.
    """
    vertices = np.ascontiguousarray(np.vstack([shape_a.vertices, shape_b.vertices]), dtype=float)
    split = len(shape_a.vertices)
    ranges = np.array([[0, split], [split, len(vertices)]], dtype=np.int32)
    cores = Cores(vertices, ranges, np.empty((0, 3)), np.zeros((2, 2), dtype=np.int32))
    T_a_b, axis = np.ascontiguousarray((inverse(T_world_a) @ T_world_b)[:3]), np.array([1.0, 0.0, 0.0])
    lower, upper = core_bounds(cores, 0, 1, T_a_b, -math.inf, math.nan, axis, np.empty((4, 3)))
    core = max(lower, 0.0) if upper > TOLERANCE else 0.0
    return core - shape_a.radius - shape_b.radius
