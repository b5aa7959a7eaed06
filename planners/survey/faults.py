"""What is wrong with a cell whose files can be read: found before anything is planned in it, in millimetres."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from planners.cell.arm import Arm, Robot
from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell, CellParts, StaticBox, ToolRest
from planners.cell.cell_tool import CellTool
from planners.cell.hand import Gripper, Pusher
from planners.collision.distance import distance
from planners.errors import AssetError, AssetFault, AssetFaults, SceneError
from planners.geometry.convex import CollisionBody, ConvexShape, sorted_pair
from planners.geometry.pose import Array, Transform
from planners.hands.workcell import Clearance
from planners.scene.clashes import arm_frames
from planners.scene.suction_tool import check_tool, tool_of_cell
from planners.survey.survey import CellSurvey

SUNK = 0.005
"""How deep the base of an arm may be in the table that it is mounted on [m]."""
LEVEL = 1e-6
"""Gravity may be off the vertical by so much, for rounding [rad]: plates are lifted along z, against all of it."""
LONGEST_PULL = 30.0
"""No planet on which anybody builds has more [m/s^2]."""


_UNIT = ": are all lengths in metres?"
LARGEST_TABLE = 20.0
"""Side of a table [m], as of any other body that never moves."""
TOO_LARGE = 2.0
"""So many times longer than its arm, a link was most likely drawn in another unit."""


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
    return parts.whole(faults)


def check_cell(cell: Cell) -> None:
    """Refuse a cell in which nothing could be planned.

    Joints at home must be within their ranges and everything there be as far apart as planning keeps it, arms must not
    stand in the table, nor farther from it than they are long, links must not be larger than their arms, forces and
    centres of mass must be such as hands have, a tool rest must be on the table, suction tools must be such as tasks
    may describe, two grippers must be equal, and gravity must point down.

    Raises:
        AssetError: All that is wrong, each with its file and member.
    """
    faults = AssetFaults()
    cell_file, mount, table = f"cells/{cell.name}.yaml", f"mounts/{cell.mount}.yaml", cell.boxes[0]
    _check_gravity(cell.gravity, cell_file, faults)
    _check_table(table, mount, faults)
    if cell.tool_rest is not None:
        _check_tool_rest(cell.tool_rest, table, cell_file, faults)
    _check_tools(cell.tools, faults)
    _check_grippers(cell, cell_file, faults)
    for arm in cell.arms.values():
        _check_arm(arm, table, mount, faults)
    _check_meetings(cell, faults)
    faults.raise_any()


def surveyed(cell: Cell, bundle: CellBundle) -> CellSurvey:
    """Look at a cell that was loaded from a bundle; takes some seconds.

    Raises:
        AssetError: Its hands reach nothing of the table.
    """
    survey = CellSurvey.of(cell)
    if survey.reach.dead.all():
        height = f"{1e3 * (survey.reach.z - cell.table_top):.0f} mm"
        fault = AssetFault(f"no hand reaches any place {height} above it{_UNIT}", f"mounts/{cell.mount}.yaml", "/table")
        raise AssetError(bundle.as_given(fault))
    return survey


def doubts_about(cell: Cell) -> list[str]:
    """Return what a cell may say and most likely does not mean."""
    return [
        f"the {name} arm's home_deg are all below 2 pi: they are taken in degrees; were they written in radians?"
        for name, arm in cell.arms.items()
        if 0.0 < float(np.abs(np.degrees(arm.home)).max()) < 2.0 * np.pi
    ]


def _check_parts(parts: CellParts, faults: AssetFaults) -> None:
    """Check what there is as `check_cell` does."""
    if parts.assembled is not None:
        with faults.at(""):
            check_cell(parts.assembled)
        return
    _check_tools(parts.tools, faults)
    if parts.file is not None:
        _check_gravity(np.array(parts.file.gravity), f"cells/{parts.file.name}.yaml", faults)
    if parts.mount is not None:
        mount = f"mounts/{parts.mount.name}.yaml"
        _check_table(parts.table, mount, faults)
        for arm in parts.arms.values():
            _check_arm(arm, parts.table, mount, faults)


def _check_table(table: StaticBox, mount: str, faults: AssetFaults) -> None:
    if (longest := float(table.size.max())) > LARGEST_TABLE:
        faults.add(f"is {longest:g} m long; {LARGEST_TABLE:g} m at most fit{_UNIT}", mount, "/table/size")


def _check_tool_rest(rest: ToolRest, table: StaticBox, file: str, faults: AssetFaults) -> None:
    corners = np.array([wall.center[:2] + side * 0.5 * wall.size[:2] for wall in rest.walls for side in (-1.0, 1.0)])
    if (np.abs(corners - table.center[:2]) > 0.5 * table.size[:2] + 1e-9).any():
        low, high = (table.center[:2] + side * 0.5 * table.size[:2] for side in (-1.0, 1.0))
        ranges = f"x {low[0]:g} to {high[0]:g}, y {low[1]:g} to {high[1]:g} m"
        faults.add(f"the tool rest is not all on the table, which is {ranges}", file, "/tool_rest/position")


def _check_tools(tools: Mapping[str, CellTool], faults: AssetFaults) -> None:
    for name, tool in tools.items():
        try:
            check_tool(tool_of_cell(tool))
        except SceneError as error:
            faults.add(error.detail, f"tools/{name}.yaml", error.pointer)


def _check_grippers(cell: Cell, file: str, faults: AssetFaults) -> None:
    grippers = {name: hand for name, arm in cell.arms.items() if isinstance(hand := arm.hand, Gripper)}
    if len(grippers) > 1 and len({hand.fingerprint for hand in grippers.values()}) > 1:
        names = " and ".join(hand.name for hand in grippers.values())
        detail = f"{names} differ: a suction tool is passed on between two equal grippers"
        faults.add(detail, file, f"/arms/{[*grippers][-1]}/hand")


def _check_arm(arm: Arm, table: StaticBox, mount: str, faults: AssetFaults) -> None:
    _check_hand(arm.hand, faults)
    _check_home_range(arm, mount, faults)
    _check_links(arm.robot, faults)
    if not _too_large(arm.robot):
        _check_base(arm, table, mount, faults)


def _check_hand(hand: Gripper | Pusher, faults: AssetFaults) -> None:
    """Check numbers that belong together."""
    file = f"hands/{hand.name}.yaml"
    if hand.com[2] > (end := _end(hand)):
        detail = f"the centre of mass is {hand.com[2]:g} m from the flange, and the hand ends at {end:.3g} m{_UNIT}"
        faults.add(detail, file, "/com")
    if not isinstance(hand, Gripper):
        return
    if hand.force_min > hand.force_max:
        faults.add("must list the least force first", file, "/force_range")
    elif not hand.force_min <= hand.squeeze <= hand.force_max:
        detail = f"{hand.squeeze:g} N are not within force_range, {hand.force_min:g} to {hand.force_max:g} N"
        faults.add(detail, file, "/squeeze")


def _end(hand: Gripper | Pusher) -> float:
    """Return how far from the flange a hand ends [m]."""
    bodies = hand.bodies("hand", hand.width_max) if isinstance(hand, Gripper) else hand.bodies("hand")
    return max(float(shape.vertices[:, 2].max()) + shape.radius for body in bodies for shape in body.shapes)


def _length(robot: Robot) -> float:
    """Return how long an arm is when all of its table's rows are put end to end [m]."""
    return float(np.hypot(robot.dh[:, 0], robot.dh[:, 2]).sum())


def _too_large(robot: Robot) -> dict[str, float]:
    """Return links that are far larger than their arm, and how long they are [m]."""
    sizes = {link.name: float(np.ptp(link.points, axis=0).max()) for link in robot.links}
    return {name: size for name, size in sizes.items() if size > TOO_LARGE * _length(robot)}


def _check_links(robot: Robot, faults: AssetFaults) -> None:
    if large := _too_large(robot):
        sizes = f"up to {max(large.values()):.4g} m long, and the arm {_length(robot):.3g} m"
        hint = "are all lengths in metres, and is the unit of meshes what scale says?"
        faults.add(f"{', '.join(large)}: {sizes}: {hint}", f"robots/{robot.name}.yaml", "/links")


def _check_meetings(cell: Cell, faults: AssetFaults) -> None:
    # Everything overlaps with a link in millimetres, which says nothing more than that it is.
    large = [name for name, arm in cell.arms.items() if _too_large(arm.robot)]
    for meeting in meetings_at_home(cell):
        arms = [name for name in cell.arms if any(body.startswith(f"{name}_") for body in meeting.bodies)]
        if not any(name in large for name in arms):
            faults.add(meeting.sentence(), f"mounts/{cell.mount}.yaml", f"/arms/{arms[0]}/home_deg")


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


def meetings_at_home(cell: Cell) -> Iterator[Meeting]:
    """Yield all pairs of bodies, of those that are ever checked, that are nearer at home than planning keeps them."""
    clearance, bodies = Clearance.of(cell), cell.collision_bodies()
    within_arms = clearance.within_arms(bodies)
    frames = {"world": np.eye(4), **arm_frames(cell, cell.home)}
    for one, other in itertools.combinations(bodies, 2):
        names = sorted_pair(one.name, other.name)
        if one.frame == other.frame or names in cell.excluded_pairs:
            continue
        margin = within_arms.get(names, clearance.margin)
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
    if -sunk > (length := _length(arm.robot) + _end(arm.hand)):
        detail = f"the arm's base is {-sunk:.4g} m from the table, and arm and hand are {length:.3g} m long{_UNIT}"
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
