"""What a path search asks about the space of joint vectors."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


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
