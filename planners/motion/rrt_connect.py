"""RRT-Connect as OMPL implements it, with one compiled collision check an edge."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from planners.motion.checker import EdgeChecker
from planners.motion.joint_metric import JointMetric

# OMPL seeds every sampler from one generator of the process and offers no way around it from Python. Seeding that
# generator and drawing from it must not be interleaved with another thread's search. OMPL's solve() keeps the
# interpreter's lock anyway, so that searches waiting for each other lose little.
_ompl_seed_generator = threading.Lock()


@dataclass(frozen=True, eq=False)
class TreeProblem:
    """What RRT-Connect is to connect; start and goals must be free and within low and high."""

    checker: EdgeChecker
    start: NDArray[np.float64]
    """(n,) [rad]."""
    goals: NDArray[np.float64]
    """(k, n) [rad]; they enter the goal tree one by one in this order, as the tree grows."""
    low: NDArray[np.float64]
    """(n,) [rad], samples lie between low and high."""
    high: NDArray[np.float64]
    """(n,) [rad]."""
    metric: JointMetric


@dataclass(frozen=True, eq=False)
class Growth:
    """How a search ended; `path` (m, n) [rad] leads from the start to `goals[goal_index]`, both exactly."""

    path: NDArray[np.float64] | None
    goal_index: int
    iterations: int
    edges_checked: int


class _CheckedEdges(ob.MotionValidator):
    """Hands OMPL's edges to the checker. OMPL's states are joint vectors times the metric's weights."""

    def __init__(
        self,
        space_information: ob.SpaceInformation,
        checker: EdgeChecker,
        metric: JointMetric,
    ) -> None:
        super().__init__(space_information)
        self.checker = checker
        self.unit = 1.0 / metric.weights
        self.count = 0

    def checkMotion(self, state_from: ob.State, state_to: ob.State) -> bool:
        self.count += 1
        q_from, q_to = self.joints([state_from, state_to])
        return bool(self.checker.edge_free(q_from, q_to))

    def joints(self, states: list[ob.State]) -> NDArray[np.float64]:
        """Joint vectors (m, n) [rad] of m states."""
        n = self.unit.size
        return np.array([cast("ob.RealVectorStateType", state)[0:n] for state in states]) * self.unit


class _IterationBudget:
    """Says stop after a number of iterations; RRT-Connect asks once an iteration."""

    def __init__(self, max_iterations: int) -> None:
        self.max_iterations = max_iterations
        self.asked = 0

    def __call__(self) -> bool:
        self.asked += 1
        return self.asked > self.max_iterations


def grow_trees(problem: TreeProblem, *, step_max: float, max_iterations: int, seed: int) -> Growth:
    """Search a path from the start to any of the goals.

    Kuffner and LaValle, "RRT-Connect", ICRA 2000. The same arguments give the same path.

    Args:
        problem: What to connect, and where.
        step_max: Longest edge, in the metric.
        max_iterations: The search gives up after so many samples.
        seed: Positive; all the randomness of the search.
    """
    ou.setLogLevel(ou.LOG_NONE)
    weights = problem.metric.weights
    information = ob.SpaceInformation(_space(problem.low * weights, problem.high * weights))
    information.setStateValidityChecker(ob.AllValidStateValidityChecker(information))
    edges = _CheckedEdges(information, problem.checker, problem.metric)
    information.setMotionValidator(edges)

    definition = ob.ProblemDefinition(information)
    definition.addStartState(_state(information, problem.start * weights))
    goal_states = ob.GoalStates(information)
    for goal in problem.goals:
        goal_states.addState(_state(information, goal * weights))
    definition.setGoal(goal_states)

    budget = _IterationBudget(max_iterations)
    with _ompl_seed_generator:
        # It draws from the generator too.
        information.setup()
        ou.RNG.setSeed(seed)
        planner = og.RRTConnect(information)
        planner.setRange(step_max)
        planner.setProblemDefinition(definition)
        planner.setup()
        planner.solve(ob.PlannerTerminationCondition(budget))
    iterations = min(budget.asked, max_iterations)
    if not definition.hasExactSolution():
        return Growth(None, -1, iterations, edges.count)
    path = edges.joints(cast("og.PathGeometric", definition.getSolutionPath()).getStates())
    goal_index = int(np.argmin(problem.metric.distances(path[-1], problem.goals)))
    path[0], path[-1] = problem.start, problem.goals[goal_index]
    return Growth(np.clip(path, problem.low, problem.high), goal_index, iterations, edges.count)


def _space(low: NDArray[np.float64], high: NDArray[np.float64]) -> ob.RealVectorStateSpace:
    bounds = ob.RealVectorBounds(low.size)
    for i in range(low.size):
        bounds.setLow(i, float(low[i]))
        bounds.setHigh(i, float(high[i]))
    space = ob.RealVectorStateSpace(low.size)
    space.setBounds(bounds)
    return space


def _state(information: ob.SpaceInformation, coordinates: NDArray[np.float64]) -> ob.State:
    state = cast("ob.RealVectorStateType", information.allocState())
    for i, value in enumerate(coordinates):
        state[i] = float(value)
    return state
