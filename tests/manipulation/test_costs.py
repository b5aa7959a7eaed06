"""Edge costs, worked out by hand from paper B, eqs. (6) to (10)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.manipulation.contacts.contact_states import restraint
from planners.manipulation.graph.manipulation_graph import TransitionCost

UP = np.array([0.0, 0.0, 1.0])
CORNERS = np.array([[0.15, 0.15, -0.02], [-0.15, 0.15, -0.02], [-0.15, -0.15, -0.02], [0.15, -0.15, -0.02]])


def test_within_a_contact_state_every_motion_costs_k():
    assert TransitionCost(k=2.5).same_contact() == 2.5


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [(4, 2, math.exp(-1)), (2, 4, math.exp(1)), (2, 1, math.exp(-1)), (4, 0, math.exp(-3)), (1, 0, math.exp(-1))],
)
def test_a_contact_change_costs_by_the_ranks_of_its_contacts(before, after, expected):
    """Face: 4 points, rank 3; edge: 2 points, rank 2; vertex: rank 1; none: 0."""
    ranks = [restraint(CORNERS[:count], np.tile(UP, (count, 1))) for count in (before, after)]
    assert TransitionCost(omega=3.0).contact_change(*ranks) == pytest.approx(3.0 * expected)


@pytest.mark.parametrize("pair", [(3, 2), (2, 1), (1, 0), (3, 0)])
def test_there_and_back_cost_multiplies_to_omega_squared(pair):
    costs = TransitionCost(omega=0.7)
    assert costs.contact_change(*pair) * costs.contact_change(*pair[::-1]) == pytest.approx(0.49)
