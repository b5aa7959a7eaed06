"""toppra along a blended path of ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import toppra
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint
from toppra.interpolator import AbstractGeometricPath

from planners.motion.blended_path import BlendedPath
from planners.motion.timing import JointLimits
from tests.benchmarks.peers.contest import Samples


class ToppraPath(AbstractGeometricPath):
    """The piece of a blended path between two stops."""

    def __init__(self, path: BlendedPath, ends: tuple[float, float]) -> None:
        self.path, self.ends = path, ends

    def __call__(self, path_positions, order: int = 0):
        """Evaluate positions or derivatives at parameters of any shape."""
        s = np.asarray(path_positions, dtype=float)
        points = self.path.evaluate(np.atleast_1d(s))
        values = (points.positions, points.first, points.second)[order]
        return values if s.ndim else values[0]

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.path.waypoints.shape[1]

    @property
    def path_interval(self):
        """First and last parameter."""
        return np.array(self.ends)


def time_with_toppra(
    path: BlendedPath, pieces: Sequence[tuple[float, float]], limits: JointLimits, step: float
) -> Samples:
    """Return the samples, at most `step` apart [s], of the fastest motion that rests at the ends of all pieces.

    Raises:
        ArithmeticError: It finds no motion.
    """
    toppra.setup_logging("ERROR")
    found: list[Samples] = []
    begin = 0.0
    for ends in pieces:
        # Of its two discretizations this is the one that its documentation calls precise between grid points.
        constraints = [
            JointVelocityConstraint(np.column_stack([-limits.velocity, limits.velocity])),
            JointAccelerationConstraint(
                np.column_stack([-limits.acceleration, limits.acceleration]),
                discretization_scheme=toppra.constraint.DiscretizationType.Interpolation,
            ),
        ]
        timed = TOPPRA(
            constraints,
            ToppraPath(path, ends),
            gridpoints=path.grid(*ends),
            solver_wrapper="seidel",
            parametrizer="ParametrizeConstAccel",
        ).compute_trajectory()
        if timed is None:
            raise ArithmeticError("no motion")
        t = np.linspace(0.0, timed.duration, max(2, int(np.ceil(timed.duration / step)) + 1))
        found.append((begin + t, timed(t), timed(t, 1), timed(t, 2)))
        begin += timed.duration
    t, q, v, a = zip(*found, strict=True)
    return np.concatenate(t), np.vstack(q), np.vstack(v), np.vstack(a)
