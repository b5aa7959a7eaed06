"""Free motion of one or both arms from one joint vector to the best of several."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from planners.errors import LiftwrightError
from planners.motion.checker import EdgeChecker
from planners.motion.joint_metric import JointMetric
from planners.motion.rrt_connect import TreeProblem, grow_trees
from planners.motion.shortcut import shorten


class MotionOutcome(Enum):
    """Why a motion query ended. The value is the sentence shown to a person."""

    FOUND = "A collision-free path was found."
    START_OUT_OF_LIMITS = "The start lies outside the joint limits."
    START_IN_COLLISION = "The start is in collision."
    NO_GOAL = "No goal was given."
    GOALS_OUT_OF_LIMITS = "Every goal lies outside the joint limits."
    GOALS_IN_COLLISION = "Every goal within the joint limits is in collision."
    ITERATIONS_EXHAUSTED = "No path was found within the iterations allowed."


@dataclass(frozen=True, eq=False)
class MotionQuery:
    """Bring the joints from `start` to any one of `goals` through free space while the rest of the scene stands still.

    Windings count: goals that differ by full turns are different goals.
    """

    start: NDArray[np.float64]
    """(n,) [rad]; n is 6 for one arm, 12 for both."""
    goals: NDArray[np.float64]
    """(k, n) [rad], in any order."""
    position_min: NDArray[np.float64]
    """(n,) [rad]."""
    position_max: NDArray[np.float64]
    """(n,) [rad]."""
    edge_checker: EdgeChecker
    velocity_max: NDArray[np.float64] | None = None
    """(n,) [rad/s]: distances count a joint by the time it needs. None: all joints count the same."""
    goal_costs: NDArray[np.float64] | None = None
    """(k,) of going straight to each goal, in any unit: the cheapest are tried first. None: the nearest are."""


@dataclass(frozen=True)
class MotionSettings:
    """How much a path search may do. Distances are in rad of the slowest joint (see `JointMetric`)."""

    straight_attempts: int = 6
    """Goals that are tried by a straight line before any search; 10 of 17 queries of a plan end there."""
    max_goals: int = 24
    """Nearest goals the search looks at; more windings only dilute the goal tree."""
    max_iterations: int = 1000
    """Iterations of RRT-Connect; paths that exist were found within 353 in trials of tool plans."""
    step_max: float = 1.0
    """Longest edge of the trees [rad]; edges are checked over their whole length, whatever it is."""
    sampling_margin: float = np.pi
    """Samples stay in the box around start and goals, grown by this [rad] and cut at the joint limits."""
    shortcut_attempts: int = 60
    """Random cuts tried on a path that was found by search."""
    searches: int = 1
    """How often a goal is searched for, until a path is at most `good_share` times as long as the cheapest straight."""
    good_share: float = 1.2
    """See `searches`."""
    near_share: float = math.inf
    """Goals that cost at most so many times as much as the cheapest are tried first, by straight lines and search:
    a free straight line to a goal far away is no better than a short way round an obstacle."""


@dataclass(frozen=True)
class MotionStatistics:
    """What a query cost."""

    straight_attempts: int = 0
    """Straight lines tried."""
    iterations: int = 0
    """Iterations of RRT-Connect."""
    edges_checked: int = 0
    """Edges checked while the trees grew."""
    length_found: float = 0.0
    """Length of the path before it was shortened [rad of the slowest joint]."""
    length: float = 0.0
    """Length of the path returned [rad of the slowest joint]."""

    def including(self, other: MotionStatistics) -> MotionStatistics:
        """Return what both took together, with the lengths of this one."""
        return replace(
            self,
            straight_attempts=self.straight_attempts + other.straight_attempts,
            iterations=self.iterations + other.iterations,
            edges_checked=self.edges_checked + other.edges_checked,
        )


@dataclass(frozen=True, eq=False)
class MotionResult:
    """How a query ended; `path` (m, n) starts at the query's start and ends at `goals[goal_index]`, both exactly."""

    outcome: MotionOutcome
    path: NDArray[np.float64] | None = None
    goal_index: int | None = None
    statistics: MotionStatistics = field(default_factory=MotionStatistics)


class MotionQueryError(LiftwrightError):
    """A motion query whose arrays do not fit together."""


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
    near = order[: _near_count(costs[order], settings.near_share)]
    result = _to_any(query, settings, rng, metric, near, costs)
    if result.path is None and near.size < order.size:
        everywhere = _to_any(query, settings, rng, metric, order, costs)
        result = replace(everywhere, statistics=everywhere.statistics.including(result.statistics))
    return result


def _to_any(
    query: MotionQuery,
    settings: MotionSettings,
    rng: np.random.Generator,
    metric: JointMetric,
    order: NDArray[np.int64],
    costs: NDArray[np.float64],
) -> MotionResult:
    attempts = order[: settings.straight_attempts]
    for tried, index in enumerate(attempts, start=1):
        if query.edge_checker.edge_free(query.start, query.goals[index]):
            path = np.stack([query.start, query.goals[index]])
            length = metric.length(path)
            statistics = MotionStatistics(straight_attempts=tried, length_found=length, length=length)
            return MotionResult(MotionOutcome.FOUND, path, int(index), statistics)
    free = _free_goals(query, order, settings.max_goals)
    if free.size == 0:
        return MotionResult(MotionOutcome.GOALS_IN_COLLISION, statistics=MotionStatistics(attempts.size))
    return _search(query, settings, rng, metric, free, costs)


def _near_count(costs: NDArray[np.float64], share: float) -> int:
    """Return how many of ascending costs are at most `share` times the first."""
    return max(1, int(np.searchsorted(costs, share * costs[0], side="right"))) if math.isfinite(share) else costs.size


def _search(
    query: MotionQuery,
    settings: MotionSettings,
    rng: np.random.Generator,
    metric: JointMetric,
    order: NDArray[np.int64],
    costs: NDArray[np.float64],
) -> MotionResult:
    """Search and shorten as often as the settings say, and return the path of least cost."""
    attempts = min(settings.straight_attempts, order.size)
    best = MotionResult(MotionOutcome.ITERATIONS_EXHAUSTED, statistics=MotionStatistics(attempts))
    least = math.inf
    for _ in range(settings.searches):
        other = _search_once(query, settings, rng, metric, order)
        if other.path is not None and other.goal_index is not None:
            straight = metric.distances(query.start, other.path[-1:])[0]
            detour = other.statistics.length / straight if straight > 0.0 else 1.0
            cost = costs[other.goal_index] * detour
            if cost < least:
                best, other, least = other, best, cost
        best = replace(best, statistics=best.statistics.including(other.statistics))
        if least <= settings.good_share * costs[order[0]]:
            break
    return best


def _search_once(
    query: MotionQuery,
    settings: MotionSettings,
    rng: np.random.Generator,
    metric: JointMetric,
    order: NDArray[np.int64],
) -> MotionResult:
    goals = query.goals[order]
    ends = np.vstack([query.start, goals])
    low = np.maximum(query.position_min, ends.min(axis=0) - settings.sampling_margin)
    high = np.minimum(query.position_max, ends.max(axis=0) + settings.sampling_margin)
    growth = grow_trees(
        TreeProblem(query.edge_checker, query.start, goals, low, high, metric),
        step_max=settings.step_max,
        max_iterations=settings.max_iterations,
        seed=int(rng.integers(1, 2**31)),
    )
    statistics = MotionStatistics(iterations=growth.iterations, edges_checked=growth.edges_checked)
    if growth.path is None:
        return MotionResult(MotionOutcome.ITERATIONS_EXHAUSTED, statistics=statistics)
    path = shorten(growth.path, query.edge_checker, metric, settings.shortcut_attempts, rng)
    statistics = replace(statistics, length_found=metric.length(growth.path), length=metric.length(path))
    return MotionResult(MotionOutcome.FOUND, path, int(order[growth.goal_index]), statistics)


def _check_shapes(query: MotionQuery) -> None:
    n = query.start.size
    if query.goals.ndim != 2 or query.goals.shape[1] != n:
        raise MotionQueryError(f"goals have shape {query.goals.shape}; they need (k, {n}) like the start ({n},)")
    for name in ("position_min", "position_max", "velocity_max"):
        array = getattr(query, name)
        if array is not None and array.shape != (n,):
            raise MotionQueryError(f"{name} has shape {array.shape}; it needs ({n},) like the start")


def _refuse_start(query: MotionQuery) -> MotionOutcome | None:
    if np.any(query.start < query.position_min) or np.any(query.start > query.position_max):
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
    within = np.all(
        (query.goals >= query.position_min) & (query.goals <= query.position_max),
        axis=1,
    )
    if not within.any():
        return np.empty(0, dtype=np.int64), MotionOutcome.GOALS_OUT_OF_LIMITS
    return np.argsort(np.where(within, costs, np.inf), kind="stable")[: int(within.sum())], None


def _free_goals(query: MotionQuery, order: NDArray[np.int64], max_goals: int) -> NDArray[np.int64]:
    """The first `max_goals` indices of `order` whose goals are free."""
    free: list[int] = []
    for index in order:
        if len(free) == max_goals:
            break
        if query.edge_checker.state_free(query.goals[index]):
            free.append(int(index))
    return np.array(free, dtype=np.int64)
