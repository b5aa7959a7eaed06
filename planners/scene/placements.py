"""What is alike in every kind of task: its cell, its names, where the arms start, where obstacles are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from planners.cell.cell import Cell, StaticBox, known_cells, load_cell
from planners.cell.needed_hands import NeededHands
from planners.contract.shapes import Box
from planners.contract.task_spec import Obstacle
from planners.errors import SceneError, SceneFaults
from planners.geometry import polygon
from planners.geometry.pose import Array, Transform, from_pose7, transform
from planners.scene.body import Body
from planners.scene.rest import LevelFace
from planners.scene.shape_source import ShapeSource, mesh_solid
from planners.scene.solid import Solid, solid_of

CONTAINMENT_SLACK = 1e-9
"""Rounding allowed where a point must lie inside a body [m]."""


def in_hull(solid: Solid, point: Array) -> bool:
    """Tell whether (3,) `point` is inside the convex hull: the centre of mass of an angle is beside it."""
    planes = solid.hull_planes
    return float((planes[:, :3] @ point + planes[:, 3]).max()) <= CONTAINMENT_SLACK


def box_top(box: StaticBox) -> LevelFace:
    """Return the top of a box of the cell."""
    outline = polygon.rectangle(box.size[0], box.size[1]) + box.center[:2]
    return LevelFace(box.name, float(box.center[2] + 0.5 * box.size[2]), outline)


def still_solids(cell: Cell) -> Iterator[tuple[str, Solid, Transform]]:
    """Yield name, solid and pose in the world of what belongs to a cell and never moves."""
    for box in cell.boxes:
        x, y, z = box.size.tolist()
        yield box.name, solid_of(Box(type="box", size=(x, y, z))), transform(None, box.center)
    for still in cell.meshes:
        yield still.name, mesh_solid(still.mesh), still.T_world_mesh


def still_excess(cell: Cell) -> dict[str, float]:
    """Return by name how far convex shapes reach beyond what belongs to a cell and never moves [m]."""
    return {still.name: still.mesh.drawn.excess for still in cell.meshes}


def place_obstacle(index: int, obstacle: Obstacle, shapes: ShapeSource) -> Body:
    """Place the obstacle of this index; it may be anywhere."""
    stated, solid = shapes.find(obstacle.shape, f"/obstacles/{index}/shape")
    T_world_obstacle = from_pose7(obstacle.pose)
    return Body(obstacle.name, "obstacle", stated, solid, None, np.zeros(3), T_world_obstacle, static=True)


RESERVED_NAMES = frozenset({"plate", "support", "table", "cup", "cable", "tool", "world", "left", "right"})


def find_cell(name: str, cells: Mapping[str, Cell] | None, needed: NeededHands) -> Cell:
    """Return the cell of a name.

    Args:
        name: as the task says.
        cells: the cells there are; None: the shipped ones.
        needed: the hands that the task needs.

    Raises:
        SceneError: There is none, or it does not fit; with the names of those that do.
    """

    def find(other: str) -> Cell | None:
        # Of others' cells one may be deleted while they are looked through.
        if cells is not None:
            return cells.get(other)
        return load_cell(other) if other in known_cells() else None

    def fits(cell: Cell | None) -> bool:
        return cell is not None and needed.fit(len(cell.gripper_arms), len(cell.pusher_arms))

    found = find(name)
    if found is None or not fits(found):
        # Shipped cells take long to load, and need not be.
        shipped, known = needed.of_shipped(), known_cells() if cells is None else cells
        fitting = [other for other in known if (shipped[other] if other in shipped else fits(find(other)))]
        raise needed.refusal(name, fitting, known=found is not None)
    return found


def check_names(named: Iterable[tuple[str, str]], cell: Cell) -> frozenset[str]:
    """Return the names of (name, pointer) pairs, which are unique and not those of what is there anyway.

    Raises:
        SceneError: at the names that are taken.
    """
    taken = RESERVED_NAMES | cell.body_names
    seen: set[str] = set()
    faults = SceneFaults()
    for name, pointer in named:
        if name in taken:
            faults.add(SceneError(pointer, f"the name {name} is reserved"))
        elif name in seen:
            faults.add(SceneError(pointer, f"the name {name} is used twice"))
        seen.add(name)
    faults.raise_any()
    return frozenset(seen)


def start_positions(given: tuple[float, ...] | None, cell: Cell) -> Array:
    """Return where the (12,) joints start [rad]: at home unless the task says otherwise.

    Raises:
        SceneError: Joints are beyond their limits.
    """
    if given is None:
        return cell.home
    lower = np.concatenate([arm.position_min for arm in cell.arms.values()])
    upper = np.concatenate([arm.position_max for arm in cell.arms.values()])
    positions = np.array(given)
    faults = SceneFaults()
    for i in np.flatnonzero((positions < lower) | (positions > upper)):
        detail = f"the joint's limits are {lower[i]:.6g} and {upper[i]:.6g} rad"
        faults.add(SceneError(f"/start_positions/{i}", detail))
    faults.raise_any()
    return positions
