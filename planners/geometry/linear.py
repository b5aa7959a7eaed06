"""Small linear algebra: what NumPy takes longer to be asked than to do."""

from __future__ import annotations

import numpy as np
from numba import njit

from planners.geometry.pose import Array


@njit(cache=True, nogil=True)
def solve(matrix: Array, right: Array) -> Array:
    """Return x (n,) with `matrix @ x == right`, by elimination with row pivoting; both arguments are overwritten.

    For a dozen unknowns. It compiles in a tenth of the time that a call of a library takes to, and sums in the same
    order on every machine.

    Args:
        matrix: (n, n), not singular.
        right: (n,).
    """
    n = len(right)
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            right[k], right[pivot] = right[pivot], right[k]
            for j in range(k, n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            right[i] -= factor * right[k]
            for j in range(k + 1, n):
                matrix[i, j] -= factor * matrix[k, j]
    x = np.empty(n)
    for i in range(n - 1, -1, -1):
        x[i] = right[i]
        for j in range(i + 1, n):
            x[i] -= matrix[i, j] * x[j]
        x[i] /= matrix[i, i]
    return x


@njit(cache=True, nogil=True)
def row_between(rows: Array, low: int, high: int, part: float) -> Array:
    """Return the (k,) row that is `part` (0 to 1) of the straight way from one row of `rows` (n, k) to another."""
    row = np.empty(rows.shape[1])
    for j in range(rows.shape[1]):
        row[j] = (1.0 - part) * rows[low, j] + part * rows[high, j]
    return row
