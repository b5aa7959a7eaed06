"""PlateLiftScene: everything a plate lift is planned for, checked and in one place."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from planners.cell.cell import Cell
from planners.cell.hand import Gripper
from planners.cell.needed_hands import FOR_LIFT
from planners.contract.task_spec import (
    HandForceLimit,
    LifterModel,
    PlateLiftFriction,
    PlateLiftTask,
)
from planners.errors import SceneError, SceneFaults
from planners.geometry import polygon
from planners.geometry.convex import sorted_pair
from planners.geometry.pose import Array, Transform
from planners.scene.body import Body, PlateBody
from planners.scene.clashes import CellAtStart, placed_at_start, refuse_inside, refuse_overlaps
from planners.scene.lift_placements import (
    GivenGrip,
    GivenPush,
    SuctionCup,
    cup_places,
    cup_step,
    place_cup,
    place_plate,
    place_support,
    settle_grips,
    settle_pushes,
)
from planners.scene.placements import (
    CONTAINMENT_SLACK,
    box_top,
    check_names,
    find_cell,
    place_obstacle,
    start_positions,
    still_excess,
)
from planners.scene.rest import LevelFace, upper_surface
from planners.scene.shape_source import ShapeSource, Uploads

RIM = 2e-3
"""Things lie up to a millimetre from where a task has them: what stands so near to a rim may stand beyond it. More, for
round outlines have sides in another reading [m]."""
FINGER_GAP = 0.008
"""Between each pad and the plate while the gripper is open around it, in a cell of size 1 [m]: fully open fingers would
need more room under a tilted plate."""


@dataclass(frozen=True, eq=False)
class PlateLiftScene:
    """A plate lift at its start. Everything rests, nothing overlaps, every name is unique."""

    cell: Cell
    plate: PlateBody
    """Settled: level and at `support_top`, though the task may have placed it a little off."""
    support: Body | None
    """The board it lies on or beside; None for the bare table."""
    support_name: Literal["table", "support"]
    """What the plate rests on."""
    support_top: float
    """Height of the surface that the plate rests on [m]."""
    cup: SuctionCup
    lifter_model: LifterModel
    friction: PlateLiftFriction
    hand_force_limit: HandForceLimit
    squeeze: float | None
    """What each pad of the gripper presses with when it bears nothing [N]; None: the paper's free fingers."""
    mass_tolerance: float
    """Share of the plate's mass by which it may be more or less [1]."""
    com_tolerance: float
    """Distance along each of the plate's axes by which its centre of mass may be off [m]."""
    obstacles: tuple[Body, ...]
    start_positions: Array
    """(12,), left arm first [rad]."""
    start_widths: dict[str, float]
    """Opening of each gripper at the start, and whenever it holds nothing [m]: `FINGER_GAP` to either side of the
    plate, or as far as it opens."""
    seed: int
    given_grips: tuple[GivenGrip, ...] | None
    """Grips to use; None: generated ones."""
    given_pushes: tuple[GivenPush, ...] | None
    """Pushes to use; None: generated ones."""

    @property
    def T_world_plate(self) -> Transform:
        """The plate at the start."""
        return self.plate.T_world_body

    @property
    def surface_beyond(self) -> float:
        """How far what the plate lies on reaches beyond it, at the side where that is least [m]."""
        corners = self._corners
        middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
        outline = self._outline_below
        return math.inf if outline is None else max(0.0, float(polygon.depth_inside(outline, middles).min()))

    @property
    def at_the_rim(self) -> Array:
        """Corners of the plate (m, 2) that lie within `RIM` of the rim of what it lies on, plate axes [m]."""
        outline = self._outline_below
        if outline is None:
            return self.plate.outline[:0]
        return self.plate.outline[polygon.depth_inside(outline, self._corners) <= RIM]

    @property
    def _corners(self) -> Array:
        """Of the plate's outline where it lies, (n, 2) in the world [m]."""
        return self.plate.outline @ self.T_world_plate[:2, :2].T + self.T_world_plate[:2, 3]

    @property
    def _outline_below(self) -> Array | None:
        """Outline of what the plate lies on, (n, 2) in the world [m]; None: it has no level face."""
        top = box_top(self.cell.boxes[0])
        if self.support is not None and self.support_name == "support":
            top = upper_surface("support", self.support.solid, self.support.T_world_body)
        return None if top is None else top.outline

    def bodies(self) -> tuple[Body, ...]:
        """Return the bodies the task brings: plate, support if any, cup, cable, obstacles."""
        support = () if self.support is None else (self.support,)
        return (self.plate, *support, self.cup.body, self.cup.cable, *self.obstacles)


def build_lift_scene(task: PlateLiftTask, cells: Mapping[str, Cell] | None, uploads: Uploads) -> PlateLiftScene:
    """Place everything a plate lift names, and refuse what cannot stand as it says.

    The arguments are those of `build_scene`.

    Where the task leaves the cup's place open, it is the first of `cup_places` at which nothing is in the way.

    Raises:
        SceneError: naming the member that is wrong, and the valid choices where there are any.
    """
    cell = lift_cell(task, cells)
    gripper = cell.gripper(cell.gripper_arms[0])
    shapes = ShapeSource(uploads)
    named = [(obstacle.name, f"/obstacles/{i}/name") for i, obstacle in enumerate(task.obstacles)]
    faults = SceneFaults()
    names = faults.tried(lambda: check_names(named, cell))
    faults.tried(lambda: _check_lifter(task, cell))
    placed = [faults.tried(partial(place_obstacle, i, obstacle, shapes)) for i, obstacle in enumerate(task.obstacles)]
    starts = faults.tried(lambda: start_positions(task.start_positions, cell))
    resting = faults.tried(lambda: _resting_plate(task, cell, shapes))
    if starts is None or resting is None:
        raise faults.error()
    support, plate, surface = resting
    if task.cup.position is None:
        faults.raise_any()
        return _with_any_place(task, plate, lambda chosen: build_lift_scene(chosen, cells, uploads))
    faults.tried(lambda: _check_pad(task, plate))
    # With what is refused left out, for what else is wrong with the rest; nobody gets it then.
    scene = PlateLiftScene(
        cell=cell,
        plate=plate,
        support=support,
        support_name="support" if surface.name == "support" else "table",
        support_top=surface.height,
        cup=place_cup(task.cup, plate, cell.lifter),
        lifter_model=task.lifter_model,
        friction=task.friction,
        hand_force_limit=task.hand_force_limit,
        squeeze=faults.tried(lambda: _squeeze(task, gripper)),
        mass_tolerance=task.plate.mass_tolerance,
        com_tolerance=task.plate.com_tolerance,
        obstacles=tuple(body for body in placed if body is not None),
        start_positions=starts,
        start_widths={name: _open_around(plate, cell) for name in cell.gripper_arms},
        seed=task.seed,
        given_grips=faults.tried(lambda: settle_grips(task.options, plate, gripper)),
        given_pushes=faults.tried(lambda: settle_pushes(task.options, plate)),
    )
    # What has another's name could not be told from it.
    if names is not None and len(scene.obstacles) == len(placed):
        _add_overlaps_at_start(scene, faults)
    faults.raise_any()
    return scene


def _resting_plate(task: PlateLiftTask, cell: Cell, shapes: ShapeSource) -> tuple[Body | None, PlateBody, LevelFace]:
    """Return support and plate where they rest, and the surface that the plate rests on."""
    table = box_top(cell.boxes[0])
    support = None if task.support is None else place_support(task.support, table, shapes)
    return support, *place_plate(task, support, table)


def _with_any_place(
    task: PlateLiftTask, plate: PlateBody, build: Callable[[PlateLiftTask], PlateLiftScene]
) -> PlateLiftScene:
    """Return the scene with the cup at the first place that is not refused.

    Raises:
        SceneError: every place is refused, or something else.
    """
    radius = task.cup.radius
    refused = SceneError("/cup/radius", "the pad is larger than the plate's top face, wherever it sits")
    for number, place in enumerate(cup_places(plate, radius, cup_step(plate, radius))):
        try:
            return build(task.with_cup_at(place))
        except SceneError as error:
            if not all("/cup/position" in each.pointers for each in error.all):
                raise
            refused = refused if number else error
    raise refused


def lift_cell(task: PlateLiftTask, cells: Mapping[str, Cell] | None = None) -> Cell:
    """Return the cell that a task names, of those there are by name; None: the shipped ones.

    Raises:
        SceneError: There is none, or it has other hands; with the names of those that have such.
    """
    return find_cell(task.cell, cells, FOR_LIFT)


def _squeeze(task: PlateLiftTask, gripper: Gripper) -> float | None:
    asked = task.hand_force_limit.squeeze
    if task.contact_model == "paper":
        if asked is not None:
            detail = "the paper's contact model has no squeeze: leave it out, or take the contact model squeeze"
            raise SceneError("/hand_force_limit/squeeze", detail)
        return None
    if asked is not None and not gripper.force_min <= asked <= gripper.force_max:
        able = f"the gripper squeezes with {gripper.force_min:.4g} to {gripper.force_max:.4g} N"
        raise SceneError("/hand_force_limit/squeeze", f"{able}, not with {asked:.4g} N")
    return gripper.squeeze if asked is None else asked


def _open_around(plate: PlateBody, cell: Cell) -> float:
    return min(plate.height + 2.0 * cell.size * FINGER_GAP, cell.gripper(cell.gripper_arms[0]).width_max)


def _check_pad(task: PlateLiftTask, plate: PlateBody) -> None:
    inside = float(polygon.depth_inside(plate.outline, np.array([task.cup.place]))[0])
    if inside < task.cup.radius - CONTAINMENT_SLACK:
        beyond = 1e3 * (task.cup.radius - inside)
        raise SceneError("/cup/position", f"the pad sticks out {beyond:.4g} mm over the edge of the plate's top face")


def _check_lifter(task: PlateLiftTask, cell: Cell) -> None:
    most = cell.lifter.max_force
    if task.cup.max_force > most:
        detail = f"the lifter of the cell {cell.name} lifts {most:.4g} N at most, not {task.cup.max_force:.4g} N"
        raise SceneError("/cup/max_force", detail)


def _add_overlaps_at_start(scene: PlateLiftScene, faults: SceneFaults) -> None:
    """Let what the task places touch the cell, and what never moves overlap what else never moves.

    The plate, the cup, the cable and the arms must be clear of all but what they rest on.
    """
    still = CellAtStart.of(scene.cell, scene.start_positions, scene.start_widths)
    fixed, arms = still.fixed, still.arms
    obstacles = [placed_at_start(body, f"/obstacles/{i}/pose") for i, body in enumerate(scene.obstacles)]
    support = [] if scene.support is None else [placed_at_start(scene.support, "/support/pose")]
    plate = [placed_at_start(scene.plate, "/plate_pose")]
    cup = [placed_at_start(scene.cup.body, "/cup/position")]
    cable = [placed_at_start(scene.cup.cable, "/cup/position")]
    resting = {sorted_pair("plate", scene.support_name)}
    excess = still_excess(scene.cell) | {body.name: body.solid.excess for body in scene.bodies()}
    faults.tried(lambda: refuse_inside([*support, *plate, *cup, *obstacles], fixed, excess))
    faults.tried(lambda: refuse_overlaps(plate, [*fixed, *support, *obstacles], resting))
    # What the plate is in, its cup and cable are in for that reason.
    around = [body for body in (*support, *obstacles) if not faults.tells_of("/plate_pose", body.pointer)]
    faults.tried(lambda: refuse_overlaps(cup, [*fixed, *around]))
    faults.tried(lambda: refuse_overlaps(cable, [body for body in around if body in obstacles]))
    faults.tried(lambda: refuse_overlaps(arms, [*plate, *cup, *cable, *support, *obstacles]))
    faults.tried(still.refuse_overlaps)
