"""Why no hand can take the tool where it is at the start."""

from __future__ import annotations

import numpy as np

from planners.cell.hand import Gripper
from planners.graph.rejections import Rejection, Rejections
from planners.regrasp.graph.suction_route import RouteStart
from planners.regrasp.grasps.grasp_reach import TOUCHING
from planners.regrasp.grasps.tool_grasps import ToolGrasps
from planners.scene.tool_scene import SuctionToolScene

STAGE = "grasp"
_WHERE = "/tool_pose"


def not_taken(
    scene: SuctionToolScene, grasps: ToolGrasps, start: RouteStart, margin: float
) -> tuple[str, tuple[Rejection, ...]] | None:
    """Say why the tool cannot be taken, in a sentence and with its causes; None where it can be.

    Args:
        scene: the task.
        grasps: all that are known.
        start: what was found out about them where the tool is.
        margin: that hands keep from the table [m].
    """
    if start.nodes.any():
        return None
    room = max(_over_table(scene, grasps, arm) for arm in scene.cell.gripper_arms)
    if room < margin:
        where = "above" if room >= 0.0 else "below"
        reason = (
            f"in every grasp the fingers would reach to {1e3 * abs(room):.1f} mm {where} the table or lower, and they "
            f"keep {1e3 * margin:g} mm above it"
        )
        cause = Rejection(STAGE, f"{reason[0].upper()}{reason[1:]}.", _WHERE, margin, room, "m")
        return f"The tool cannot be gripped where it is: {reason}.", (cause,)
    told = "Neither hand can take the tool where it is"
    if start.layer is None:
        return f"{told}.", ()
    tally, rejected = Rejections(), start.layer.rejected()
    for reason, mask in rejected.items():
        tally.add(Rejection(STAGE, f"Where the tool is: {reason}", _WHERE), int(mask.sum()))
    causes, hindrance = [cause for cause, _ in tally.most_common()], start.layer.hindrance().removesuffix(".")
    if not TOUCHING.isdisjoint(rejected):
        # By the names of what touches, which no count by reason has.
        causes = [Rejection(STAGE, f"Where the tool is: {hindrance}.", _WHERE), *causes]
    return f"{told}: {hindrance}.", tuple(causes)


def _over_table(scene: SuctionToolScene, grasps: ToolGrasps, arm: str) -> float:
    """Return how high above the table the lowest point of a hand is in the grasp in which it is highest [m]."""
    hand = scene.cell.arms[arm].hand
    assert isinstance(hand, Gripper)
    T_world_flanges = scene.tool.T_world_tool @ grasps.T_tool_flange(hand)
    highest = -np.inf
    for width in np.unique(grasps.widths):
        parts = [np.vstack([shape.vertices for shape in body.shapes]) for body in hand.bodies(arm, float(width))]
        rows = T_world_flanges[grasps.widths == width, 2]
        lowest = (rows[:, :3] @ np.vstack(parts).T).min(axis=1) + rows[:, 3]
        highest = max(highest, float(lowest.max()) - scene.cell.table_top)
    return highest
