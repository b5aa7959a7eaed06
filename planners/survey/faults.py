"""What is wrong with a cell whose files can be read: found before anything is planned in it, in millimetres."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from planners.cell.arm import Arm
from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell, CellParts, StaticBox
from planners.collision.distance import distance
from planners.errors import AssetFaults
from planners.geometry.convex import CollisionBody, ConvexShape, sorted_pair
from planners.geometry.pose import Array, Transform
from planners.hands.workcell import Clearance
from planners.scene.clashes import arm_frames

SUNK = 0.005
"""How deep the base of an arm may be in the table that it is mounted on [m]."""
LEVEL = 1e-6
"""Gravity may be off the vertical by so much, for rounding [rad]: plates are lifted along z, against all of it."""
LONGEST_PULL = 30.0
"""No planet on which anybody builds has more [m/s^2]."""


def load_checked(bundle: CellBundle, folder: Path) -> Cell:
    """Load a cell of one's own in which something can be planned, unpacked below `folder` as `CellBundle.load` does.

    Raises:
        AssetError: All that is wrong with its files and what `check_cell` refuses, in one: each fault names file and
            member as they were given.
        OSError: The folder cannot be written.
    """
    faults, found = AssetFaults(), AssetFaults()
    parts = bundle.read_parts(folder, faults)
    _check_parts(parts, found)
    faults.take(map(bundle.as_given, found.found))
    faults.raise_any()
    cell = parts.assembled
    # What is missing is told.
    assert cell is not None
    return cell


def check_cell(cell: Cell) -> None:
    """Refuse a cell in which nothing could be planned.

    Joints at home must be within their ranges and everything there be as far apart as planning keeps it, arms must not
    stand in the table, and gravity must point down.

    Raises:
        AssetError: All that is wrong, each with its file and member.
    """
    faults = AssetFaults()
    _check_gravity(cell.gravity, f"cells/{cell.name}.yaml", faults)
    _check_arms(cell.arms.values(), cell.boxes[0], f"mounts/{cell.mount}.yaml", faults)
    _check_meetings(cell, faults)
    faults.raise_any()


def _check_parts(parts: CellParts, faults: AssetFaults) -> None:
    """Check what there is as `check_cell` does."""
    if parts.file is not None:
        _check_gravity(np.array(parts.file.gravity), f"cells/{parts.file.name}.yaml", faults)
    if parts.mount is not None:
        _check_arms(parts.arms.values(), parts.table, f"mounts/{parts.mount.name}.yaml", faults)
    if parts.assembled is not None:
        _check_meetings(parts.assembled, faults)


def _check_arms(arms: Iterable[Arm], table: StaticBox, mount: str, faults: AssetFaults) -> None:
    for arm in arms:
        _check_home_range(arm, mount, faults)
        _check_base(arm, table, mount, faults)


def _check_meetings(cell: Cell, faults: AssetFaults) -> None:
    for meeting in meetings_at_home(cell):
        arm = next(name for name in cell.arms if any(body.startswith(f"{name}_") for body in meeting.bodies))
        faults.add(meeting.sentence(), f"mounts/{cell.mount}.yaml", f"/arms/{arm}/home_deg")


@dataclass(frozen=True)
class Meeting:
    """Two bodies that are too near to one another."""

    bodies: tuple[str, str]
    distance: float
    """Negative: by so much one would have to be moved to come clear [m]."""
    margin: float
    """That planning keeps [m]."""

    def sentence(self) -> str:
        """Say it in millimetres."""
        one, other = self.bodies
        if self.distance < 0.0:
            return f"at home {one} and {other} overlap by {-1e3 * self.distance:.1f} mm"
        gap = f"{1e3 * self.distance:.1f} mm"
        return f"at home {one} and {other} are {gap} apart; planning keeps {1e3 * self.margin:.1f} mm"


def meetings_at_home(cell: Cell, clearance: Clearance | None = None) -> Iterator[Meeting]:
    """Yield all pairs of bodies, of those that are ever checked, that are nearer at home than planning keeps them."""
    margin = (clearance or Clearance()).margin
    frames = {"world": np.eye(4), **arm_frames(cell, cell.home)}
    for one, other in itertools.combinations(cell.collision_bodies(), 2):
        if one.frame == other.frame or sorted_pair(one.name, other.name) in cell.excluded_pairs:
            continue
        apart = _distance(one, frames[one.frame], other, frames[other.frame])
        if apart < margin:
            yield Meeting((one.name, other.name), apart, margin)


def _check_gravity(gravity: Array, file: str, faults: AssetFaults) -> None:
    pull = float(np.linalg.norm(gravity))
    if not 0.0 < pull <= LONGEST_PULL:
        detail = f"is {pull:g} m/s^2; more than 0 and at most {LONGEST_PULL:g} are needed, 9.81 on Earth"
    elif gravity[2] > 0.0 or float(np.linalg.norm(gravity[:2])) > LEVEL * pull:
        detail = "must point along -z: the table is level, and plates are lifted along z"
    else:
        return
    faults.add(detail, file, "/gravity")


def _check_home_range(arm: Arm, mount: str, faults: AssetFaults) -> None:
    low, home, high = (np.degrees(each) for each in (arm.position_min, arm.home, arm.position_max))
    for i in np.flatnonzero((home < low - 1e-9) | (home > high + 1e-9)):
        joint = arm.robot.joint_names[i]
        detail = f"{home[i]:g} degrees are beyond {joint}'s range, {low[i]:g} to {high[i]:g}"
        faults.add(detail, mount, f"/arms/{arm.name}/home_deg/{i}")


def _check_base(arm: Arm, table: StaticBox, mount: str, faults: AssetFaults) -> None:
    base = arm.link_bodies()[0]
    sunk = -_distance(base, arm.T_world_base, table.collision_body(), np.eye(4))
    if sunk > SUNK:
        detail = f"the arm's base is {1e3 * sunk:.1f} mm deep in the table; {1e3 * SUNK:g} mm are allowed"
        faults.add(detail, mount, f"/arms/{arm.name}/position")


def _distance(one: CollisionBody, T_world_one: Transform, other: CollisionBody, T_world_other: Transform) -> float:
    """Return the distance of two bodies, or less what it takes to part them [m]."""
    return min(
        _signed_distance(a, T_world_one, b, T_world_other) for a, b in itertools.product(one.shapes, other.shapes)
    )


def _signed_distance(a: ConvexShape, T_world_a: Transform, b: ConvexShape, T_world_b: Transform) -> float:
    apart, radii = distance(a, T_world_a, b, T_world_b), a.radius + b.radius
    if apart > -radii or min(len(a.face_normals), len(b.face_normals)) == 0:
        return apart
    # Bodies overlap as deep as the origin is inside the hull of all differences of their points.
    points, others = (s.vertices @ T[:3, :3].T + T[:3, 3] for s, T in ((a, T_world_a), (b, T_world_b)))
    differences = (points[:, None, :] - others).reshape(-1, 3)
    return float(ConvexHull(differences).equations[:, 3].max()) - radii
