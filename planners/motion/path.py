"""Geometric paths of the joints, without time; those of an exact function too, such as inverse kinematics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class PathPoints:
    """A path and its first two derivatives at n parameters s; k joints."""

    positions: NDArray[np.float64]
    """(n, k) [rad]."""
    first: NDArray[np.float64]
    """(n, k) dq/ds."""
    second: NDArray[np.float64]
    """(n, k) d²q/ds²."""


class JointPath(Protocol):
    """A curve q(s) for s from 0 to `length`, twice continuously differentiable except at `stops`."""

    @property
    def length(self) -> float:
        """The parameter's end; any unit of s the path likes. 0 is a path that does not move."""
        ...

    @property
    def stops(self) -> NDArray[np.float64]:
        """(m,) parameters strictly inside (0, length), rising, at which q'(s) jumps: motion must rest there."""
        ...

    def grid(self, s_from: float, s_to: float) -> NDArray[np.float64]:
        """Rising parameters (n,) from s_from to s_to, ends included, dense enough to check limits only at them."""
        ...

    def evaluate(self, s: NDArray[np.float64]) -> PathPoints:
        """Points at s (n,). At a stop q' and q'' may be those of either side."""
        ...


DIFFERENCE_STEP = 1e-3
"""Step of the differences, as a part of the path's length; with 1e-13 rad of noise in q, q'' is good to 1e-6."""


@dataclass(frozen=True, eq=False)
class CurvePath:
    """The curve `function(s)` for s in [0, length], derivatives by differences of second order.

    Between stops the function must be twice continuously differentiable; it is never called outside [0, length], and
    differences never reach across a stop.
    """

    function: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    """s (n,) -> q (n, k) [rad], exact."""
    length: float
    stops: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    """(m,) inner parameters at which q'(s) jumps, rising."""
    cells: int = 200
    """Grid cells over the whole length; the limits are exceeded by less than 2 % between the grid's points."""

    def grid(self, s_from: float, s_to: float) -> NDArray[np.float64]:
        """Evenly spaced parameters (n,) from s_from to s_to."""
        cells = max(40, int(np.ceil(self.cells * (s_to - s_from) / self.length)))
        return np.linspace(s_from, s_to, cells + 1)

    def evaluate(self, s: NDArray[np.float64]) -> PathPoints:
        """Points at s (n,): positions are exactly function(s)."""
        if self.length == 0.0:
            positions = self.function(s)
            return PathPoints(positions, np.zeros_like(positions), np.zeros_like(positions))
        knots = np.concatenate([[0.0], self.stops, [self.length]])
        piece = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, knots.size - 2)
        low, high = knots[piece], knots[piece + 1]
        step = np.minimum(DIFFERENCE_STEP * self.length, 0.25 * (high - low))
        middle = np.clip(s, low + step, high - step)
        stacked = np.concatenate([s, middle - step, middle, middle + step])
        at, before, centre, after = np.split(self.function(stacked), 4)
        h = step[:, None]
        second = (after - 2.0 * centre + before) / h**2
        # At the ends of a piece the parabola through the three inner points is differentiated off its centre.
        first = (after - before) / (2.0 * h) + (s - middle)[:, None] * second
        return PathPoints(at, first, second)
