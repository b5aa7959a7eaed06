"""Small systems of linear equations, against LAPACK."""

from __future__ import annotations

import numpy as np
import pytest

from planners.geometry.linear import solve


@pytest.mark.parametrize("size", [1, 6, 18])
@pytest.mark.parametrize("seed", range(5))
def test_the_solution_is_lapacks(size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix, right = rng.normal(size=(size, size)), rng.normal(size=size)
    expected = np.linalg.solve(matrix, right)
    assert solve(matrix.copy(), right.copy()) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_a_zero_on_the_diagonal_does_no_harm() -> None:
    matrix, right = np.array([[0.0, 2.0], [4.0, 1.0]]), np.array([2.0, 9.0])
    assert solve(matrix, right) == pytest.approx([2.0, 1.0])
