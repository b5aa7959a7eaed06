"""What an edge of the Manipulation State Graph costs: paper B, eqs. (6) to (9), one function an equation.

Eq. (10), the joint torques of both ends of an edge on which the hold changes, depends on nodes: the node examiner works
out the part of one node, its load, and the search adds the loads of both ends of such an edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class TransitionCost:
    """The weights of the edge costs. The paper publishes none; 1 for both is our choice."""

    k: float = 1.0
    """Cost of a transfer within one contact state, eq. (6)."""
    omega: float = 1.0
    """Weight of a change of contact state, eq. (9)."""

    def same_contact(self) -> float:
        """Cost of moving the plate within one contact state with one hold, eq. (6)."""
        return self.k

    def contact_change(self, restraint_before: int, restraint_after: int) -> float:
        """Cost of a change of contact state with one hold, eq. (9): less restraint is cheaper to reach."""
        return self.omega * math.exp(-(restraint_before - restraint_after))
