"""Where two parallel pads meet a solid: antipodal pairs of contacts on any closed surface.

For each direction that some of the surface faces, lines along it are laid through the solid on a fine grid. A line
that runs through the solid between two places that face it, one from either side, is a way to close two pads; it
holds if enough of the surface around both ends is as high as the ends, so that the pads lie on it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planners.errors import LiftwrightError
from planners.geometry.pose import Array, Transform, frame_from_z


@dataclass(frozen=True)
class PadContactSettings:
    """Which pairs of contacts count, and how densely they are kept."""

    grid: float = 0.002
    """Between the lines that are tried [m]; our choice."""
    spacing: float = 0.016
    """Least distance between two kept pairs that close along nearly the same axis [m]; our choice."""
    axis_spacing: float = math.radians(40.0)
    """Closing axes that differ by less are nearly the same [rad]; our choice."""
    facing: float = math.radians(10.0)
    """Largest angle between a pad's normal and the surface's: the two normals are then 160 degrees apart or more, which
    the authors call antipodal [rad]."""
    facing_step: float = math.radians(2.0)
    """Pairs that face their pads better by less than this rank alike [rad]; our choice."""
    patch_radius: float = 0.005
    """Of the disc about a contact that has to lie on the pad [m]; our choice, below the 7.5 mm that a soft finger's
    friction torque stands for."""
    patch_share: float = 0.6
    """Least share of that disc, at both ends: a rod of 10 mm is just held; our choice."""
    compliance: float = 0.0005
    """How far below the contact the surface still lies on the pad, which is rubber [m]; our choice."""
    pad_radius: float = 0.0185
    """What the pads cover within this radius ranks the pairs: half a pad's length [m]."""
    most_off_centre: float = 0.006
    """Farthest that the middle of what the pads cover within that radius may be off theirs [m]: no pad holds by its
    edge alone, as at a corner; our choice."""
    most_axes: int = 24
    """Directions that are tried, those that most of the surface faces first; our choice."""

    def __post_init__(self) -> None:
        lengths = (self.grid, self.spacing, self.patch_radius, self.pad_radius)
        if min(lengths) <= 0.0 or self.most_axes < 1 or not 0.0 < self.patch_share <= 1.0:
            raise LiftwrightError("pad contacts have positive lengths and counts, and a share between 0 and 1")


@dataclass(frozen=True, eq=False)
class PadContacts:
    """Pairs of contacts, in the frame of the body."""

    midpoints: Array
    """(n, 3) midway between the two contacts [m]."""
    axes: Array
    """(n, 3) unit vectors from one contact to the other."""
    widths: Array
    """(n,) distance of the two contacts [m]."""

    def __len__(self) -> int:
        return len(self.widths)

    def only(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> PadContacts:
        """Return some of the pairs."""
        return PadContacts(self.midpoints[rows], self.axes[rows], self.widths[rows])

    def behind(self, T_body_pads: Transform, least: float, most: float, aside: float) -> int | None:
        """Return the number of the pair that is farthest behind two pads, None where none is.

        Args:
            T_body_pads: (4, 4) midway between the pads: y along their closing axis, z away from what is behind.
            least: distance behind [m].
            most: likewise [m].
            aside: farthest distance to the side, along x [m].
        """
        near = np.array(sorted(self._tree.query_ball_point(T_body_pads[:3, 3], most + aside)), dtype=np.int64)
        near = near[np.abs(self.axes[near] @ T_body_pads[:3, 1]) > _SAME_AXIS]
        x, y, z = ((self.midpoints[near] - T_body_pads[:3, 3]) @ T_body_pads[:3, :3]).round(_DIGITS).T
        good = (-z >= least) & (-z <= most) & (np.abs(x) <= aside) & (np.abs(y) <= aside)
        # What is as far to either side is told apart by the pads' own axes: mirrored pads find the mirrored pair.
        rows = np.lexsort((x[good], np.abs(x[good]), z[good]))
        return int(near[good][rows[0]]) if len(rows) else None

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.midpoints)


_SAME_AXIS = 1.0 - 1e-6
"""Cosine of the angle between closing axes that are one."""
_DIGITS = 5
"""Distances are compared to a hundredth of a millimetre: what the lines are shifted by decides nothing."""


@dataclass(frozen=True, eq=False)
class _Found:
    """Pairs that close along one axis, with what ranks them."""

    midpoints: Array
    """(m, 3) [m]"""
    widths: Array
    """(m,) [m]"""
    tilt: Array
    """(m,) greatest angle between a pad and the surface [rad]."""
    off_centre: Array
    """(m,) from the middle of what the pads cover [m]."""


@dataclass(frozen=True, eq=False)
class _Lines:
    """Parallel lines through a solid: the stretches of each that lie inside."""

    R_body_lines: Array
    """(3, 3) z along the lines."""
    origin: Array
    """(2,) of the grid, in x and y of the lines' frame [m]."""
    pitch: Array
    """(2,) between lines, along x and along y [m]."""
    first: NDArray[np.int64]
    """(nx, ny + 1) places of each line's stretches in the list: row i from first[i, j] up to first[i, j + 1]."""
    stretches: Array
    """(m, 4) entry and exit [m], and the cosines between the axis and the surface's normals there, positive where
    they face the pads."""
    cells: NDArray[np.int64]
    """(m, 2) line of each stretch."""


def spread(contacts: PadContacts, settings: PadContactSettings) -> PadContacts:
    """Return those of many pairs that keep their distance; those that come first are kept."""
    spacing, cosine = settings.spacing - 1e-6, math.cos(settings.axis_spacing)
    return contacts.only(_apart(contacts.midpoints, contacts.axes, spacing, cosine))


def all_pad_contacts(
    vertices: Array, faces: NDArray[np.integer], width_max: float, settings: PadContactSettings
) -> PadContacts:
    """Find all pairs of contacts of two parallel pads on a closed surface, on the grid of lines along each axis.

    Args:
        vertices: (n, 3) [m].
        faces: (m, 3) corners of triangles, outward. Several closed surfaces may touch or overlap.
        width_max: largest distance between two contacts [m].
        settings: which pairs count.

    Returns:
        Pairs, those first that face their pads best and are best centred.
    """
    corners = np.ascontiguousarray(np.asarray(vertices, dtype=float)[np.asarray(faces, dtype=np.int64)])
    axes = _facing_axes(corners, settings)
    found = [_along(corners, axis, width_max, settings) for axis in axes]
    axes = np.repeat(axes, [len(each.widths) for each in found], axis=0)
    midpoints = np.vstack([each.midpoints for each in found])
    widths = np.concatenate([each.widths for each in found])
    tilt, off_centre = (np.concatenate([getattr(each, name) for each in found]) for name in ("tilt", "off_centre"))
    aside = np.abs(midpoints[:, 1] - 0.5 * (corners[..., 1].min() + corners[..., 1].max()))
    # What differs by less than a step decides nothing: such pairs come in the order of axes and lines, those in the
    # middle between the body's left and right first, so that not only one of two mirror images is kept.
    facing = np.floor(tilt / settings.facing_step + _ROUNDING)
    centred, middle = ((each / (0.5 * settings.grid)).round() for each in (off_centre, aside))
    order = np.lexsort((np.arange(len(tilt)), middle, centred, facing))
    return PadContacts(midpoints[order], axes[order], widths[order])


_ROUNDING = 1e-6
_SAME_IMAGE = 1e-3
"""Vectors whose components differ by less are one."""
_REFLECTIONS = np.array([[1.0, -1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, -1.0]])


def _facing_axes(corners: Array, settings: PadContactSettings) -> Array:
    """Return unit vectors (k, 3) along which the surface is faced, by the area that faces them, without their sense.

    Mirror images of one another in a plane of the body's frame are taken together, so that a symmetric body has
    symmetric axes: those of a round one could begin anywhere.
    """
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    solid = areas > 1e-12
    normals, areas = normals[solid] / areas[solid, None], areas[solid]
    axes: list[Array] = []
    while len(areas) and len(axes) < settings.most_axes:
        _, groups = np.unique(_without_sense(normals).round(3), axis=0, return_inverse=True)
        faced = np.bincount(groups.ravel(), weights=areas).round(9)
        group = int(np.argmax(faced))
        axis = _without_sense(normals[groups.ravel() == group])[0]
        found = [axis]
        for image in _without_sense(axis * _REFLECTIONS):
            same = np.abs(_without_sense(normals) - image).max(axis=1) < _SAME_IMAGE
            if np.abs(np.array(found) - image).max(axis=1).min() > _SAME_IMAGE and same.any():
                alike = faced[groups.ravel()[np.argmax(same)]] == faced[group]
                found += [image] if alike else []
        axes += found
        other = (np.abs(normals @ np.array(found).T) < math.cos(0.5 * settings.facing)).all(axis=1)
        normals, areas = normals[other], areas[other]
    return np.array(axes[: settings.most_axes]).reshape(-1, 3)


def _without_sense(vectors: Array) -> Array:
    """Turn vectors round whose last component that is not zero is negative."""
    rounded = vectors.round(6)
    last = np.where(rounded[:, 2] != 0.0, rounded[:, 2], np.where(rounded[:, 1] != 0.0, rounded[:, 1], rounded[:, 0]))
    return vectors * np.where(last < 0.0, -1.0, 1.0)[:, None]


def _along(corners: Array, axis: Array, width_max: float, settings: PadContactSettings) -> _Found:
    """Find the pairs that close along one axis."""
    lines = _lay_lines(corners, axis, settings.grid)
    reach = round(settings.pad_radius / settings.grid)
    ends, off_centre = _settle(
        lines.first, lines.stretches, lines.cells, settings.grid, (settings.patch_radius, settings.patch_share),
        settings.compliance, reach,
    )  # fmt: skip
    width = ends[:, 1] - ends[:, 0]
    facing = (lines.stretches[:, 2:] >= math.cos(settings.facing)).all(axis=1)
    good = facing & (off_centre <= settings.most_off_centre) & (width <= width_max)
    across = lines.origin + lines.pitch * lines.cells[good]
    local = np.column_stack([across, ends[good].mean(axis=1)])
    tilt = np.arccos(np.clip(lines.stretches[good, 2:].min(axis=1), -1.0, 1.0))
    return _Found(local @ lines.R_body_lines.T, width[good], tilt, off_centre[good])


def _lay_lines(corners: Array, axis: Array, grid: float) -> _Lines:
    hint = np.eye(3)[int(np.argmin(np.abs(axis).round(6)))] if abs(axis[2]) > 0.9 else np.array([0.0, 0.0, 1.0])
    R = frame_from_z(axis, hint)
    local = corners @ R
    low, high = local[..., :2].min(axis=(0, 1)), local[..., :2].max(axis=(0, 1))
    # The grid is centred on the solid, so that a symmetric one is met symmetrically; and shifted by a hair, so that
    # no line runs along the edge between two triangles.
    pitch = np.array([grid, grid])
    sideways = abs(R[1, 1]) > _ALONG_Y
    if sideways:
        # Between left and right there is a line in the middle, and those on borders are both outside.
        pitch[1] *= 1.0 + _WIDENING
    steps = np.floor((high - low) / pitch).astype(np.int64)
    steps[1] -= steps[1] % 2 if sideways else 0
    origin = 0.5 * (low + high - pitch * steps) + np.array([1.3e-7, 2.9e-7])
    counts = np.zeros(int(np.prod(steps + 1)), np.int64)
    _rasterise(local, origin, pitch, steps + 1, counts, np.empty((0, 2)), False)
    first = np.concatenate([[0], np.cumsum(counts)])
    crossings = np.empty((int(first[-1]), 2))
    _rasterise(local, origin, pitch, steps + 1, first[:-1].copy(), crossings, True)
    stretches, owners = _inside(first, crossings)
    per_line = np.concatenate([[0], np.cumsum(np.bincount(owners, minlength=counts.size))])
    rows = np.arange(steps[0] + 1)[:, None] * (steps[1] + 1) + np.arange(steps[1] + 2)[None, :]
    cells = np.column_stack(np.divmod(owners, steps[1] + 1))
    return _Lines(R, origin, pitch, np.ascontiguousarray(per_line[rows]), stretches, np.ascontiguousarray(cells))


@njit(cache=True, nogil=True)
def _rasterise(local, origin, pitch, size, next_place, crossings, listing):
    """Count where lines along z cross triangles and, listing, write it: height, and the normal's z component.

    `next_place` (lines,) are counts to go up, or places in the list, which go up too.
    """
    for t in range(local.shape[0]):
        ax, ay, az = local[t, 0, 0], local[t, 0, 1], local[t, 0, 2]
        bx, by, bz = local[t, 1, 0], local[t, 1, 1], local[t, 1, 2]
        cx, cy, cz = local[t, 2, 0], local[t, 2, 1], local[t, 2, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        nx = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
        ny = (bz - az) * (cx - ax) - (bx - ax) * (cz - az)
        cosine = area / math.sqrt(nx * nx + ny * ny + area * area)
        i_first = max(0, math.ceil((min(ax, bx, cx) - origin[0]) / pitch[0]))
        i_last = min(size[0] - 1, math.floor((max(ax, bx, cx) - origin[0]) / pitch[0]))
        j_first = max(0, math.ceil((min(ay, by, cy) - origin[1]) / pitch[1]))
        j_last = min(size[1] - 1, math.floor((max(ay, by, cy) - origin[1]) / pitch[1]))
        for i in range(i_first, i_last + 1):
            x = origin[0] + pitch[0] * i
            for j in range(j_first, j_last + 1):
                y = origin[1] + pitch[1] * j
                u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                line = i * size[1] + j
                if listing:
                    crossings[next_place[line], 0] = u * az + v * bz + w * cz
                    crossings[next_place[line], 1] = cosine
                next_place[line] += 1


_ALONG_Y = 0.999
"""Cosine of the angle between directions along the body's y."""
_WIDENING = 1e-4
"""Part by which lines are farther apart than the grid says, which is more than they are shifted by."""
_MERGED = 1e-5
"""Gaps thinner than this between two parts of a body are none [m]."""


@njit(cache=True, nogil=True)
def _inside(first, crossings):
    """Return the stretches (m, 4) of all lines inside the solid, and their lines (m,).

    A line that leaves more often than it enters met an edge or a hole; it has none.
    """
    stretches = np.empty((crossings.shape[0] // 2 + 1, 4))
    owners = np.empty(crossings.shape[0] // 2 + 1, np.int64)
    count = 0
    for line in range(first.shape[0] - 1):
        start, end = first[line], first[line + 1]
        order = np.argsort(crossings[start:end, 0])
        # The lines run along +z: they enter where the normal's z is negative.
        depth, balance, begun = 0, 0, count
        for k in range(end - start):
            balance += 1 if crossings[start + k, 1] < 0.0 else -1
        if balance != 0:
            continue
        for k in order:
            height, cosine = crossings[start + k, 0], crossings[start + k, 1]
            if cosine < 0.0:
                if depth == 0:
                    if count > begun and height - stretches[count - 1, 1] < _MERGED:
                        count -= 1
                    else:
                        stretches[count, 0], stretches[count, 2] = height, -cosine
                        owners[count] = line
                depth += 1
            else:
                depth -= 1
                if depth == 0:
                    stretches[count, 1], stretches[count, 3] = height, cosine
                    count += 1
        if depth != 0:
            count = begun
    return stretches[:count].copy(), owners[:count].copy()


@njit(cache=True, nogil=True)
def _settle(first, stretches, cells, grid, patch, compliance, reach):
    """Lay two pads on each stretch.

    `patch` is the radius [m] of the disc about an end that has to lie on a pad, and the share of it that has to.

    Returns:
        Where the pads come to lie (m, 2), which is where the surface under them is highest; and how far the middle of
        what they cover is off the line (m,), infinite where too little of a patch lies on a pad.
    """
    count = stretches.shape[0]
    ends, off_centre = np.empty((count, 2)), np.full(count, np.inf)
    for s in range(count):
        entry, leave = stretches[s, 0], stretches[s, 1]
        low, high, near, near_held = entry, leave, 0, 0
        held, x, y = 0, 0.0, 0.0
        for di in range(-reach, reach + 1):
            for dj in range(-reach, reach + 1):
                square = (di * di + dj * dj) * grid * grid
                if square > (reach * grid) ** 2:
                    continue
                close = square <= patch[0] * patch[0]
                near += close
                i, j = cells[s, 0] + di, cells[s, 1] + dj
                if not (0 <= i < first.shape[0] and 0 <= j < first.shape[1] - 1):
                    continue
                for other in range(first[i, j], first[i, j + 1]):
                    below, above = stretches[other, 0], stretches[other, 1]
                    if abs(below - entry) <= compliance and abs(above - leave) <= compliance:
                        held += 1
                        x += di * grid
                        y += dj * grid
                        if close:
                            near_held += 1
                            low, high = min(low, below), max(high, above)
        ends[s, 0], ends[s, 1] = low, high
        if near_held >= patch[1] * near:
            off_centre[s] = math.sqrt(x * x + y * y) / held
    return ends, off_centre


@njit(cache=True, nogil=True)
def _apart(midpoints, axes, spacing, cosine):
    """Choose rows in their order, each away from those chosen before."""
    kept = np.empty(midpoints.shape[0], np.int64)
    count = 0
    for k in range(midpoints.shape[0]):
        free = True
        for c in range(count):
            other = kept[c]
            square = 0.0
            along = 0.0
            for i in range(3):
                square += (midpoints[k, i] - midpoints[other, i]) ** 2
                along += axes[k, i] * axes[other, i]
            if square < spacing * spacing and abs(along) > cosine:
                free = False
                break
        if free:
            kept[count] = k
            count += 1
    return kept[:count].copy()
