"""The motion of one arm while the other stands still: through free space, and its place among all twelve joints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planners.cell.arm import Arm
from planners.collision.model import CollisionQuery
from planners.geometry.pose import Array
from planners.graph.rejections import Rejection
from planners.motion.blended_path import BlendedPath
from planners.motion.checker import ArmEdgeChecker, EdgeChecker
from planners.motion.lazy_roadmap import PostureSource
from planners.motion.path_search import plan_motion
from planners.motion.query import MotionOutcome, MotionQuery, MotionSettings
from planners.motion.trajectory import Trajectory


class Stuck(Exception):
    """A step cannot be moved; `rejection` says why."""

    def __init__(self, rejection: Rejection) -> None:
        self.rejection = rejection
        super().__init__(rejection.reason)


@dataclass(frozen=True, eq=False)
class FreeMove:
    """One arm that is to go through free space."""

    mover: str
    """How a report names what moves."""
    arm: Arm
    joints: slice
    """The places of the arm's joints among all twelve."""
    q: Array
    """(12,) where both arms are [rad]."""
    goals: Array
    """(k, 6) to any of which the arm may go [rad]."""
    query: CollisionQuery
    """Whom it must not touch."""
    costs: Array | None = None
    """(k,) of going straight to each goal; by the joints' way if left out."""
    source: PostureSource | None = None
    """Of postures that the way may lead through."""

    @property
    def start(self) -> Array:
        """(6,) where the arm is [rad]."""
        return self.q[self.joints].copy()

    def checker(self) -> ArmEdgeChecker:
        """Return who is asked whether edges are free of collision."""
        return ArmEdgeChecker(self.query, self.q.copy(), self.joints)


PATIENCE = 8
"""So many searches in a row that were made once more in vain end that: what is asked for then has seldom a path."""


NOT_HELD = {
    MotionOutcome.START_IN_COLLISION: "What it carries would not be held at the start.",
    MotionOutcome.GOALS_IN_COLLISION: "What it carries would be held at no goal within the joint limits.",
}
"""What is told where an end of a motion is refused though nothing touches there: checkers ask for more than that."""


class FreeMotion:
    """Searches for free motion of one arm at a time."""

    def __init__(
        self, settings: MotionSettings, rng: np.random.Generator, *, persistence: int = 1, touch: str = "{} and {}"
    ) -> None:
        """Nothing is searched yet.

        Args:
            settings: of each search.
            rng: of all of them.
            persistence: where a search was exhausted, it is made once more with so many times its iterations, unless
                that has lately been in vain.
            touch: how a report says of two bodies that they are in the way.
        """
        self.searches = 0
        """How many were made."""
        self._in_vain = 0
        """Searches that were made once more and found nothing, since the last that did."""
        self._settings, self._rng, self._persistence, self._touch = settings, rng, persistence, touch

    def find(self, move: FreeMove, checker: EdgeChecker | None = None) -> tuple[BlendedPath, int]:
        """Return a free path of the arm's six joints, and to which of the goals it leads.

        Args:
            move: that is asked for.
            checker: of edges, if there is more to ask than whether they are free of collision.

        Raises:
            Stuck: none was found; says which bodies are in the way, where an end of the motion is what collides.
        """
        arm, checker = move.arm, checker or move.checker()
        query = MotionQuery(
            move.start,
            move.goals,
            arm.position_min,
            arm.position_max,
            checker,
            arm.velocity_max,
            move.costs,
            move.source,
        )
        self.searches += 1
        result = plan_motion(query, self._settings, self._rng)
        exhausted = result.outcome is MotionOutcome.ITERATIONS_EXHAUSTED
        if exhausted and self._persistence > 1 and self._in_vain < PATIENCE:
            self.searches += 1
            patient = replace(self._settings, max_iterations=self._persistence * self._settings.max_iterations)
            result = plan_motion(query, patient, self._rng)
            self._in_vain = 0 if result.path is not None else self._in_vain + 1
        if result.path is None or result.goal_index is None:
            raise Stuck(Rejection("transit", f"free motion of the {move.mover}: {self._told(move, result.outcome)}"))
        return BlendedPath.through(result.path, checker), result.goal_index

    def _told(self, move: FreeMove, outcome: MotionOutcome) -> str:
        """Say why there is no way: with the bodies in the way, or that what is carried would not be held there."""
        if outcome not in NOT_HELD:
            return outcome.value
        within = np.all((move.goals >= move.arm.position_min) & (move.goals <= move.arm.position_max), axis=1)
        at_goals = among_all(move.q, move.joints, move.goals[within])
        ends = move.q[None] if outcome is MotionOutcome.START_IN_COLLISION else at_goals
        for end in ends:
            names = touching(move.query, end[None])
            if names is not None:
                return f"{outcome.value} ({self._touch.format(*names)})"
        return NOT_HELD[outcome]


def touching(query: CollisionQuery, Q: Array) -> tuple[str, str] | None:
    """Name the bodies that touch along the polyline through Q (n, 12) [rad]; None where it is free."""
    pair = int(query.first_collision(Q)[0]) if len(Q) == 1 else query.path(Q).pair
    return None if pair < 0 else query.pair_names(pair)


def among_all(q: Array, joints: slice, positions: Array) -> Array:
    """Put one arm's positions (n, 6) among all twelve: (n, 12); the others stay as they are in q (12,) [rad]."""
    Q = np.repeat(q[None], len(positions), axis=0)
    Q[:, joints] = positions
    return Q


def of_both_arms(trajectory: Trajectory, q: Array, joints: slice) -> Trajectory:
    """Widen one arm's trajectory to all twelve joints; the others stay as they are in q (12,) [rad]."""
    still = np.zeros(len(q))
    return replace(
        trajectory,
        positions=among_all(q, joints, trajectory.positions),
        velocities=among_all(still, joints, trajectory.velocities),
        accelerations=among_all(still, joints, trajectory.accelerations),
    )


def interpolated(coarse: Array, part: Array) -> Array:
    """Interpolate between evenly spaced rows (m, k) at parts (n,) of the way: (n, k)."""
    at = np.clip(part, 0.0, 1.0) * (len(coarse) - 1)
    below = np.minimum(at.astype(int), len(coarse) - 2)
    weight = (at - below)[:, None]
    return (1.0 - weight) * coarse[below] + weight * coarse[below + 1]


def openings(time: Array, start: float, end: float) -> Array:
    """Return openings of a hand (n,) that go smoothly from one to the other over times (n,) from 0 [s] [m]."""
    if start == end:
        return np.full(len(time), start)
    widths = start + (0.5 - 0.5 * np.cos(np.pi * time / time[-1])) * (end - start)
    widths[-1] = end
    return widths
