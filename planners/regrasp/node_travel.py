"""How long each grasp needs from one place to another; nodes are numbered as in the regrasp graph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planners.cell.arm import Arm
from planners.geometry.pose import Array
from planners.regrasp.carried import CarriedPace
from planners.regrasp.travel import least_travel


class NodeTravel:
    """Least times of arms that carry the tool in each of n grasps: those of the left arm, then those of the right."""

    def __init__(self, arms: Sequence[Arm], T_tool_flange: Sequence[Array], pace: CarriedPace) -> None:
        """Take the arms, the poses (n, 4, 4) of their flanges in the tool's frame, and the pace of what is carried."""
        self._arms, self._T_tool_flange, self._pace = tuple(arms), tuple(T_tool_flange), pace

    def between(self, one: Array, other: Array, beyond: Array | None = None) -> Array:
        """Return (2 n,) least seconds between (2 n, k, 6) and (2 n, m, 6) [rad]; infinite where either is all NaN.

        `beyond` (2 n, m) seconds are added for going on from there.
        """
        parts = []
        for number, arm in enumerate(self._arms):
            T_tool_flange = self._T_tool_flange[number]
            part = slice(number * len(T_tool_flange), (number + 1) * len(T_tool_flange))
            on = None if beyond is None else beyond[part]
            parts.append(least_travel(arm, one[part], other[part], T_tool_flange, self._pace, on))
        return np.concatenate(parts)

    def of(self, node: int, one: Array, other: Array, *, carries: bool = True) -> float:
        """Return least seconds of one node between (k, 6) and (m, 6) [rad], with the tool in hand or without."""
        number, grasp = divmod(node, len(self._T_tool_flange[0]))
        flange = self._T_tool_flange[number][grasp : grasp + 1] if carries else None
        return float(least_travel(self._arms[number], one[None], other[None], flange, self._pace)[0])
