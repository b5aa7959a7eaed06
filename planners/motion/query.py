"""Free motion of one or both arms from one joint vector to the best of several."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from planners.errors import LiftwrightError
from planners.motion.checker import EdgeChecker
from planners.motion.lazy_roadmap import PostureSource, RoadmapSettings


class MotionOutcome(Enum):
    """Why a motion query ended. The value is the sentence shown to a person."""

    FOUND = "A collision-free path was found."
    START_OUT_OF_LIMITS = "The start lies outside the joint limits."
    START_IN_COLLISION = "The start is in collision."
    NO_GOAL = "No goal was given."
    GOALS_OUT_OF_LIMITS = "Every goal lies outside the joint limits."
    GOALS_IN_COLLISION = "Every goal within the joint limits is in collision."
    ITERATIONS_EXHAUSTED = "No way past what stands there was found in as many tries as are made."


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
    source: PostureSource | None = None
    """Of postures that ways are looked for through where trees do not find each other."""


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
    roadmap: RoadmapSettings = RoadmapSettings()  # noqa: RUF009 - frozen
    """Of the query's source of postures, if it has one."""
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
