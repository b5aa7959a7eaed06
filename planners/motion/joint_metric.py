"""How far two joint vectors are apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class JointMetric:
    """Euclidean distance of joint vectors in which a joint counts by the time it needs: |w * (q_b - q_a)|.

    The unit is rad of the slowest joint: a joint that turns twice as fast has weight one half.
    """

    weights: NDArray[np.float64]
    """(n,), 1 for the slowest joint."""

    @staticmethod
    def from_velocity_limits(velocity_max: NDArray[np.float64] | None, n: int) -> JointMetric:
        """Metric of joints with these limits (n,) [rad/s]; None weighs all n joints the same."""
        return JointMetric(np.ones(n) if velocity_max is None else velocity_max.min() / velocity_max)

    def distances(self, q: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance (k,) from q (n,) to each row of others (k, n)."""
        return np.sqrt(np.sum(((others - q) * self.weights) ** 2, axis=1))

    def length(self, path: NDArray[np.float64]) -> float:
        """Length of the polyline through the rows of path (m, n)."""
        return float(self.leg_lengths(path).sum())

    def leg_lengths(self, path: NDArray[np.float64]) -> NDArray[np.float64]:
        """Length (m - 1,) of each leg of the polyline through the rows of path (m, n)."""
        return np.sqrt(np.sum((np.diff(path, axis=0) * self.weights) ** 2, axis=1))
