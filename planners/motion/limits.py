"""How fast joints and other quantities may change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Greatest speed and acceleration of k joints."""

    velocity: NDArray[np.float64]
    """(k,) [rad/s], > 0."""
    acceleration: NDArray[np.float64]
    """(k,) [rad/s²], > 0."""


@dataclass(frozen=True, eq=False)
class RateLimit:
    """Limit on a scalar x that moves along with a path, such as the way a plate's centre has travelled.

    `|dx/ds · ds/dt| <= velocity` and `|dx/ds · d²s/dt²| <= acceleration`.
    """

    rate: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    """s (n,) -> dx/ds (n,), for a point p its |dp/ds|."""
    velocity: float
    """Unit of x per second; inf for none."""
    acceleration: float = np.inf
    """Unit of x per second squared; inf for none."""
