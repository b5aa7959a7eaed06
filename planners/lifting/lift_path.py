"""How both arms carry the plate straight up, and how far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planners.cell.arm import Arm
from planners.collision.model import CollisionQuery
from planners.geometry.linear import row_between
from planners.geometry.pose import Array, Transform, inverse
from planners.kinematics.forward import flange_pose
from planners.kinematics.inverse import BRANCHES, inverse_kinematics
from planners.kinematics.windings import nearest_winding


@dataclass(frozen=True)
class LiftPathSettings:
    """How finely and how far the way up is looked at."""

    step: float = 0.001
    """[m]"""
    largest_height: float = 0.4
    """More is never asked for [m]."""
    largest_joint_step: float = 0.03
    """Between two heights; more means that a branch ends, or that the arm is nearly stretched [rad]. Half a metre from
    a joint, positions between two such heights are at most a tenth of a millimetre off the straight way."""


@dataclass(frozen=True, eq=False)
class LiftPath:
    """Joint positions over the height above the start; both hands keep their orientation and go straight up."""

    heights: Array
    """(n,) rising from 0 [m]."""
    positions: Array
    """(n, 12) [rad]."""
    end: str
    """What ends the way, as a sentence for a person."""

    @cached_property
    def _step(self) -> float:
        return float(self.heights[1] - self.heights[0]) if len(self.heights) > 1 else 1.0

    @cached_property
    def height(self) -> float:
        """How far up the hands can go [m]."""
        return float(self.heights[-1])

    def at(self, height: float) -> Array:
        """Return the (12,) joint positions at a height [m], held at the ends."""
        last = len(self.heights) - 1
        place = min(max(height / self._step, 0.0), float(last))
        low = min(int(place), max(last - 1, 0))
        return row_between(self.positions, low, min(low + 1, last), place - low)

    def speed_limits(self, velocity_max: Array) -> Array:
        """Return (n,) the vertical speed at which no joint exceeds its limit (12,) next to each height [m/s]."""
        if len(self.heights) < 2:
            return np.zeros(1)
        slope = np.abs(np.diff(self.positions, axis=0)) / np.diff(self.heights)[:, None]
        each = (velocity_max / np.maximum(slope, 1e-9)).min(axis=1)
        return np.minimum(np.append(each, np.inf), np.append(np.inf, each))


def lift_path(
    arms: Mapping[str, Arm], start: Array, query: CollisionQuery | None, settings: LiftPathSettings | None = None
) -> LiftPath:
    """Follow both arms up from a posture until a joint, a branch of the inverse kinematics or a collision ends it.

    Args:
        arms: left first.
        start: (12,) joint positions [rad].
        query: collisions of arms, plate and cup with one another and with what stands around; None: not looked at.
        settings: how finely to look.
    """
    settings = settings or LiftPathSettings()
    followers = [_Riser(arm, start[6 * i : 6 * i + 6]) for i, arm in enumerate(arms.values())]
    rows, end = [start], "nothing: higher was not asked for"
    count = round(settings.largest_height / settings.step)
    for number in range(1, count + 1):
        row = np.empty(12)
        for i, riser in enumerate(followers):
            row[6 * i : 6 * i + 6] = riser.at(number * settings.step, rows[-1][6 * i : 6 * i + 6])
            step = np.abs(row[6 * i : 6 * i + 6] - rows[-1][6 * i : 6 * i + 6]).max()
            if not step <= settings.largest_joint_step:  # NaN included
                end = f"the {riser.arm.name} arm does not reach higher in this posture"
                break
        if query is not None and end.startswith("nothing"):
            pair = int(query.first_collision(row[None])[0])
            if pair >= 0:
                end = "{} would touch {}".format(*query.pair_names(pair))
        if end.startswith("nothing"):
            rows.append(row)
            continue
        break
    return LiftPath(settings.step * np.arange(len(rows), dtype=float), np.array(rows), end)


class _Riser:
    """One arm in one branch of its inverse kinematics."""

    def __init__(self, arm: Arm, start: Array) -> None:
        self.arm = arm
        self._T_base_world: Transform = inverse(arm.T_world_base)
        self._T_world_flange = flange_pose(arm.dh, arm.T_world_base, np.ascontiguousarray(start))
        solutions, valid = self._solve(0.0)
        gaps = [
            np.abs(np.angle(np.exp(1j * (solutions[b] - start)))).max() if valid >> b & 1 else np.inf
            for b in range(BRANCHES)
        ]
        self._branch = int(np.argmin(gaps))

    def at(self, height: float, near: Array) -> Array:
        """Return the (6,) joint positions nearest to `near`, NaN where the branch does not reach."""
        solutions, valid = self._solve(height)
        if not valid >> self._branch & 1:
            return np.full(6, np.nan)
        return nearest_winding(solutions[self._branch], near, self.arm.position_min, self.arm.position_max)

    def _solve(self, height: float) -> tuple[Array, int]:
        T = self._T_world_flange.copy()
        T[2, 3] += height
        solutions = np.empty((BRANCHES, 6))
        return solutions, int(inverse_kinematics(self.arm.dh, self._T_base_world @ T, 0.0, solutions))
