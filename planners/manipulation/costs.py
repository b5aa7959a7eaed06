"""What an edge of the Manipulation State Graph costs: paper B, eqs. (6) to (10), one function an equation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array


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


def torque_load(joint_torques: Array) -> float:
    """Sum of the magnitudes of joint torques [Nm]: one end's part of eq. (10)."""
    return float(np.abs(joint_torques).sum())


def hold_change(load_before: float, load_after: float) -> float:
    """Cost of an edge on which the hold changes, eq. (10), from the torque loads of its two ends [Nm]."""
    return load_before + load_after
