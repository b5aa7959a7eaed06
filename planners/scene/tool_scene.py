"""SuctionToolScene: everything a suction-tool task is planned for, checked and in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

from planners.cell.cell import Cell
from planners.cell.needed_hands import FOR_TOOL
from planners.contract.task_spec import SuctionToolFriction, SuctionToolOptions, SuctionToolTask
from planners.errors import SceneError, SceneFaults
from planners.geometry.pose import Array
from planners.scene.body import Body
from planners.scene.clashes import AT_START, CellAtStart, placed_at_start, refuse_inside, refuse_overlaps
from planners.scene.moved_object import MovedObject
from planners.scene.placements import check_names, find_cell, place_obstacle, start_positions
from planners.scene.shape_source import ShapeSource, Uploads, no_uploads
from planners.scene.suction_tool import NO_TOOLS, TOOL_NAME, SuctionTool
from planners.scene.tool_placements import StillBodies, place_objects, place_tool, refuse_overlaps_but_rest


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
    squeeze: float
    """With which every hand grips the tool, from grip to release [N]."""
    carry_force_limits: dict[str, float]
    """By arm: largest net force of its fingers on the tool [N]: the weight that the payload leaves beside the hand, or
    less if the task says so."""
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

    def finger_limit(self, arm: str) -> float:
        """Return the largest normal force that a finger of a hand can have [N].

        It is the squeeze and half of what the hand may carry: a load along the closing axis adds half of itself to one
        finger and takes it from the other.
        """
        return min(self.grip_force_limit, self.squeeze + 0.5 * self.carry_force_limits[arm])

    def keeping_back(self, share: float) -> Self:
        """Return the scene with every force limit smaller by a share of it [1]; the squeeze is commanded, and stays."""
        left = 1.0 - share
        cup = self.tool.cup
        cup = replace(cup, max_force=left * cup.max_force, mu=left * cup.mu, kappa=left * cup.kappa)
        return replace(
            self,
            tool=replace(self.tool, cup=cup),
            friction=self.friction.model_copy(update={"grip": left * self.friction.grip}),
            grip_force_limit=self.squeeze + left * (self.grip_force_limit - self.squeeze),
            carry_force_limits={arm: left * limit for arm, limit in self.carry_force_limits.items()},
        )


def build_tool_scene(
    task: SuctionToolTask,
    cells: Mapping[str, Cell] | None = None,
    uploads: Uploads = no_uploads,
    tools: Mapping[str, SuctionTool] = NO_TOOLS,
) -> SuctionToolScene:
    """Place everything a suction-tool task names, and refuse what cannot stand as it says.

    The arguments are those of `build_scene`.

    Raises:
        SceneError: naming the member that is wrong, and the valid choices where there are any.
    """
    cell = tool_cell(task, cells)
    named = [(given.name, f"/objects/{i}/name") for i, given in enumerate(task.objects)]
    named += [(given.name, f"/obstacles/{i}/name") for i, given in enumerate(task.obstacles)]
    # By them it is known below what rests on what.
    check_names(named, cell)
    shapes = ShapeSource(uploads)
    faults = SceneFaults()
    placed = [faults.tried(partial(place_obstacle, i, given, shapes)) for i, given in enumerate(task.obstacles)]
    obstacles = tuple(body for body in placed if body is not None)
    carry_force_limits = {name: _carry_force_limit(task, cell, name) for name in cell.gripper_arms}
    squeeze = faults.tried(lambda: _squeeze(task, cell, max(carry_force_limits.values())))
    starts = faults.tried(lambda: start_positions(task.start_positions, cell))
    if len(obstacles) < len(placed):
        # Whatever would stand on what is not there would be told to rest on nothing.
        raise faults.error()
    still = StillBodies.of(cell, obstacles)
    tool = faults.tried(lambda: place_tool(task, cell, still, shapes, tools))
    objects = place_objects(task.objects, still, shapes, faults)
    if squeeze is None or starts is None or tool is None or objects is None:
        raise faults.error()
    scene = SuctionToolScene(
        cell=cell,
        tool=tool,
        objects=objects,
        friction=task.friction,
        grip_force_limit=task.grip_force_limit,
        squeeze=squeeze,
        carry_force_limits=carry_force_limits,
        obstacles=obstacles,
        start_positions=starts,
        start_widths={name: cell.gripper(name).width_max for name in cell.gripper_arms},
        seed=task.seed,
        options=task.options,
    )
    _add_overlaps_at_start(scene, still, faults)
    faults.raise_any()
    return scene


def tool_cell(task: SuctionToolTask, cells: Mapping[str, Cell] | None = None) -> Cell:
    """Return the cell that a task names, of those there are by name; None: the shipped ones.

    Raises:
        SceneError: There is none, or it has other hands; with the names of those that have such.
    """
    return find_cell(task.cell, cells, FOR_TOOL)


def _squeeze(task: SuctionToolTask, cell: Cell, carried: float) -> float:
    """Return the largest squeeze [N] with which no finger presses too hard, whatever of `carried` [N] it bears more."""
    grippers = [cell.gripper(name) for name in cell.gripper_arms]
    least, most = max(each.force_min for each in grippers), min(each.force_max for each in grippers)
    if task.grip_force_limit < least:
        raise SceneError(
            "/grip_force_limit", f"{task.grip_force_limit:g} N: the gripper squeezes with {least:g} N at least"
        )
    return min(most, max(least, task.grip_force_limit - 0.5 * carried))


def _carry_force_limit(task: SuctionToolTask, cell: Cell, arm: str) -> float:
    most = cell.payload_force(arm)
    return most if task.carry_force_limit is None else min(most, task.carry_force_limit)


def _add_overlaps_at_start(scene: SuctionToolScene, still: StillBodies, faults: SceneFaults) -> None:
    """Let what the task places touch the cell, and what never moves overlap what else never moves.

    Tool, objects and arms must be clear of all but what they rest on.
    """
    moved = [placed_at_start(one.body, f"/objects/{i}/pose") for i, one in enumerate(scene.objects)]
    tool = placed_at_start(scene.tool.body, "/tool_pose")
    at_start = CellAtStart.of(scene.cell, scene.start_positions, scene.start_widths)
    supports = {one.name: one.start_supports for one in scene.objects} | {TOOL_NAME: scene.tool.supports}
    excess = still.excess | {body.name: body.solid.excess for body in scene.bodies()}
    standing = [*moved, tool]
    obstacles = [body for body in still.bodies if body not in still.cell]
    faults.tried(lambda: refuse_inside([*standing, *obstacles], still.cell, excess))
    faults.tried(lambda: refuse_overlaps_but_rest(standing, [*still.bodies, *standing], supports, excess, AT_START))
    faults.tried(lambda: refuse_overlaps(at_start.arms, [*standing, *obstacles]))
    faults.tried(at_start.refuse_overlaps)
