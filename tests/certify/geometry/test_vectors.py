"""Single vectors, by NumPy's word."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from planners.certify.geometry.vectors import angle, cross, length
from planners.geometry.pose import Array, rotation_from_vector

VECTORS = arrays(float, 3, elements=st.floats(-10.0, 10.0))


@given(VECTORS, VECTORS)
def test_products_and_lengths_are_numpys(a: Array, b: Array) -> None:
    assert np.array_equal(cross(a, b), np.cross(a, b))
    assert length(a) == np.linalg.norm(a)


@pytest.mark.parametrize("turned", [0.0, 1e-9, 0.3, 2.0, np.pi])
def test_a_turned_vector_is_as_far_away_as_it_was_turned(turned: float) -> None:
    about = np.array([0.6, 0.0, 0.8])
    vector = np.array([0.8, 0.5, -0.6])
    assert angle(vector, rotation_from_vector(turned * about) @ vector) == pytest.approx(turned, abs=1e-12)
