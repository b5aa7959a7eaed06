"""A point robot among boxes: what the path search must find, must not find, and must repeat."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from planners.errors import PlanningCancelled
from planners.motion.path_search import plan_motion
from planners.motion.query import MotionOutcome, MotionQuery, MotionQueryError, MotionSettings

Array = NDArray[np.float64]

LONG_STEPS = MotionSettings(step_max=3.0)
"""For rooms of 6 x 6 x … with one wall, where long edges are seldom in the way."""


@dataclass
class PointAmongBoxes:
    """The joint vector is a point; boxes (k, n) low and high are solid, ends of an edge included."""

    low: Array
    high: Array
    edges_asked: list[tuple[Array, Array]] = field(default_factory=list)

    def state_free(self, q: Array) -> bool:
        return not bool(np.any(np.all((q >= self.low) & (q <= self.high), axis=1)))

    def edge_free(self, q_from: Array, q_to: Array) -> bool:
        """Exact: slabs."""
        self.edges_asked.append((q_from, q_to))
        step = q_to - q_from
        step = np.where(step == 0.0, 1e-300, step)
        t = np.stack([(self.low - q_from) / step, (self.high - q_from) / step])
        enter, leave = t.min(axis=0).max(axis=1), t.max(axis=0).min(axis=1)
        return not bool(np.any(np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)))

    def path_free(self, path: Array) -> bool:
        return all(self.edge_free(a, b) for a, b in pairwise(path))


def no_boxes(n: int) -> PointAmongBoxes:
    return PointAmongBoxes(np.empty((0, n)), np.empty((0, n)))


def wall_with_gap(n: int, gap: float) -> PointAmongBoxes:
    """A wall at joint 0 in [-0.2, 0.2], open where joint 1 is above 3 - gap; the joints' range is [-3, 3]."""
    low, high = np.full((1, n), -10.0), np.full((1, n), 10.0)
    low[0, 0], high[0, 0], high[0, 1] = -0.2, 0.2, 3.0 - gap
    return PointAmongBoxes(low, high)


def across(checker: PointAmongBoxes, n: int, goals: Array | None = None) -> MotionQuery:
    start = np.full(n, -1.0)
    goals = np.full((1, n), 1.0) if goals is None else goals
    return MotionQuery(start, goals, np.full(n, -3.0), np.full(n, 3.0), checker)


def brute_force_free(checker: PointAmongBoxes, path: Array) -> bool:
    """Whether points 1e-3 apart along the path are all free."""
    for a, b in pairwise(path):
        for t in np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(b - a) / 1e-3)):
            if not checker.state_free(a + t * (b - a)):
                return False
    return True


@pytest.mark.parametrize("n", [2, 6, 12])
@pytest.mark.parametrize("seed", range(5))
def test_a_path_through_a_gap_is_found_and_is_free(n: int, seed: int) -> None:
    checker = wall_with_gap(n, gap=1.0)
    query = across(checker, n)
    result = plan_motion(query, LONG_STEPS, np.random.default_rng(seed))
    assert result.outcome is MotionOutcome.FOUND
    assert result.path is not None
    assert result.goal_index == 0
    assert np.array_equal(result.path[0], query.start)
    assert np.array_equal(result.path[-1], query.goals[0])
    assert np.all((result.path >= query.position_min) & (result.path <= query.position_max))
    assert brute_force_free(checker, result.path)


def test_a_closed_wall_exhausts_the_iterations() -> None:
    settings = MotionSettings(max_iterations=200)
    result = plan_motion(across(wall_with_gap(3, gap=-1.0), 3), settings, np.random.default_rng(0))
    assert result.outcome is MotionOutcome.ITERATIONS_EXHAUSTED
    assert result.path is None
    assert result.goal_index is None
    assert result.statistics.iterations == 200


@pytest.mark.parametrize("n", [2, 6])
def test_the_same_seed_gives_the_same_path_whatever_was_planned_before(n: int) -> None:
    query = across(wall_with_gap(n, gap=0.5), n)

    def path(seed: int) -> Array:
        found = plan_motion(query, LONG_STEPS, np.random.default_rng(seed)).path
        assert found is not None
        return found

    first = path(7)
    others = [path(seed) for seed in range(5)]
    assert np.array_equal(path(7), first)
    assert not all(np.array_equal(other, first) for other in others)


def test_the_search_asks_the_same_edges_again_for_the_same_seed() -> None:
    asked = []
    for _ in range(2):
        checker = wall_with_gap(6, gap=-1.0)
        plan_motion(across(checker, 6), MotionSettings(max_iterations=100), np.random.default_rng(3))
        asked.append(np.array(checker.edges_asked))
    assert np.array_equal(asked[0], asked[1])


def test_searches_in_threads_do_not_disturb_each_other() -> None:
    def path(seed: int) -> Array:
        query = across(wall_with_gap(6, gap=0.5), 6)
        found = plan_motion(query, LONG_STEPS, np.random.default_rng(seed)).path
        assert found is not None
        return found

    alone = [path(seed) for seed in range(8)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(path, range(8)))
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))


def test_the_nearest_winding_is_chosen_when_the_way_is_free() -> None:
    goal = np.array([0.5, -0.4, 0.3, 1.0, -1.0, 0.2])
    turns = 2.0 * np.pi * np.array([[0, 0, 0, 0, 0, 1], [0, 0, 0, -1, 0, 0], [0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]])
    limit = np.full(6, 2.0 * np.pi)
    query = MotionQuery(np.zeros(6), goal + turns, -limit, limit, no_boxes(6))
    assert plan_motion(query, MotionSettings(), np.random.default_rng(0)).goal_index == 2


def test_near_means_soon_when_speeds_differ() -> None:
    """1 rad at 1 rad/s takes longer than 1.5 rad at 2 rad/s."""
    goals = np.array([[1.0, 0.0], [0.0, 1.5]])
    limit = np.full(2, 3.0)
    query = MotionQuery(np.zeros(2), goals, -limit, limit, no_boxes(2), velocity_max=np.array([1.0, 2.0]))
    assert plan_motion(query, MotionSettings(), np.random.default_rng(0)).goal_index == 1


def test_costs_that_are_given_stand_in_for_distances() -> None:
    goals, limit = np.array([[1.0, 0.0], [0.0, 1.5]]), np.full(2, 3.0)
    query = MotionQuery(np.zeros(2), goals, -limit, limit, no_boxes(2), goal_costs=np.array([9.0, 1.0]))
    assert plan_motion(query, MotionSettings(), np.random.default_rng(0)).goal_index == 1


@pytest.mark.parametrize("cost", [np.inf, np.nan])
def test_a_goal_that_costs_beyond_number_is_still_none_outside_the_limits(cost: float) -> None:
    goals, limit = np.array([[9.0, 0.0], [0.5, 0.5]]), np.ones(2)
    query = MotionQuery(np.zeros(2), goals, -limit, limit, no_boxes(2), goal_costs=np.array([1.0, cost]))
    assert plan_motion(query, MotionSettings(), np.random.default_rng(0)).goal_index == 1


def test_a_straight_line_is_asked_for_once_though_the_near_goals_are_among_all() -> None:
    checker = wall_with_gap(2, gap=-1.0)
    goals = np.array([[0.4, -1.2], [0.5, -1.3], [2.9, 2.9]])
    query = across(checker, 2, goals)
    plan_motion(query, replace(LONG_STEPS, near_share=1.5, max_iterations=1), np.random.default_rng(0))
    straight = [tuple(end) for begin, end in checker.edges_asked if np.array_equal(begin, query.start)]
    assert all(straight.count(tuple(goal)) == 1 for goal in goals[:2])


def test_a_short_way_round_a_corner_is_preferred_to_a_straight_one_far_away_if_asked_for() -> None:
    """The near goal lies behind the wall's edge, the far one in the open on this side."""
    checker = wall_with_gap(2, gap=3.9)
    goals = np.array([[0.4, -1.2], [-2.9, 2.9]])
    query = across(checker, 2, goals)
    assert plan_motion(query, LONG_STEPS, np.random.default_rng(0)).goal_index == 1
    near_first = plan_motion(query, replace(LONG_STEPS, near_share=1.5), np.random.default_rng(0))
    assert near_first.goal_index == 0
    assert near_first.statistics.iterations > 0
    # Where the near one cannot be reached at all, the far one is found as before.
    closed = across(wall_with_gap(2, gap=-1.0), 2, goals)
    assert plan_motion(closed, replace(LONG_STEPS, near_share=1.5), np.random.default_rng(0)).goal_index == 1


@pytest.mark.parametrize("seed", range(8))
def test_more_searches_never_give_a_longer_path(seed: int) -> None:
    settings = replace(LONG_STEPS, shortcut_attempts=3)
    lengths = []
    for searches in (1, 2, 4):
        checker = wall_with_gap(3, gap=1.5)
        result = plan_motion(across(checker, 3), replace(settings, searches=searches), np.random.default_rng(seed))
        assert result.path is not None
        assert brute_force_free(checker, result.path)
        lengths.append(result.statistics.length)
    assert lengths == sorted(lengths, reverse=True)


def test_a_blocked_near_goal_gives_way_to_a_far_one_on_this_side() -> None:
    checker = wall_with_gap(3, gap=-1.0)
    goals = np.array([[1.0, -1.0, -1.0], [-2.9, 2.9, 2.9]])
    result = plan_motion(across(checker, 3, goals), MotionSettings(), np.random.default_rng(0))
    assert result.outcome is MotionOutcome.FOUND
    assert result.goal_index == 1


def test_a_search_among_many_goals_ends_at_one_of_them_exactly() -> None:
    checker = wall_with_gap(6, gap=1.0)
    goals = np.random.default_rng(1).uniform([0.5] * 6, [2.5] * 6, (40, 6))
    goals[:, 1] = -2.0
    result = plan_motion(across(checker, 6, goals), LONG_STEPS, np.random.default_rng(0))
    assert result.path is not None
    assert result.goal_index is not None
    assert result.statistics.iterations > 0
    assert np.array_equal(result.path[-1], goals[result.goal_index])


@pytest.mark.slow
def test_shortcuts_never_lengthen_and_keep_the_path_free() -> None:
    rng = np.random.default_rng(5)
    centres = rng.uniform(-2.0, 2.0, (30, 4))
    checker = PointAmongBoxes(centres - 0.6, centres + 0.6)
    searched = 0
    for seed in range(40):
        ends = rng.uniform(-3.0, 3.0, (2, 4))
        query = MotionQuery(ends[0], ends[1:], np.full(4, -3.0), np.full(4, 3.0), checker)
        result = plan_motion(query, MotionSettings(), np.random.default_rng(seed))
        if result.path is None or result.statistics.iterations == 0:
            continue
        searched += 1
        assert result.statistics.length <= result.statistics.length_found + 1e-12
        assert brute_force_free(checker, result.path)
    assert searched >= 5


def test_every_reason_to_refuse_is_told_apart() -> None:
    checker = wall_with_gap(2, gap=-1.0)

    def outcome(start: list[float], goals: list[list[float]]) -> MotionOutcome:
        limit = np.full(2, 3.0)
        query = MotionQuery(np.array(start), np.array(goals).reshape(-1, 2), -limit, limit, checker)
        return plan_motion(query, MotionSettings(), np.random.default_rng(0)).outcome

    assert outcome([-4.0, 0.0], [[-1.0, 1.0]]) is MotionOutcome.START_OUT_OF_LIMITS
    assert outcome([np.nan, 0.0], [[-1.0, 1.0]]) is MotionOutcome.START_OUT_OF_LIMITS
    assert outcome([0.1, 0.0], [[-1.0, 1.0]]) is MotionOutcome.START_IN_COLLISION
    assert outcome([-1.0, 0.0], []) is MotionOutcome.NO_GOAL
    assert outcome([-1.0, 0.0], [[-1.0, 4.0]]) is MotionOutcome.GOALS_OUT_OF_LIMITS
    assert outcome([-1.0, 0.0], [[-1.0, 4.0], [0.1, 0.0]]) is MotionOutcome.GOALS_IN_COLLISION
    assert outcome([-1.0, 0.0], [[-1.0, 0.0]]) is MotionOutcome.FOUND


def test_arrays_that_do_not_fit_are_an_error() -> None:
    query = MotionQuery(np.zeros(6), np.zeros((1, 5)), np.full(6, -1.0), np.ones(6), no_boxes(6))
    with pytest.raises(MotionQueryError, match=r"goals have shape"):
        plan_motion(query, MotionSettings(), np.random.default_rng(0))


def test_a_checker_can_cancel_the_search_and_the_next_one_works() -> None:
    class Cancelling(PointAmongBoxes):
        def edge_free(self, q_from: Array, q_to: Array) -> bool:
            if len(self.edges_asked) > 20:
                raise PlanningCancelled("stopped")
            return super().edge_free(q_from, q_to)

    wall = wall_with_gap(3, gap=-1.0)
    with pytest.raises(PlanningCancelled):
        plan_motion(across(Cancelling(wall.low, wall.high), 3), MotionSettings(), np.random.default_rng(0))
    found = plan_motion(across(wall_with_gap(3, gap=1.0), 3), MotionSettings(), np.random.default_rng(0))
    assert found.outcome is MotionOutcome.FOUND


def test_the_search_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    for gap in (1.0, -1.0):
        query = across(wall_with_gap(3, gap), 3)
        plan_motion(query, MotionSettings(max_iterations=50), np.random.default_rng(0))
    assert capfd.readouterr() == ("", "")
