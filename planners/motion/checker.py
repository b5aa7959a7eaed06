"""What a path search asks about the space of joint vectors, and its answer by a collision query over both arms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planners.collision.model import CollisionQuery


class EdgeChecker(Protocol):
    """Answers whether joint vectors q (n,) [rad] are free; each method should be one compiled call.

    Both ends of an edge belong to it. An answer "free" must hold for every point of the edge, not only for the
    points the checker happens to look at.
    """

    def state_free(self, q: NDArray[np.float64]) -> bool:
        """Whether q (n,) touches nothing."""
        ...

    def edge_free(self, q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> bool:
        """Whether the straight line from q_from (n,) to q_to (n,) touches nothing."""
        ...

    def path_free(self, path: NDArray[np.float64]) -> bool:
        """Whether the polyline through the rows of path (m, n) touches nothing."""
        ...


@dataclass(frozen=True, eq=False)
class ArmEdgeChecker:
    """An `EdgeChecker` of the joints `joints` of q12; the other joints stand still at `q_rest`."""

    query: CollisionQuery
    q_rest: NDArray[np.float64]
    """(12,) [rad]; entries of the moving joints do not matter."""
    joints: slice
    """slice(0, 6) left arm, slice(6, 12) right arm, slice(0, 12) both."""

    def state_free(self, q: NDArray[np.float64]) -> bool:
        """Whether q (n,) [rad] touches nothing."""
        return bool(self.query.first_collision(self._both_arms(q[None]))[0] < 0)

    def edge_free(self, q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> bool:
        """Whether the straight line from q_from to q_to, (n,) each [rad], touches nothing."""
        ends = self._both_arms(np.stack([q_from, q_to]))
        return bool(self.query.edge(ends[0], ends[1]).free)

    def path_free(self, path: NDArray[np.float64]) -> bool:
        """Whether the polyline through the rows of path (m, n) [rad] touches nothing."""
        return bool(self.query.path(self._both_arms(path)).free)

    def _both_arms(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        q12 = np.repeat(self.q_rest[None], q.shape[0], axis=0)
        q12[:, self.joints] = q
        return q12
