"""How the lifter holds the plate: three models of the suction cup, chosen by name.

Each model says, for a few variables of its own, which wrench they make, which linear limits they keep, how much
power the lifter can put into a moving plate, and how much it can lift. `pull` is the net pull outward, f_s in
paper B: the vacuum force less what the pad presses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import get_args

import numpy as np

from planners.balance.contacts import Cup
from planners.contract.task_spec import LifterModel
from planners.errors import LiftwrightError
from planners.geometry.pose import Array

_SQRT2, _SQRT3 = math.sqrt(2.0), math.sqrt(3.0)


@dataclass(frozen=True, eq=False)
class SuctionPad:
    """A pad that bears friction and a little bending: paper B, (5f)-(5h), or Dex-Net 3.0.

    Variables, all in N: fx, fy, pull, and the torques over the pad's radius. Friction is bounded by a grip of
    `grip_at_rest + grip_per_pull * pull`: the paper's is mu * pull, Dex-Net's mu * (vacuum - pull).
    """

    cup: Cup
    grip_at_rest: float
    """[N]"""
    grip_per_pull: float
    size: int = 6
    pull: int = 2
    """Index of the pull among the variables."""

    @property
    def bending_limit(self) -> float:
        """Largest |torque| about x or y over the radius, (5g) [N]."""
        return math.pi * self.cup.kappa / _SQRT2

    def limits(self) -> tuple[Array, Array]:
        """Return E (k, 6) and e (k,) [N]: the variables x are within the limits when `E @ x + e >= 0`."""
        rows, offsets = [], []
        for index, factor in ((0, _SQRT3), (1, _SQRT3), (5, _SQRT3)):
            for sign in (1.0, -1.0):
                row = np.zeros(6)
                row[index], row[self.pull] = sign * factor, self.grip_per_pull
                rows.append(row)
                offsets.append(self.grip_at_rest)
        for index in (3, 4):
            for sign in (1.0, -1.0):
                rows.append(sign * np.eye(6)[index])
                offsets.append(self.bending_limit)
        rows += [np.eye(6)[self.pull], -np.eye(6)[self.pull]]
        offsets += [0.0, self.cup.max_force]
        return np.stack(rows), np.array(offsets)

    def contact_map(self, up: Array) -> Array:
        """Return (6, size): takes the variables to the wrench on the plate, in the cup frame."""
        radius = self.cup.radius
        return np.diag([1.0, 1.0, -1.0, radius, radius, radius])

    def largest_power(self, velocity: Array, spin: Array, up: Array) -> Array:
        """Return the most power (...) [W] for the cup centre's velocity and the plate's spin (..., 3), plate axes."""
        R = self.cup.T_plate_cup[:3, :3]
        v, w = velocity @ R, spin @ R
        radius = self.cup.radius
        slip = (np.abs(v[..., 0]) + np.abs(v[..., 1]) + radius * np.abs(w[..., 2])) / _SQRT3
        # The pull enters linearly, so that the most is at no pull or at full pull.
        slack = slip * self.grip_at_rest
        taut = slip * self.grip_at_rest + self.cup.max_force * (slip * self.grip_per_pull - v[..., 2])
        return np.maximum(slack, taut) + radius * self.bending_limit * (np.abs(w[..., 0]) + np.abs(w[..., 1]))

    def largest_force(self) -> float:
        """Return an upper bound of the norm of the lifter's force [N]."""
        slack, taut = self._slope_friction()
        return max(slack, math.hypot(self.cup.max_force, taut))

    def largest_lift(self, max_tilt: float) -> float:
        """Return the most vertical force with the plate tilted by at most `max_tilt` [rad] any way [N]."""
        slack, taut = self._slope_friction()
        pull = self.cup.max_force
        tilt = min(max_tilt, math.atan2(taut, pull))
        return max(slack * math.sin(min(max_tilt, 0.5 * math.pi)), pull * math.cos(tilt) + taut * math.sin(tilt))

    def _slope_friction(self) -> tuple[float, float]:
        """Return the most friction along the pad, at 45 degrees to its axes, at no pull and at full pull [N]."""
        along = _SQRT2 / _SQRT3
        return along * self.grip_at_rest, along * (self.grip_at_rest + self.grip_per_pull * self.cup.max_force)


@dataclass(frozen=True, eq=False)
class Cable:
    """A vertical cable at the cup's centre: a force along world +z only, and no torque. Variable: its tension [N]."""

    cup: Cup
    size: int = 1
    pull: int = 0
    """Index of the pull among the variables."""

    def limits(self) -> tuple[Array, Array]:
        """Return E (2, 1) and e (2,) [N]: the variable x is within the limits when `E @ x + e >= 0`."""
        return np.array([[1.0], [-1.0]]), np.array([0.0, self.cup.max_force])

    def contact_map(self, up: Array) -> Array:
        """Return (6, size): takes the tension to the wrench on the plate, in the cup frame; `up` in plate axes."""
        return np.concatenate([self.cup.T_plate_cup[:3, :3].T @ up, np.zeros(3)])[:, None]

    def largest_power(self, velocity: Array, spin: Array, up: Array) -> Array:
        """Return the most power (...) [W] for the cup centre's velocity (..., 3) [m/s], in plate axes."""
        return self.cup.max_force * np.maximum(0.0, np.sum(velocity * up, axis=-1))

    def largest_force(self) -> float:
        """Return the norm of the lifter's largest force [N]."""
        return self.cup.max_force

    def largest_lift(self, max_tilt: float) -> float:
        """Return the most vertical force; a cable's does not depend on the tilt [N]."""
        return self.cup.max_force


Lifter = SuctionPad | Cable


def lifter_of(model: LifterModel, cup: Cup) -> Lifter:
    """Return the lifter model of that name.

    Raises:
        LiftwrightError: there is no such model.
    """
    if model == "paper":
        return SuctionPad(cup, grip_at_rest=0.0, grip_per_pull=cup.mu)
    if model == "dexnet":
        return SuctionPad(cup, grip_at_rest=cup.mu * cup.max_force, grip_per_pull=-cup.mu)
    if model == "cable":
        return Cable(cup)
    raise LiftwrightError(f"no lifter model {model!r}; there are {', '.join(get_args(LifterModel))}")
