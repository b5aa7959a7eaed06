"""Free motion to the best of several goals: straight lines first, then OMPL's RRT-Connect; its corners are cut."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.motion.checker import EdgeChecker
from planners.motion.joint_metric import JointMetric
from planners.motion.lazy_roadmap import find_way
from planners.motion.query import (
    MotionOutcome,
    MotionQuery,
    MotionQueryError,
    MotionResult,
    MotionSettings,
    MotionStatistics,
)
from planners.motion.rrt_connect import TreeProblem, grow_trees


def plan_motion(query: MotionQuery, settings: MotionSettings, rng: np.random.Generator) -> MotionResult:
    """Find a free polyline to one of the goals: straight lines to the cheapest first, then OMPL's RRT-Connect.

    Every edge of the path was found free by the query's checker. The same query, settings and state of `rng` give the
    same path.

    Raises:
        MotionQueryError: The arrays of the query do not have the same number of joints.
    """
    _check_shapes(query)
    refusal = _refuse_start(query)
    if refusal is not None:
        return MotionResult(refusal)
    metric = JointMetric.from_velocity_limits(query.velocity_max, query.start.size)
    costs = metric.distances(query.start, query.goals) if query.goal_costs is None else query.goal_costs
    order, refusal = _goals_within_limits(query, costs)
    if refusal is not None:
        return MotionResult(refusal)
    search = _PathSearch(query, settings, rng, metric, costs)
    near = order[: _near_count(costs[order], settings.near_share)]
    result = search.to_any(near)
    if result.path is None and near.size < order.size:
        everywhere = search.to_any(order, asked=near.size)
        result = replace(everywhere, statistics=everywhere.statistics.including(result.statistics))
    return result


@dataclass(frozen=True, eq=False)
class _PathSearch:
    """One query with what all its attempts share. `order` holds indices of goals, the cheapest first."""

    query: MotionQuery
    settings: MotionSettings
    rng: np.random.Generator
    metric: JointMetric
    costs: NDArray[np.float64]
    """(k,) of going straight to each goal."""

    def to_any(self, order: NDArray[np.int64], asked: int = 0) -> MotionResult:
        """Go to one of these goals (k,), straight if that is possible; to the first `asked` it is known not to be."""
        attempts = order[asked : self.settings.straight_attempts]
        for tried, index in enumerate(attempts, start=1):
            if self.query.edge_checker.edge_free(self.query.start, self.query.goals[index]):
                path = np.stack([self.query.start, self.query.goals[index]])
                length = self.metric.length(path)
                statistics = MotionStatistics(straight_attempts=tried, length_found=length, length=length)
                return MotionResult(MotionOutcome.FOUND, path, int(index), statistics)
        free = _free_goals(self.query, order, self.settings.max_goals)
        spent = MotionStatistics(straight_attempts=attempts.size)
        if free.size == 0:
            return MotionResult(MotionOutcome.GOALS_IN_COLLISION, statistics=spent)
        found = self._search(free)
        return replace(found, statistics=found.statistics.including(spent))

    def _search(self, order: NDArray[np.int64]) -> MotionResult:
        """Search and shorten as often as the settings say, and return the path of least cost."""
        best, least = MotionResult(MotionOutcome.ITERATIONS_EXHAUSTED), math.inf
        for _ in range(self.settings.searches):
            other = self._search_once(order)
            cost = self._cost(other)
            if cost < least:
                best, other, least = other, best, cost
            best = replace(best, statistics=best.statistics.including(other.statistics))
            if least <= self.settings.good_share * self.costs[order[0]]:
                break
        return best

    def _search_once(self, order: NDArray[np.int64]) -> MotionResult:
        query, settings, goals = self.query, self.settings, self.query.goals[order]
        ends = np.vstack([query.start, goals])
        low = np.maximum(query.position_min, ends.min(axis=0) - settings.sampling_margin)
        high = np.minimum(query.position_max, ends.max(axis=0) + settings.sampling_margin)
        growth = grow_trees(
            TreeProblem(query.edge_checker, query.start, goals, low, high, self.metric),
            step_max=settings.step_max,
            max_iterations=settings.max_iterations,
            seed=int(self.rng.integers(1, 2**31)),
        )
        statistics = MotionStatistics(iterations=growth.iterations, edges_checked=growth.edges_checked)
        found, goal = growth.path, growth.goal_index
        if found is None and query.source is not None:
            way = find_way(
                query.start, goals, query.source, query.edge_checker, self.metric, settings.roadmap, self.rng
            )
            found, goal = way.path, way.goal_index
            statistics = replace(statistics, edges_checked=statistics.edges_checked + way.edges_checked)
        if found is None:
            return MotionResult(MotionOutcome.ITERATIONS_EXHAUSTED, statistics=statistics)
        path = shorten(found, query.edge_checker, self.metric, settings.shortcut_attempts, self.rng)
        lengths = {"length_found": self.metric.length(found), "length": self.metric.length(path)}
        statistics = replace(statistics, **lengths)
        return MotionResult(MotionOutcome.FOUND, path, int(order[goal]), statistics)

    def _cost(self, found: MotionResult) -> float:
        """Return what going straight to the goal costs, times the detour of the path."""
        if found.path is None or found.goal_index is None:
            return math.inf
        straight = self.metric.distances(self.query.start, found.path[-1:])[0]
        return float(self.costs[found.goal_index] * (found.statistics.length / straight if straight > 0.0 else 1.0))


def _near_count(costs: NDArray[np.float64], share: float) -> int:
    """Return how many of ascending costs are at most `share` times the first."""
    return max(1, int(np.searchsorted(costs, share * costs[0], side="right"))) if math.isfinite(share) else costs.size


def _check_shapes(query: MotionQuery) -> None:
    n = query.start.size
    if query.goals.ndim != 2 or query.goals.shape[1] != n:
        raise MotionQueryError(f"goals have shape {query.goals.shape}; they need (k, {n}) like the start ({n},)")
    for name in ("position_min", "position_max", "velocity_max"):
        array = getattr(query, name)
        if array is not None and array.shape != (n,):
            raise MotionQueryError(f"{name} has shape {array.shape}; it needs ({n},) like the start")


def _refuse_start(query: MotionQuery) -> MotionOutcome | None:
    if not np.all((query.start >= query.position_min) & (query.start <= query.position_max)):
        return MotionOutcome.START_OUT_OF_LIMITS
    if not query.edge_checker.state_free(query.start):
        return MotionOutcome.START_IN_COLLISION
    return None


def _goals_within_limits(
    query: MotionQuery, costs: NDArray[np.float64]
) -> tuple[NDArray[np.int64], MotionOutcome | None]:
    """Indices of the goals within the joint limits, cheapest first, or why there are none."""
    if query.goals.shape[0] == 0:
        return np.empty(0, dtype=np.int64), MotionOutcome.NO_GOAL
    within = np.flatnonzero(np.all((query.goals >= query.position_min) & (query.goals <= query.position_max), axis=1))
    if not within.size:
        return within, MotionOutcome.GOALS_OUT_OF_LIMITS
    return within[np.argsort(costs[within], kind="stable")], None


def _free_goals(query: MotionQuery, order: NDArray[np.int64], max_goals: int) -> NDArray[np.int64]:
    """The first `max_goals` indices of `order` whose goals are free."""
    free: list[int] = []
    for index in order:
        if len(free) == max_goals:
            break
        if query.edge_checker.state_free(query.goals[index]):
            free.append(int(index))
    return np.array(free, dtype=np.int64)


RELATIVE_GAIN_MIN = 1e-3
"""A cut that saves less than this part of the path's length is not worth a collision check."""


def shorten(
    path: NDArray[np.float64], checker: EdgeChecker, metric: JointMetric, attempts: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Shorten the free polyline path (m, n): leave out vertices, then replace random stretches by straight lines.

    Ends stay. Every new leg was found free by the checker; the length in the metric never grows. Geraerts and
    Overmars, "Creating high-quality paths for motion planning", IJRR 2007, section 3.
    """
    path = _leave_out_vertices(path, checker)
    for _ in range(attempts):
        if path.shape[0] == 2:
            break
        path = _cut_once(path, checker, metric, rng)
    return _leave_out_vertices(path, checker)


def _leave_out_vertices(path: NDArray[np.float64], checker: EdgeChecker) -> NDArray[np.float64]:
    """From each vertex kept, go straight to the last one that can be reached so."""
    kept = [0]
    last = path.shape[0] - 1
    while kept[-1] < last:
        following = kept[-1] + 1
        for candidate in range(last, following, -1):
            if checker.edge_free(path[kept[-1]], path[candidate]):
                following = candidate
                break
        kept.append(following)
    return path[kept]


def _cut_once(
    path: NDArray[np.float64], checker: EdgeChecker, metric: JointMetric, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Connect two random points of the path, on different legs, by a straight line if that is free and shorter."""
    arc = np.concatenate([[0.0], np.cumsum(metric.leg_lengths(path))])
    s_from, s_to = np.sort(rng.random(2)) * arc[-1]
    leg_from, leg_to = np.clip(np.searchsorted(arc, [s_from, s_to], side="right") - 1, 0, path.shape[0] - 2)
    if leg_from == leg_to:
        return path
    q_from = _point_on_leg(path, arc, int(leg_from), s_from)
    q_to = _point_on_leg(path, arc, int(leg_to), s_to)
    saved = (s_to - s_from) - metric.length(np.stack([q_from, q_to]))
    if saved < RELATIVE_GAIN_MIN * arc[-1] or not checker.edge_free(q_from, q_to):
        return path
    return np.vstack([path[: leg_from + 1], q_from, q_to, path[leg_to + 1 :]])


def _point_on_leg(path: NDArray[np.float64], arc: NDArray[np.float64], leg: int, s: float) -> NDArray[np.float64]:
    fraction = (s - arc[leg]) / (arc[leg + 1] - arc[leg])
    return path[leg] + fraction * (path[leg + 1] - path[leg])
