"""Whole turns: the joint positions that differ by 2 pi, and look the same, but lie elsewhere in the joint range."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.geometry.pose import Array

LIMIT_SLACK = 1e-9
"""How far outside a limit a position may come out by rounding; it is then moved onto the limit [rad]."""

_TURN = 2.0 * math.pi


@njit(cache=True, nogil=True)
def wrap(angle: float) -> float:
    """Return the angle in (-pi, pi] that differs from `angle` by whole turns [rad]."""
    wrapped = angle - _TURN * math.floor(angle / _TURN + 0.5)
    return wrapped + _TURN if wrapped <= -math.pi else wrapped


@njit(cache=True, nogil=True)
def _turns(angle: float, lo: float, hi: float) -> tuple[int, int]:
    """Return the least and the greatest n with `lo <= angle + 2 pi n <= hi`; the least is greater if there is none."""
    return math.ceil((lo - LIMIT_SLACK - angle) / _TURN), math.floor((hi + LIMIT_SLACK - angle) / _TURN)


@njit(cache=True, nogil=True)
def nearest_winding(q: Array, reference: Array, lo: Array, hi: Array) -> Array:
    """Turn each joint by whole turns to the position within its limits that is nearest to a reference.

    Args:
        q: (n,) joint positions [rad].
        reference: (n,) where the joints should be near [rad].
        lo: (n,) lower limits [rad].
        hi: (n,) upper limits [rad].

    Returns:
        (n,) joint positions [rad]; NaN for a joint of which no winding lies within the limits.
    """
    result = np.empty(q.shape[0])
    for i in range(q.shape[0]):
        least, greatest = _turns(q[i], lo[i], hi[i])
        if least > greatest:
            result[i] = math.nan
            continue
        wanted = math.floor((reference[i] - q[i]) / _TURN + 0.5)
        turns = min(max(wanted, least), greatest)
        result[i] = min(max(q[i] + _TURN * turns, lo[i]), hi[i])
    return result


@njit(cache=True, nogil=True)
def all_windings(q: Array, lo: Array, hi: Array) -> Array:
    """List every combination of whole turns that lies within the limits.

    Args:
        q: (n,) joint positions [rad].
        lo: (n,) lower limits [rad].
        hi: (n,) upper limits [rad].

    Returns:
        (m, n) joint positions in lexicographic order [rad]; m is 0 when a joint has no position within its limits.
    """
    joints = q.shape[0]
    least = np.empty(joints, dtype=np.int64)
    count = np.empty(joints, dtype=np.int64)
    total = 1
    for i in range(joints):
        first, last = _turns(q[i], lo[i], hi[i])
        least[i] = first
        count[i] = max(0, last - first + 1)
        total *= count[i]
    result = np.empty((total, joints))
    for row in range(total):
        remainder = row
        for i in range(joints - 1, -1, -1):
            turns = least[i] + remainder % count[i]
            remainder //= count[i]
            result[row, i] = min(max(q[i] + _TURN * turns, lo[i]), hi[i])
    return result
