"""What a last grasp is worth: by hand, over all layers of the next object, nearest goals only."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planners.cell.cell import Cell
from planners.regrasp.graph.cost_to_go import CostToGo
from planners.regrasp.motion.travel_time import NodeTravelTimes
from planners.regrasp.tool_settings import CarriedPace

N, GOALS = 5, 2


class Layer:
    """A layer of which everything is known beforehand, and that notes what it was asked."""

    def __init__(self, rng: np.random.Generator, reached: float) -> None:
        self._all = rng.uniform(-2.0, 2.0, (2 * N, 3, 6))
        self._all[rng.random(2 * N) > reached] = np.nan
        self.solutions = np.full_like(self._all, np.nan)
        self.asked = np.zeros(2 * N, dtype=bool)

    def ask(self, nodes: np.ndarray) -> np.ndarray:
        self.asked |= nodes
        self.solutions[nodes] = self._all[nodes]
        return nodes & np.isfinite(self._all[:, 0, 0])


@pytest.fixture
def travel_times(cell: Cell) -> NodeTravelTimes:
    return NodeTravelTimes(list(cell.arms.values()), [np.tile(np.eye(4), (N, 1, 1))] * 2, CarriedPace())


@pytest.fixture
def routes() -> list[Any]:
    rng = np.random.default_rng(8)
    return [
        SimpleNamespace(suction=Layer(rng, 0.7), goals=[Layer(rng, 0.6) for _ in range(3)], goal_order=[2, 0, 1])
        for _ in range(2)
    ]


def test_the_best_route_to_the_nearest_goals_counts_and_a_handover_where_there_is_none(
    travel_times: NodeTravelTimes, routes: list[Any]
) -> None:
    rng = np.random.default_rng(3)
    positions, otherwise = rng.uniform(-2.0, 2.0, (2 * N, 2, 6)), rng.uniform(7.0, 9.0, 2 * N)
    positions[[1, 6]] = np.nan
    found = CostToGo(routes, GOALS, travel_times, otherwise).seconds(positions)
    direct = []
    for node in range(2 * N):
        ways = [
            travel_times.of(node, positions[node], start) + travel_times.of(node, route.suction.solutions[node], goal)
            for route in routes
            for start in [route.suction.solutions[node]]
            for goal in (route.goals[number].solutions[node] for number in route.goal_order[:GOALS])
        ]
        direct.append(min(ways))
    assert found == pytest.approx(np.minimum(direct, otherwise))
    assert (found < otherwise).any()
    assert np.array_equal(found[[1, 6]], otherwise[[1, 6]])


def test_nothing_is_asked_that_is_not_needed(travel_times: NodeTravelTimes, routes: list[Any]) -> None:
    positions = np.full((2 * N, 1, 6), np.nan)
    positions[2] = 0.1
    CostToGo(routes, GOALS, travel_times, np.full(2 * N, 8.0)).seconds(positions)
    for route in routes:
        assert np.flatnonzero(route.suction.asked).tolist() == [2]
        assert not route.goals[1].asked.any()


def test_without_a_next_object_every_grasp_is_as_good(travel_times: NodeTravelTimes) -> None:
    assert not CostToGo((), 0, travel_times, np.zeros(2 * N)).seconds(np.zeros((2 * N, 1, 6))).any()
