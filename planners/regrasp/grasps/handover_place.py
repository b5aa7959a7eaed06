"""Where to hand the tool over: the place at which both arms have the greatest manipulability (paper A)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.cell.cell import Cell
from planners.cell.hand import Gripper
from planners.errors import LiftwrightError
from planners.geometry.pose import Array, Transform, frame_from_z, inverse, rotation_z, transform
from planners.kinematics.inverse import inverse_kinematics, manipulability, multiply, within_limits
from planners.regrasp.grasps.tool_grasps import ToolGrasps


@dataclass(frozen=True)
class HandoverPlaceSettings:
    """What is searched for the handover place. Lengths are shares of what the shorter arm reaches by its data sheet."""

    lowest: tuple[float, float, float] = (0.6, -0.2, 0.5)
    """Corner of the box that is searched [1]: from the middle between the bases towards the table and to the left, and
    over the table. Our choice: nearer to what the arms stand on a tool and the hand on it could not turn."""
    highest: tuple[float, float, float] = (1.2, 0.2, 1.1)
    """The opposite corner [1]; our choice."""
    facing: tuple[float, float] = (-0.3, 0.3)
    """What is searched from the middle on instead, where the table is between the arms [1]; our choice."""
    step: float = 0.2
    """Between the places of the first grid [1]; our choice."""
    finest: float = 0.1
    """The grid about the best place is halved down to this [1]: half as much changes the result by 1 %."""
    grasps: int = 96
    """Grasps that are asked at each place, spread over all; our choice."""
    best: int = 3
    """As many of them count, the best ones: a place need not suit every grasp; our choice."""
    axis_rolls: int = 2
    """Turns of the tool about each of six directions of its axis that are asked; our choice."""

    def __post_init__(self) -> None:
        if not 0.0 < self.finest <= self.step or not 1 <= self.best <= self.grasps or self.axis_rolls < 1:
            raise LiftwrightError("a handover place is searched with positive steps and counts")
        if any(low > high for low, high in zip(self.lowest, self.highest, strict=True)):
            raise LiftwrightError("the box that is searched for the handover place has its lowest corner first")


def tool_poses_at(place: Array, grasps: ToolGrasps, axis_rolls: int) -> Array:
    """Return `T_world_tool` (6 axis_rolls, 4, 4): the middle of the grasps at `place` (3,), the tool in all directions.

    Its axis is along each axis of the world, each way, turned by equal steps about itself.
    """
    middle = grasps.T_tool_tcp[:, :3, 3].mean(axis=0)
    rotations: list[Array] = []
    for axis, sign in itertools.product(range(3), (1.0, -1.0)):
        upright = frame_from_z(sign * np.eye(3)[axis], np.eye(3)[(axis + 1) % 3])
        rotations += [upright @ rotation_z(2.0 * math.pi * k / axis_rolls) for k in range(axis_rolls)]
    return np.array([transform(R, place - R @ middle) for R in rotations])


def handover_place(cell: Cell, grasps: ToolGrasps, settings: HandoverPlaceSettings) -> Array:
    """Return the place (3,) for the middle of the grasps at which the worse arm has the most manipulability [m, world].

    The manipulability of an arm at a place is the mean of |det J| over all orientations of the tool and the best
    grasps in each, each on its best branch; a grasp out of reach has none.
    """
    chosen = np.unique(np.linspace(0, len(grasps) - 1, settings.grasps).round().astype(int))
    T_world_box, reach = _box_frame(cell), min(arm.robot.reach for arm in cell.arms.values())
    low, high = (reach * np.array(corner) for corner in (settings.lowest, settings.highest))
    if abs(float((inverse(T_world_box) @ [*cell.boxes[0].center, 1.0])[0])) < reach * settings.facing[1]:
        low[0], high[0] = (reach * share for share in settings.facing)
    low[2], high[2] = cell.table_top + low[2], cell.table_top + high[2]
    first, finest = reach * settings.step, reach * settings.finest
    axes = [np.arange(a, b + 0.5 * first, first) for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    best, most, step = places[0], -1.0, first
    while True:
        for place in places:
            at = T_world_box[:3, :3] @ place + T_world_box[:3, 3]
            found = min(_manipulability(cell, arm, at, grasps, chosen, settings) for arm in cell.arms)
            # Rounding decides no tie.
            if found > most + 1e-9:
                best, most = place, found
        if step <= finest:
            return T_world_box[:3, :3] @ best + T_world_box[:3, 3]
        step = max(0.5 * step, finest)
        around = best + step * np.array(list(itertools.product((-1, 0, 1), repeat=3)))
        places = around[((around >= low - 1e-9) & (around <= high + 1e-9)).all(axis=1)]


def _box_frame(cell: Cell) -> Transform:
    """Return where handovers are searched: on the floor between the bases, x towards the table, z up."""
    left, right = (cell.arms[name].T_world_base[:3, 3] for name in ("left", "right"))
    middle, center = 0.5 * (left + right), cell.boxes[0].center
    across = left[:2] - right[:2]
    apart = float(np.linalg.norm(across))
    # Arms one above the other have no left.
    to_the_left = across / apart if apart > 1e-6 else np.array([0.0, 1.0])
    forward = np.array([to_the_left[1], -to_the_left[0]])
    if forward @ (center[:2] - middle[:2]) < 0.0:
        forward = -forward
    axes = np.array([[*forward, 0.0], [-forward[1], forward[0], 0.0], [0.0, 0.0, 1.0]]).T
    return transform(axes, [middle[0], middle[1], 0.0])


def _manipulability(
    cell: Cell,
    arm_name: str,
    place: Array,
    grasps: ToolGrasps,
    chosen: NDArray[np.integer],
    settings: HandoverPlaceSettings,
) -> float:
    arm = cell.arms[arm_name]
    assert isinstance(arm.hand, Gripper)
    T_tool_flange = np.ascontiguousarray(grasps.T_tool_flange(arm.hand)[chosen])
    T_world_tools = tool_poses_at(place, grasps, settings.axis_rolls)
    values = _best_manipulabilities(
        arm.dh, inverse(arm.T_world_base), arm.position_min, arm.position_max, T_world_tools, T_tool_flange
    )
    return float(np.sort(values, axis=1)[:, -settings.best :].mean())


@njit(cache=True, nogil=True)
def _best_manipulabilities(
    dh: Array, T_base_world: Transform, lo: Array, hi: Array, T_world_tools: Array, T_tool_flange: Array
) -> Array:
    """Return for each tool pose and grasp the greatest manipulability of its branches, 0 out of reach."""
    result = np.zeros((T_world_tools.shape[0], T_tool_flange.shape[0]))
    T_base_tool, T_base_flange, solutions = np.empty((4, 4)), np.empty((4, 4)), np.empty((8, 6))
    for o in range(T_world_tools.shape[0]):
        multiply(T_base_world, T_world_tools[o], T_base_tool)
        for grasp in range(T_tool_flange.shape[0]):
            multiply(T_base_tool, T_tool_flange[grasp], T_base_flange)
            valid = inverse_kinematics(dh, T_base_flange, 0.0, solutions)
            for branch in range(8):
                if (valid >> branch) & 1 and within_limits(solutions[branch], lo, hi):
                    result[o, grasp] = max(result[o, grasp], manipulability(dh, solutions[branch]))
    return result
