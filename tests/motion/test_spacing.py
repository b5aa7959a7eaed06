"""Laws of samples that are close enough together."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planners.geometry.pose import Array
from planners.motion.spacing import spaced, spent_on_the_way

COUNT = 8
SIXTEENTHS = st.integers(0, 16).map(lambda n: n / 16)  # whose sums are exact
STEPS = st.lists(st.tuples(SIXTEENTHS, SIXTEENTHS), min_size=1, max_size=COUNT)


def close_enough(spent: Array, inner: tuple[int, ...]) -> bool:
    ends = [0, *inner, spent.shape[1] - 1]
    return all(np.all(spent[:, after] - spent[:, before] <= 1.0) for before, after in pairwise(ends))


@given(STEPS)
def test_samples_are_close_enough_and_no_smaller_number_is(each: list[tuple[float, float]]) -> None:
    spent = np.concatenate([np.zeros((2, 1)), np.cumsum(np.array(each).T, axis=1)], axis=1)
    found = tuple(spaced(spent))
    assert close_enough(spent, found)
    inner = range(1, spent.shape[1] - 1)
    assert not any(close_enough(spent, fewer) for k in range(len(found)) for fewer in combinations(inner, k))


def test_a_step_that_spends_too_much_alone_stands_between_two_samples() -> None:
    assert list(spaced(np.array([[0.0, 0.4, 3.0, 3.4, 3.8]]))) == [1, 2]


def test_an_excursion_there_and_back_counts_both_ways() -> None:
    """A body that turns by 0.3 rad and goes 40 mm, and comes back, has spent that twice."""
    angles, ways = np.array([0.0, 0.1, 0.3, 0.1, 0.0]), np.array([0.0, 0.02, 0.04, 0.02, 0.0])
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(angles, [0.6, 0.0, 0.8])).as_matrix()
    centres = np.outer(ways, [0.0, 1.0, 0.0])
    spent = spent_on_the_way(poses, centres, turn=0.2, way=0.04)
    assert spent[:, 0] == pytest.approx([0.0, 0.0])
    assert spent[:, -1] == pytest.approx([0.6 / 0.2, 0.08 / 0.04])
