"""Samples of a motion that are close enough together, so that what is shown at them tells of all of it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from planners.geometry.pose import Array


def spent_on_the_way(poses: Array, centres: Array, turn: float, way: float) -> Array:
    """Return what a body has turned and gone up to each sample, there and back added up, as shares of what it may.

    Args:
        poses: (n, 4, 4) of the body.
        centres: (n, 3) of its centre of mass [m].
        turn: that it may make between two samples [rad].
        way: that its centre of mass may go between two samples [m].

    Returns:
        (2, n), rising from 0 [1].
    """
    chords = np.linalg.norm(np.diff(poses[:, :3, :3], axis=0), axis=(1, 2)) / math.sqrt(2.0)
    turns = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * chords))
    ways = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    steps = np.stack([turns / turn, ways / way])
    return np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)


def spaced(spent: Array) -> Iterator[int]:
    """Yield as few inner samples as can be, so that from one to the next, ends included, no more than 1 is spent.

    A single step that spends more cannot be divided.

    Args:
        spent: (k, n) of k things up to each sample, none of which falls [1].
    """
    before = 0
    for sample in range(1, spent.shape[1] - 1):
        if np.any(spent[:, sample + 1] - spent[:, before] > 1.0):
            before = sample
            yield sample
