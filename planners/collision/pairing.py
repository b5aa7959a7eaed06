"""The pair lists of a scene: which shapes are compared, how closely, and what moves them against each other."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.collision.distance import PairIndices
from planners.collision.kernel import STILL
from planners.geometry.pose import Array


@njit(cache=True, nogil=True)
def choose_pairs(shape_pairs: PairIndices, pair_bodies: PairIndices, chosen: NDArray[np.bool_]) -> PairIndices:
    """Return the rows of `shape_pairs` whose body pair is chosen."""
    rows = np.empty(len(shape_pairs), np.int32)
    count = 0
    for row in range(len(shape_pairs)):
        if chosen[pair_bodies[row]]:
            rows[count] = row
            count += 1
    return rows[:count].copy()


@njit(cache=True, nogil=True)
def pair_columns(shape_pairs: PairIndices, rows: PairIndices, drivers: PairIndices) -> PairIndices:
    """Return `CollisionKernel.pairs` of the chosen rows, for what drives each shape (`CollisionKernel.drivers`).

    On one arm only the joints between two shapes move them against each other, so the farther one's travel against
    the nearer one's frame counts. An upright shape turns against its arm: it and the other are measured from the base.
    """
    pairs = np.full((len(rows), 4), STILL, np.int32)
    for k in range(len(rows)):
        a, b = shape_pairs[rows[k], 0], shape_pairs[rows[k], 1]
        pairs[k, 0], pairs[k, 1] = a, b
        one_arm = drivers[a, 0] == drivers[b, 0] and drivers[a, 2] == 0 and drivers[b, 2] == 0
        if one_arm:
            if drivers[a, 1] > drivers[b, 1]:
                pairs[k, 2] = drivers[b, 1]
            elif drivers[b, 1] > drivers[a, 1]:
                pairs[k, 3] = drivers[a, 1]
            continue
        if drivers[a, 0] >= 0:
            pairs[k, 2] = 0
        if drivers[b, 0] >= 0:
            pairs[k, 3] = 0
    return pairs


@njit(cache=True, nogil=True)
def pair_margins(
    rows: PairIndices, pair_bodies: PairIndices, body_margins: Array, shape_pairs: PairIndices, spheres: Array
) -> tuple[Array, Array]:
    """Return `CollisionKernel.margin` and `.reach` of the chosen rows, for the margins of the body pairs [m]."""
    margin, reach = np.empty((len(rows), 2)), np.empty(len(rows))
    for k in range(len(rows)):
        row = rows[k]
        keep = body_margins[pair_bodies[row]]
        margin[k, 0], margin[k, 1] = keep, min(keep, 0.0)
        reach[k] = spheres[shape_pairs[row, 0], 3] + spheres[shape_pairs[row, 1], 3] + keep
    return margin, reach


@njit(cache=True, nogil=True)
def used_shapes(pairs: PairIndices, drivers: PairIndices, n_arms: int) -> tuple[PairIndices, PairIndices]:
    """Return the shapes (k,) that pairs (p, 4) name, and for each arm (n_arms,) whether it moves one of them."""
    used, arms = np.zeros(len(drivers), np.int32), np.zeros(n_arms, np.int32)
    for k in range(len(pairs)):
        used[pairs[k, 0]] = used[pairs[k, 1]] = 1
    shapes = np.flatnonzero(used).astype(np.int32)
    for shape in shapes:
        if drivers[shape, 0] >= 0:
            arms[drivers[shape, 0]] = 1
    return shapes, arms
