"""Geometric paths of the joints, without time."""

from __future__ import annotations

from dataclasses import dataclass
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
        """Rising parameters from s_from to s_to, ends included, dense enough to check limits at them only."""
        ...

    def evaluate(self, s: NDArray[np.float64]) -> PathPoints:
        """Points at s (n,). At a stop q' and q'' may be those of either side."""
        ...
