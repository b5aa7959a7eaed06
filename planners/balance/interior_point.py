"""Small second-order cone programs, compiled: an interior point method on the homogeneous self-dual embedding.

Minimise `cost @ x` subject to `balance @ x = load` and `rows @ x + offsets` in a product of cones. The method is that
of Vandenberghe, "The CVXOPT linear and quadratic cone program solvers" (2010), section 7, with Nesterov and Todd's
scaling and Mehrotra's correction. It comes to a solution, or to a dual that proves that there is none, and starts from
the same point whatever the program is. A program of paper B has some 20 variables and 20 cones, of which each touches
few variables: an iteration takes a few thousand multiplications.

Nobody has to believe it: whoever asks checks forces and proofs by themselves (`planners.balance.solver`).
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.geometry.pose import Array

SOLVED, INFEASIBLE, STUCK = 0, 1, 2

_MOST_ITERATIONS = 40
"""A program takes 8 to 14; what takes more is left to another solver."""
_ACCURACY = 1e-8
"""Of optimality, relative to the forces that there are [1]."""
_FEASIBILITY = 5e-9
"""Of balance and limits, likewise [1]."""
_PROOF_ACCURACY = 1e-7
"""How far a dual may be from a proof, relative to what it proves [1]."""
_TO_THE_BORDER = 0.99
"""Share of the way to the nearest cone's border that a step goes at most [1]."""
_PIVOT = 1e-14
"""Below this share of its own diagonal entry a pivot is rounding [1]."""
_NOTHING = 1e-30
"""A pivot that stands for 0."""


class Cones(NamedTuple):
    """Which rows make which cone, and which variables are in cones together.

    But for the last, variables fall into blocks, such as those of a contact; no cone has variables of two of them.
    """

    order: NDArray[np.int64]
    """(m,) rows by block, those of a cone together."""
    row_starts: NDArray[np.int64]
    """(C + 1,) cone k has the ordered rows from `row_starts[k]` up to `row_starts[k + 1]`; one row is a half-line."""
    block_cones: NDArray[np.int64]
    """(B + 1,) block b has the cones from `block_cones[b]` up to `block_cones[b + 1]` ..."""
    block_columns: NDArray[np.int64]
    """(B + 1,) ... and likewise the variables, besides the last. A block without has what bounds the last alone."""
    width: int
    """Variables of the largest block, and the last."""

    @staticmethod
    def of(pattern: NDArray[np.bool_], sizes: tuple[int, ...]) -> Cones:
        """Return the cones of rows whose entries are where a pattern (m, n) is True.

        Args:
            pattern: of `rows`.
            sizes: number of linear rows, then of the rows of each second-order cone; they add up to m.
        """
        return _cones(pattern.tobytes(), pattern.shape[1], sizes)


@lru_cache(maxsize=256)
def _cones(pattern: bytes, size: int, sizes: tuple[int, ...]) -> Cones:
    """Return the cones of a pattern of rows; programs with other limits mostly have the same."""
    entries = np.frombuffer(pattern, bool).reshape(-1, size)
    starts = np.concatenate([np.arange(sizes[0]), sizes[0] + np.cumsum([0, *sizes[1:]])])
    cones = [np.arange(first, end) for first, end in pairwise(starts)]
    touched = [np.flatnonzero(entries[rows, :-1].any(axis=0)) for rows in cones]
    # Variables of a block are next to each other: it begins where no cone reaches across.
    begins = np.ones(size - 1, bool)
    for columns in touched:
        if len(columns):
            begins[columns[0] + 1 : columns[-1] + 1] = False
    # What bounds the last variable alone is a block before the first.
    block = np.cumsum(begins)
    of_cone = np.array([block[columns[0]] if len(columns) else 0 for columns in touched])
    by_block = np.argsort(of_cone, kind="stable")
    edges = np.array([0, *np.flatnonzero(begins), size - 1])
    return Cones(
        np.concatenate([cones[k] for k in by_block]),
        np.cumsum([0, *(len(cones[k]) for k in by_block)]),
        np.searchsorted(of_cone[by_block], np.arange(len(edges))),
        edges,
        int(np.diff(edges).max()) + 1,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def solve_cone_program(
    balance: Array, load: Array, rows: Array, offsets: Array, cost: Array, cones: Cones
) -> tuple[int, Array, Array, Array]:
    """Solve a program, or prove that it has no solution.

    Args:
        balance: (p, n). Where its rows depend on one another, a program that cannot balance its load may end as STUCK.
        load: (p,).
        rows: (m, n), of full column rank.
        offsets: (m,).
        cost: (n,).
        cones: of the rows.

    Returns:
        SOLVED, INFEASIBLE or STUCK; x (n,), which is nothing unless SOLVED; the duals (p,) of the balance and (m,) of
        the cones.
        Where it is INFEASIBLE, `balance.T @ y` is `rows.T @ z` with z in the cones, while `load @ y + offsets @ z` is
        -1.
    """
    order, row_starts, block_cones, block_columns, width = cones
    (p, n), m = balance.shape, rows.shape[0]
    count, last = len(row_starts) - 1, n - 1
    unit = max(_largest(load), _largest(offsets), 1e-300)
    b, h, packed = load / unit, np.empty(m), np.zeros((m, width))
    for block in range(len(block_cones) - 1):
        first_column, end_column = block_columns[block], block_columns[block + 1]
        for r in range(row_starts[block_cones[block]], row_starts[block_cones[block + 1]]):
            h[r] = offsets[order[r]] / unit
            for j in range(first_column, end_column):
                packed[r, j - first_column] = rows[order[r], j]
            packed[r, end_column - first_column] = rows[order[r], last]
    x, y, s, z = np.zeros(n), np.zeros(p), np.zeros(m), np.zeros(m)
    for k in range(count):
        s[row_starts[k]] = z[row_starts[k]] = 1.0
    tau = kappa = 1.0
    eta, w, scaled, scaled_rows = np.empty(count), np.empty(m), np.empty(m), np.zeros((m, width))
    upper, lower, schur = np.empty((n, width)), np.empty((n, p)), np.empty((p, p))
    left_x, left_y, left_z = np.empty(n), np.empty(p), np.empty(m)
    scaled_h, scaled_left, divided, along = np.empty(m), np.empty(m), np.empty(m), np.empty(width)
    x1, y1, z1, x2, y2, z2 = np.empty(n), np.empty(p), np.empty(m), np.empty(n), np.empty(p), np.empty(m)
    first, second, third, step_s = np.empty(n), np.empty(p), np.empty(m), np.empty(m)
    cost_size, load_size = 1.0 + _largest(cost), max(_largest(b), 1e-8)
    for _ in range(_MOST_ITERATIONS):
        # What is left of the embedding's equations.
        cost_x = load_y = offset_z = gap = 0.0
        for j in range(n):
            left_x[j] = 0.0
            cost_x += cost[j] * x[j]
        for i in range(p):
            total = 0.0
            for j in range(n):
                left_x[j] += balance[i, j] * y[i]
                total += balance[i, j] * x[j]
            left_y[i] = total - b[i] * tau
            load_y += b[i] * y[i]
        _times(packed, x, cones, left_z)
        _take_transposed(packed, z, cones, left_x)
        for r in range(m):
            left_z[r] = s[r] - h[r] * tau - left_z[r]
            offset_z += h[r] * z[r]
            gap += s[r] * z[r]
        proven = -(load_y + offset_z)
        if proven > 0.0 and _largest(left_x) <= _PROOF_ACCURACY * proven:
            return INFEASIBLE, x, y / (proven * unit), _put_back(z, order, 1.0 / (proven * unit))
        for j in range(n):
            left_x[j] += cost[j] * tau
        # Not relative to limits: they may be so large that they play no part.
        size = min(tau, max(load_size * tau, _largest(x)))
        if (
            max(_largest(left_y), _largest(left_z)) <= _FEASIBILITY * size
            and _largest(left_x) <= _ACCURACY * cost_size * tau
            and gap / tau <= _ACCURACY * max(size, abs(cost_x))
        ):
            return SOLVED, x * (unit / tau), y / tau, _put_back(z, order, 1.0 / tau)
        left_tau = kappa + cost_x - proven
        if not _scale(s, z, packed, row_starts, w, eta, scaled, scaled_rows, along):
            return STUCK, x, y, _put_back(z, order, 1.0)
        _unscaled(h, w, eta, row_starts, scaled_h)
        _unscaled(left_z, w, eta, row_starts, scaled_left)
        _factor(scaled_rows, cones, upper)
        _forward(balance, upper, cones, lower)
        schur[:] = 0.0
        for i in range(n):
            for c in range(p):
                for d in range(p):
                    schur[c, d] += lower[i, c] * lower[i, d]
        factor(schur)
        for j in range(n):
            first[j] = -cost[j]
        _solve_scaled(first, b, scaled_h, cones, scaled_rows, upper, lower, schur, x1, y1, z1)
        along_one = _dot(cost, x1) + _dot(b, y1) + _dot(scaled_h, z1)
        mu = (gap + kappa * tau) / (count + 1)
        center, kept, tau_step, kappa_step, length = 0.0, 1.0, 0.0, 0.0, 0.0
        for correcting in range(2):
            # First straight at the solution, then with what that teaches about the way.
            if correcting:
                center = (1.0 - length) ** 3
                kappa_side = center * mu - kappa * tau - kappa_step * tau_step
                _divided(scaled, step_s, z2, center * mu, row_starts, divided)
            else:
                kappa_side = -kappa * tau
                for r in range(m):
                    divided[r] = -scaled[r]
            kept = 1.0 - center
            for j in range(n):
                first[j] = -kept * left_x[j]
            for i in range(p):
                second[i] = -kept * left_y[i]
            for r in range(m):
                third[r] = -kept * scaled_left[r] - divided[r]
            _solve_scaled(first, second, third, cones, scaled_rows, upper, lower, schur, x2, y2, z2)
            along_two = _dot(cost, x2) + _dot(b, y2) + _dot(scaled_h, z2)
            tau_step = (-kept * left_tau - kappa_side / tau - along_two) / (along_one - kappa / tau)
            kappa_step = (kappa_side - kappa * tau_step) / tau
            length = 1.0 / _TO_THE_BORDER if correcting else 1.0
            if tau_step < 0.0:
                length = min(length, -tau / tau_step)
            if kappa_step < 0.0:
                length = min(length, -kappa / kappa_step)
            for r in range(m):
                z2[r] += tau_step * z1[r]
                step_s[r] = divided[r] - z2[r]
            length = _way_to_border(scaled, step_s, z2, row_starts, length)
        length *= _TO_THE_BORDER
        for j in range(n):
            x2[j] += tau_step * x1[j]
            x[j] += length * x2[j]
        for i in range(p):
            y[i] += length * (y2[i] + tau_step * y1[i])
        # Slacks by the rows and not by the scaling, whose rounding they would keep for ever.
        _times(packed, x2, cones, step_s)
        for r in range(m):
            s[r] += length * (step_s[r] + h[r] * tau_step - kept * left_z[r])
        _unscaled(z2, w, eta, row_starts, third)
        for r in range(m):
            z[r] += length * third[r]
        tau += length * tau_step
        kappa += length * kappa_step
        if not (tau > 0.0 and kappa > 0.0 and np.isfinite(tau)):
            return STUCK, x, y, _put_back(z, order, 1.0)
    return STUCK, x, y, _put_back(z, order, 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _put_back(v, order, factor):
    """Return ordered rows (m,) times a factor in the order of the program."""
    out = np.empty(len(v))
    for r in range(len(v)):
        out[order[r]] = v[r] * factor
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _times(packed, x, cones, out):
    """Write packed rows times x."""
    last = len(x) - 1
    for block in range(len(cones.block_cones) - 1):
        begin, end = cones.block_columns[block], cones.block_columns[block + 1]
        for r in range(cones.row_starts[cones.block_cones[block]], cones.row_starts[cones.block_cones[block + 1]]):
            total = packed[r, end - begin] * x[last]
            for c in range(end - begin):
                total += packed[r, c] * x[begin + c]
            out[r] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _take_transposed(packed, v, cones, out):
    """Take the transpose of packed rows times v away from what is there."""
    last = len(out) - 1
    for block in range(len(cones.block_cones) - 1):
        begin, end = cones.block_columns[block], cones.block_columns[block + 1]
        for r in range(cones.row_starts[cones.block_cones[block]], cones.row_starts[cones.block_cones[block + 1]]):
            for c in range(end - begin):
                out[begin + c] -= packed[r, c] * v[r]
            out[last] -= packed[r, end - begin] * v[r]


@njit(cache=True, nogil=True, error_model="numpy")
def _dot(a, b):
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _largest(v):
    """Return the largest magnitude; infinite where anything is no number."""
    largest = 0.0
    for each in v:
        if not abs(each) <= largest:
            largest = abs(each) if abs(each) < np.inf else np.inf
    return largest


@njit(cache=True, nogil=True, error_model="numpy")
def _determinant(v, start, end):
    """Return v'Jv of a cone: the square of its head less those of its other rows."""
    square = 0.0
    for r in range(start + 1, end):
        square += v[r] * v[r]
    norm = math.sqrt(square)
    return (v[start] - norm) * (v[start] + norm)


@njit(cache=True, nogil=True, error_model="numpy")
def _scale(s, z, packed, row_starts, w, eta, scaled, scaled_rows, along):
    """Write Nesterov and Todd's scaling W of all cones: W z = W^-1 s = scaled; whether both points are inside.

    W is `eta` times the hyperbolic reflection that takes a cone's axis to w. W^-1 times the packed rows is written too.
    """
    width = packed.shape[1]
    for k in range(len(row_starts) - 1):
        start, end = row_starts[k], row_starts[k + 1]
        if not (s[start] > 0.0 and z[start] > 0.0):
            return False
        if end - start == 1:
            eta[k] = math.sqrt(s[start] / z[start])
            scaled[start] = eta[k] * z[start]
            inverse = 1.0 / eta[k]
            for c in range(width):
                scaled_rows[start, c] = packed[start, c] * inverse
            continue
        of_s, of_z = _determinant(s, start, end), _determinant(z, start, end)
        if not (of_s > 0.0 and of_z > 0.0):
            return False
        per_s, per_z = 1.0 / math.sqrt(of_s), 1.0 / math.sqrt(of_z)
        dot = 0.0
        for r in range(start, end):
            dot += s[r] * z[r]
        half = 0.5 / math.sqrt(0.5 + 0.5 * dot * per_s * per_z)
        square = scaled_z = 0.0
        for c in range(width):
            along[c] = 0.0
        for r in range(start + 1, end):
            w[r] = (s[r] * per_s - z[r] * per_z) * half
            square += w[r] * w[r]
            scaled_z += w[r] * z[r]
            for c in range(width):
                along[c] += w[r] * packed[r, c]
        # Its determinant is 1 but for rounding.
        w[start] = math.sqrt(1.0 + square)
        eta[k] = math.sqrt(per_z / per_s)
        inverse, share = 1.0 / eta[k], 1.0 / (1.0 + w[start])
        scaled[start] = eta[k] * (w[start] * z[start] + scaled_z)
        bent = z[start] + scaled_z * share
        for c in range(width):
            scaled_rows[start, c] = (w[start] * packed[start, c] - along[c]) * inverse
            along[c] = along[c] * share - packed[start, c]
        for r in range(start + 1, end):
            scaled[r] = eta[k] * (z[r] + w[r] * bent)
            for c in range(width):
                scaled_rows[r, c] = (packed[r, c] + w[r] * along[c]) * inverse
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _unscaled(v, w, eta, row_starts, out):
    """Write W^-1 v."""
    for k in range(len(row_starts) - 1):
        start, end = row_starts[k], row_starts[k + 1]
        inverse = 1.0 / eta[k]
        if end - start == 1:
            out[start] = v[start] * inverse
            continue
        along = 0.0
        for r in range(start + 1, end):
            along += w[r] * v[r]
        bent = along / (1.0 + w[start]) - v[start]
        out[start] = (w[start] * v[start] - along) * inverse
        for r in range(start + 1, end):
            out[r] = (v[r] + w[r] * bent) * inverse


@njit(cache=True, nogil=True, error_model="numpy")
def _divided(scaled, step_s, step_z, center, row_starts, out):
    """Write what, multiplied by the scaled point, is `center e - scaled o scaled - step_s o step_z`."""
    for k in range(len(row_starts) - 1):
        start, end = row_starts[k], row_starts[k + 1]
        if end - start == 1:
            out[start] = (center - step_s[start] * step_z[start]) / scaled[start] - scaled[start]
            continue
        head, along = center, 0.0
        for r in range(start, end):
            head -= scaled[r] * scaled[r] + step_s[r] * step_z[r]
        for r in range(start + 1, end):
            out[r] = -2.0 * scaled[start] * scaled[r] - step_s[start] * step_z[r] - step_z[start] * step_s[r]
            along += scaled[r] * out[r]
        out[start] = (scaled[start] * head - along) / _determinant(scaled, start, end)
        for r in range(start + 1, end):
            out[r] = (out[r] - out[start] * scaled[r]) / scaled[start]


@njit(cache=True, nogil=True, error_model="numpy")
def _way_to_border(scaled, step_s, step_z, row_starts, length):
    """Return how many of both steps the scaled point may go before it is outside a cone; `length` at most."""
    for k in range(len(row_starts) - 1):
        start, end = row_starts[k], row_starts[k + 1]
        if end - start == 1:
            least = min(step_s[start], step_z[start])
            if scaled[start] + length * least < 0.0:
                length = -scaled[start] / least
            continue
        c = _determinant(scaled, start, end)
        length = min(length, _way_out(scaled, step_s, c, start, end), _way_out(scaled, step_z, c, start, end))
    return length


@njit(cache=True, nogil=True, error_model="numpy")
def _way_out(point, step, c, start, end):
    """Return how many steps a cone's point, inside with a determinant c, may go before it is outside."""
    a, b = step[start] * step[start], point[start] * step[start]
    for r in range(start + 1, end):
        a -= step[r] * step[r]
        b -= point[r] * step[r]
    # No less than 0 but for rounding: the way through a cone's inside meets its border twice.
    root = math.sqrt(max(0.0, b * b - a * c))
    if b < 0.0:
        return c / (root - b)
    return (b + root) / -a if a < 0.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _factor(scaled_rows, cones, upper):
    """Write the Cholesky factor U of the packed rows' normal matrix U'U, with the inverse of its diagonal.

    A block's rows of U stand in its columns, and the last column behind them.
    """
    last = len(upper) - 1
    whole = rest = 0.0
    for block in range(len(cones.block_cones) - 1):
        begin, size = cones.block_columns[block], cones.block_columns[block + 1] - cones.block_columns[block]
        for c in range(size):
            for d in range(c, size + 1):
                upper[begin + c, d] = 0.0
        for r in range(cones.row_starts[cones.block_cones[block]], cones.row_starts[cones.block_cones[block + 1]]):
            for c in range(size):
                value = scaled_rows[r, c]
                if value != 0.0:
                    for d in range(c, size + 1):
                        upper[begin + c, d] += value * scaled_rows[r, d]
            whole += scaled_rows[r, size] * scaled_rows[r, size]
        for c in range(size):
            diagonal = upper[begin + c, c]
            for k in range(c):
                value = upper[begin + k, c]
                if value != 0.0:
                    for d in range(c, size + 1):
                        upper[begin + c, d] -= value * upper[begin + k, d]
            # What is left of a pivot near the border of a cone is rounding.
            inverse = 1.0 / math.sqrt(max(upper[begin + c, c], _PIVOT * diagonal))
            upper[begin + c, c] = inverse
            for d in range(c + 1, size + 1):
                upper[begin + c, d] *= inverse
            rest += upper[begin + c, size] * upper[begin + c, size]
    upper[last, 0] = 1.0 / math.sqrt(max(whole - rest, _PIVOT * whole))


@njit(cache=True, nogil=True, error_model="numpy")
def _forward(balance, upper, cones, lower):
    """Write the inverse of U' times the balance's transpose, (n, p)."""
    p, n = balance.shape
    for i in range(n):
        for c in range(p):
            lower[i, c] = balance[c, i]
    for block in range(len(cones.block_cones) - 1):
        begin, size = cones.block_columns[block], cones.block_columns[block + 1] - cones.block_columns[block]
        for i in range(begin, begin + size):
            inverse = upper[i, i - begin]
            for c in range(p):
                lower[i, c] *= inverse
            for k in range(i + 1, begin + size):
                value = upper[i, k - begin]
                if value != 0.0:
                    for c in range(p):
                        lower[k, c] -= value * lower[i, c]
            value = upper[i, size]
            if value != 0.0:
                for c in range(p):
                    lower[n - 1, c] -= value * lower[i, c]
    inverse = upper[n - 1, 0]
    for c in range(p):
        lower[n - 1, c] *= inverse


@njit(cache=True, nogil=True, error_model="numpy")
def factor(matrix):
    """Replace the lower half of a positive definite matrix by its Cholesky factor, with the inverse of its diagonal."""
    for i in range(len(matrix)):
        for j in range(i):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total * matrix[j, j]
        diagonal = total = matrix[i, i]
        for k in range(i):
            total -= matrix[i, k] * matrix[i, k]
        # What contacts can hardly exert: less is rounding. What they cannot exert at all is 0.
        matrix[i, i] = 1.0 / math.sqrt(max(total, _PIVOT * diagonal, _NOTHING))


@njit(cache=True, nogil=True, error_model="numpy")
def solve_factored(factored, y):
    """Solve a system with a matrix that `factor` has replaced, in place of its right side."""
    for i in range(len(y)):
        for j in range(i):
            y[i] -= factored[i, j] * y[j]
        y[i] *= factored[i, i]
    for i in range(len(y) - 1, -1, -1):
        y[i] *= factored[i, i]
        for j in range(i):
            y[j] -= factored[i, j] * y[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_scaled(first, second, third, cones, scaled_rows, upper, lower, schur, x, y, z):
    """Write x, y and W z such that A'y - R'z = first, A x = second and W^-1 (-R x - W W z) = third.

    A is the balance and R the rows; `scaled_rows` is W^-1 R, `upper` the factor of its normal matrix, `lower` the
    inverse of that one's transpose times A', and `schur` the factor of lower' lower.
    """
    n, p = lower.shape
    last = n - 1
    for i in range(n):
        x[i] = first[i]
    _take_transposed(scaled_rows, third, cones, x)
    for block in range(len(cones.block_cones) - 1):
        begin, size = cones.block_columns[block], cones.block_columns[block + 1] - cones.block_columns[block]
        for j in range(size):
            value = x[begin + j] * upper[begin + j, j]
            x[begin + j] = value
            for k in range(j + 1, size):
                x[begin + k] -= upper[begin + j, k] * value
            x[last] -= upper[begin + j, size] * value
    x[last] *= upper[last, 0]
    for c in range(p):
        y[c] = -second[c]
    for i in range(n):
        for c in range(p):
            y[c] += lower[i, c] * x[i]
    solve_factored(schur, y)
    for i in range(n):
        for c in range(p):
            x[i] -= lower[i, c] * y[c]
    x[last] *= upper[last, 0]
    for block in range(len(cones.block_cones) - 1):
        begin, size = cones.block_columns[block], cones.block_columns[block + 1] - cones.block_columns[block]
        for j in range(size - 1, -1, -1):
            total = x[begin + j] - upper[begin + j, size] * x[last]
            for k in range(j + 1, size):
                total -= upper[begin + j, k] * x[begin + k]
            x[begin + j] = total * upper[begin + j, j]
    _times(scaled_rows, x, cones, z)
    for r in range(len(z)):
        z[r] = -third[r] - z[r]
