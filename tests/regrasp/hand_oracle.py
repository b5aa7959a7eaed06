"""Arms, hands and tool as other libraries see them: pinocchio's kinematics, python-fcl's distances."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np

from planners.contract.shapes import InlineMesh
from planners.geometry.convex import CollisionBody
from planners.regrasp.tool_workcell import ToolWorkcell
from planners.scene.body import Body
from planners.scene.solid import CompoundSolid, Solid
from planners.scene.suction_tool import CupData, SuctionTool
from tests.cell.cell_probe import fcl_distance, fcl_object
from tests.kinematics.arm_oracle import PinocchioArm

Pairs = Callable[[CollisionBody, CollisionBody], bool]
MARGIN = 0.003
NEAR = 1e-5
"""Distances closer than this to their limit decide nothing [m]."""


def tool_of(*parts: tuple[Solid, np.ndarray]) -> SuctionTool:
    """Return a tool made of solids, each with its `T_tool_solid`."""
    solid = CompoundSolid(parts)
    stated = InlineMesh.of(*solid.surface(), [part.vertices for part in solid.convex_parts])
    body = Body("tool", "tool", stated, solid, 0.2, np.zeros(3), np.eye(4), static=False)
    return SuctionTool("custom", body, 0.2, np.zeros(3), CupData(0.0175, 20.0, 0.5, 4.5))


def one_shaped(bodies: tuple[CollisionBody, ...]) -> list[CollisionBody]:
    """Return a body for each shape; the names stay those of the bodies."""
    return [CollisionBody(body.name, body.group, body.frame, (shape,)) for body in bodies for shape in body.shapes]


class ToolCell:
    """Distances in a cell with a tool, for openings of the hands."""

    def __init__(self, workcell: ToolWorkcell) -> None:
        self.workcell, self.cell = workcell, workcell.cell

    def frames(self, q: np.ndarray, T_world_tool: np.ndarray) -> dict[str, np.ndarray]:
        """Return `T_world_frame` of all frames at twelve joint positions."""
        frames = {"world": np.eye(4), "tool": T_world_tool}
        for name, chain in self._chains.items():
            T_world_base = self.cell.arms[name].T_world_base
            own = q[self.workcell.joints(name)]
            frames[f"{name}/0"] = T_world_base
            for links, arm in enumerate(chain, start=1):
                frames[f"{name}/{links}"] = T_world_base @ arm.flange_pose(own[:links])
        return frames

    def least_slack(
        self,
        q: np.ndarray,
        T_world_tool: np.ndarray,
        widths: Mapping[str, float],
        pairs: Pairs,
        *,
        holding: tuple[str, ...] = (),
        margin: float = MARGIN,
    ) -> float:
        """Return by how much the closest of the chosen pairs is farther apart than it has to be [m].

        The pads of hands that hold the tool are left out against it; other finger parts may come as close as they like.
        """
        bodies = one_shaped((*self.cell.collision_bodies(widths), self.workcell.tool.body.collision_body()))
        frames, slack = self.frames(q, T_world_tool), 1.0
        placed = [fcl_object(body, frames[body.frame]) for body in bodies]
        for i, a in enumerate(bodies):
            for j, b in enumerate(bodies[:i]):
                known = tuple(sorted((a.name, b.name))) in self.cell.excluded_pairs
                if a.frame == b.frame or known or not pairs(a, b):
                    continue
                names = f"{a.name} {b.name}"
                if "tool" in (a.name, b.name) and "_pad_" in names and names.split("_pad_")[0].split()[-1] in holding:
                    continue
                needed = 0.0 if "tool" in (a.name, b.name) and "_finger_" in names else margin
                slack = min(slack, fcl_distance(placed[i], placed[j]) - needed)
        return slack

    @cached_property
    def _chains(self) -> dict[str, list[PinocchioArm]]:
        return {name: [PinocchioArm(arm.dh[:links]) for links in range(1, 7)] for name, arm in self.cell.arms.items()}


def hand_slack(
    tool: SuctionTool, hand: tuple[CollisionBody, ...], T_tool_flange: np.ndarray, margin: float, pad_margin: float
) -> float:
    """Return by how much a hand is farther from the tool than it has to be [m]; its finger parts may just not touch."""
    shapes = [fcl_object(part, np.eye(4)) for part in one_shaped((tool.body.collision_body(),))]
    slack = 1.0
    for body in hand:
        needed = pad_margin if "_pad_" in body.name else 0.0 if "_finger_" in body.name else margin
        if not np.isfinite(needed):
            continue
        moving = fcl_object(body, T_tool_flange)
        slack = min([slack, *(fcl_distance(moving, shape) - needed for shape in shapes)])
    return slack
