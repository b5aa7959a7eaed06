"""OMPL's RRT-Connect with coal by pinocchio, as one writes it in Python: a callback tells whether a state is free."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from planners.geometry.pose import Array
from tests.benchmarks.bench_collision import PinocchioScene

RESOLUTION = 0.05
"""Between states that are looked at on a motion [rad]."""


@dataclass(frozen=True, eq=False)
class OmplCoalPlanner:
    """Plans for the joints `joints` of both arms; the others stay at `q_rest`."""

    scene: PinocchioScene
    q_rest: Array
    joints: slice
    low: Array
    high: Array

    def plan(self, start: Array, goals: Array, seed: int, seconds: float) -> Array | None:
        """Return a simplified path (m, n) to one of the goals (k, n), or None."""
        ou.setLogLevel(ou.LOG_NONE)
        ou.RNG.setSeed(seed)
        count = start.size
        space, bounds = ob.RealVectorStateSpace(count), ob.RealVectorBounds(count)
        for i in range(count):
            bounds.setLow(i, float(self.low[i]))
            bounds.setHigh(i, float(self.high[i]))
        space.setBounds(bounds)
        setup = og.SimpleSetup(space)
        q = self.q_rest.copy()

        def free(state: ob.State) -> bool:
            q[self.joints] = cast("ob.RealVectorStateType", state)[0:count]
            return not self.scene.broadphase(q)

        setup.setStateValidityChecker(free)
        information = setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(RESOLUTION / space.getMaximumExtent())
        setup.setStartState(_state(information, start))
        states = ob.GoalStates(information)
        for goal in goals:
            states.addState(_state(information, goal))
        setup.setGoal(states)
        setup.setPlanner(og.RRTConnect(information))
        setup.solve(seconds)
        if not setup.haveExactSolutionPath():
            return None
        setup.simplifySolution()
        path = setup.getSolutionPath()
        return np.array([cast("ob.RealVectorStateType", state)[0:count] for state in path.getStates()])


def _state(information: ob.SpaceInformation, q: Array) -> ob.State:
    state = cast("ob.RealVectorStateType", information.allocState())
    for i, value in enumerate(q):
        state[i] = float(value)
    return state
