"""Points that lie close together, told apart from others without looking at every pair of them."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planners.geometry.pose import Array

_HALF_AROUND = tuple(step for step in itertools.product((-1, 0, 1), repeat=3) if step > (0, 0, 0))
"""Steps from a cube to those around it, one of two opposite ones: the other cube takes that step back."""


def clusters(points: Array, radius: float) -> NDArray[np.int64]:
    """Return the number of the cluster that each of the (n, 3) points is in, counted in order of their first points.

    Points no farther apart than `radius` are in one cluster, and so are all that a chain of such steps leads to. A
    step of a cluster is never longer than 2 sqrt(3) radii; whether one between these two lengths is taken is not
    said. Space is divided into cubes as wide as the radius, and occupied cubes that touch are joined: that costs as
    much as sorting the points, also where they coincide and have n² pairs.

    Args:
        points: finite, at least one, and spread over no more than a million radii.
        radius: positive, in the unit of the points.
    """
    cubes = np.floor((points - points.min(axis=0)) / radius).astype(np.int64)
    # One layer of empty cubes behind the last keeps a step from ending in the next row.
    across = cubes.max(axis=0) + 2
    strides = np.array([across[1] * across[2], across[2], 1])
    occupied, owner = np.unique(cubes @ strides, return_inverse=True)
    ends = np.hstack([_touching(occupied, int(strides @ step)) for step in _HALF_AROUND])
    graph = coo_array((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(len(occupied), len(occupied)))
    _, labels = connected_components(graph, directed=False)
    _, first, number = np.unique(labels[owner], return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number]


def _touching(occupied: NDArray[np.int64], step: int) -> NDArray[np.int64]:
    """Return which of the occupied cubes, sorted, have an occupied one a step away, and which that is: (2, k)."""
    places = np.searchsorted(occupied, occupied + step)
    there = np.flatnonzero(places < len(occupied))
    there = there[occupied[places[there]] == occupied[there] + step]
    return np.stack([there, places[there]])
