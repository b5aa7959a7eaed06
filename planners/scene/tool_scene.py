"""SuctionToolScene: everything a suction-tool task is planned for, checked and in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planners.contract.task_spec import SuctionToolFriction, SuctionToolOptions, SuctionToolTask
from planners.errors import SceneError
from planners.geometry.pose import Array, Transform, from_pose7
from planners.scene.body import Body
from planners.scene.cell import Cell
from planners.scene.hand import Gripper
from planners.scene.moved_object import MovedObject, symmetry_turns
from planners.scene.placements import place_obstacle
from planners.scene.shape_source import ShapeSource
from planners.scene.suction_tool import SuctionTool, load_tool
from planners.scene.task_checks import check_names, find_cell, start_positions


@dataclass(frozen=True, eq=False)
class SuctionToolScene:
    """A suction-tool task at its start. Everything rests, nothing overlaps, every name is unique."""

    cell: Cell
    tool: SuctionTool
    """Standing in the cell's rest or on its cup, or lying."""
    objects: tuple[MovedObject, ...]
    """As the task lists them; at rest at the start and at their goals."""
    friction: SuctionToolFriction
    grip_force_limit: float
    """Largest normal force of one finger on the tool [N]."""
    obstacles: tuple[Body, ...]
    start_positions: Array
    """(12,), left arm first [rad]."""
    start_widths: dict[str, float]
    """Opening of each gripper at the start [m]: fully open."""
    seed: int
    options: SuctionToolOptions

    def bodies(self) -> tuple[Body, ...]:
        """Return the bodies the task brings: tool, objects, obstacles."""
        return (self.tool.body, *(moved.body for moved in self.objects), *self.obstacles)


def build_tool_scene(task: SuctionToolTask, cells: Mapping[str, Cell] | None = None) -> SuctionToolScene:
    """Place everything a suction-tool task names, and refuse what cannot stand as it says.

    Raises:
        SceneError: naming the member that is wrong, and the valid choices where there are any.
    """
    cell = find_cell(task.cell, cells, _grips_with_both, "a suction tool needs a cell with two grippers")
    named = [(given.name, f"/objects/{i}/name") for i, given in enumerate(task.objects)]
    named += [(given.name, f"/obstacles/{i}/name") for i, given in enumerate(task.obstacles)]
    check_names(named, cell)
    shapes = ShapeSource()
    obstacles = tuple(place_obstacle(i, given, shapes) for i, given in enumerate(task.obstacles))
    objects = []
    for i, given in enumerate(task.objects):
        shape, solid = shapes.find(given.shape, f"/objects/{i}/shape")
        T_world_object = from_pose7(given.pose)
        body = Body(given.name, "object", shape, solid, given.mass, np.array(given.com), T_world_object, static=False)
        turns = symmetry_turns(solid, given.goal_symmetry)
        objects.append(MovedObject(body, from_pose7(given.goal_pose), given.goal_symmetry, turns))
    return SuctionToolScene(
        cell=cell,
        tool=load_tool(task.tool, _tool_pose(task, cell), shapes),
        objects=tuple(objects),
        friction=task.friction,
        grip_force_limit=task.grip_force_limit,
        obstacles=obstacles,
        start_positions=start_positions(task.start_positions, cell),
        start_widths={name: _width_max(cell, name) for name in cell.gripper_arms},
        seed=task.seed,
        options=task.options,
    )


def _grips_with_both(cell: Cell) -> bool:
    return len(cell.gripper_arms) == 2


def _width_max(cell: Cell, arm: str) -> float:
    hand = cell.arms[arm].hand
    assert isinstance(hand, Gripper)
    return hand.width_max


def _tool_pose(task: SuctionToolTask, cell: Cell) -> Transform:
    if task.tool_pose is not None:
        return from_pose7(task.tool_pose)
    if cell.tool_rest is None:
        raise SceneError("/tool_pose", f"the cell {cell.name} has no tool rest; say where the tool is")
    return cell.tool_rest.T_world_tool
