"""Our shortcuts beside OMPL's simplifier, on the same raw path of RRT-Connect."""

from __future__ import annotations

from typing import cast

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from planners.geometry.pose import Array
from planners.motion.checker import EdgeChecker
from planners.motion.joint_metric import JointMetric
from planners.motion.path_search import shorten
from planners.motion.query import MotionQuery, MotionSettings
from planners.motion.rrt_connect import TreeProblem, grow_trees

MAX_ITERATIONS = 10_000


def lengths_shortened(query: MotionQuery, goal: Array) -> tuple[float, float] | None:
    """Return the length of a raw path to `goal` after our shortcuts, and after OMPL's simplifier found no more to do.

    Both in rad of the slowest joint; None where RRT-Connect finds no path.
    """
    metric = JointMetric.from_velocity_limits(query.velocity_max, query.start.size)
    problem = TreeProblem(
        query.edge_checker, query.start, goal[None], query.position_min, query.position_max, metric
    )  # fmt: skip
    raw = grow_trees(problem, step_max=MotionSettings().step_max, max_iterations=MAX_ITERATIONS, seed=1).path
    if raw is None:
        return None
    ours = shorten(raw, query.edge_checker, metric, MotionSettings().shortcut_attempts, np.random.default_rng(0))
    return metric.length(ours), metric.length(_simplified(raw, query.edge_checker, metric))


class _Validator(ob.MotionValidator):
    def __init__(self, information: ob.SpaceInformation, checker: EdgeChecker, metric: JointMetric) -> None:
        super().__init__(information)
        self.checker, self.unit = checker, 1.0 / metric.weights

    def checkMotion(self, state_from: ob.State, state_to: ob.State) -> bool:
        q_from, q_to = _joints([state_from, state_to], self.unit.size) * self.unit
        return self.checker.edge_free(q_from, q_to)


def _simplified(raw: Array, checker: EdgeChecker, metric: JointMetric) -> Array:
    ou.setLogLevel(ou.LOG_NONE)
    count = raw.shape[1]
    space = ob.RealVectorStateSpace(count)
    space.setBounds(-7.0, 7.0)
    information = ob.SpaceInformation(space)
    information.setStateValidityChecker(ob.AllValidStateValidityChecker(information))
    validator = _Validator(information, checker, metric)
    information.setMotionValidator(validator)
    information.setup()
    path = og.PathGeometric(information)
    for q in raw * metric.weights:
        state = cast("ob.RealVectorStateType", information.allocState())
        for i in range(count):
            state[i] = float(q[i])
        path.append(state)
    ou.RNG.setSeed(1)
    og.PathSimplifier(information).simplifyMax(path)
    return _joints(path.getStates(), count) * validator.unit


def _joints(states: list[ob.State], count: int) -> Array:
    return np.array([cast("ob.RealVectorStateType", state)[0:count] for state in states])
