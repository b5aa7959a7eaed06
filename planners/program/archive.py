"""All files of a program in one zip: the same plan gives the same bytes."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Mapping
from enum import StrEnum

import numpy as np

from planners.cell.arm import table_of
from planners.cell.asset_shelf import read_robot_file, shipped_shelf
from planners.cell.cell import Cell
from planners.geometry.pose import Array, Transform, inverse, rotation_angle
from planners.kinematics.forward import flange_pose
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from planners.program.guard import NotExportable, exportable, physics_words
from planners.program.schedule import Schedule
from planners.program.table import COLUMNS, forces_table, steps_table, trajectory_table
from planners.program.urscript import Handshake, write_urscript

UR_ROBOTS = ("ur3", "ur3e", "ur5", "ur5e", "ur10", "ur10e", "ur16e", "ur20", "ur30")
"""Arms whose controllers run URScript, by the names of their files."""
Files = Mapping[str, str | bytes]
"""By their names."""
_POSTURES = 8
_CALIBRATION = 0.02, 0.05
"""By how much an arm that was measured is off its maker's table at most [m, rad]."""
_MOMENT = (1980, 1, 1, 0, 0, 0)


class ProgramTarget(StrEnum):
    """What a plan becomes."""

    UR = "ur"
    """URScript, one program for each of two Universal Robots controllers."""
    ROS2 = "ros2"
    """A bag, trajectories, URDF and SRDF, for ROS 2 and MoveIt."""
    CSV = "csv"
    """Tables, for whatever else there is."""


def write_program(
    document: bytes, cell: Cell, target: ProgramTarget, handshake: Handshake = Handshake.REGISTERS
) -> bytes:
    """Return the zip of a program.

    Args:
        document: of the plan, as it was sent; see `exportable`.
        cell: where it is going to run.
        target: what it becomes.
        handshake: of `ProgramTarget.UR`: how the two controllers wait for each other.

    Raises:
        NotExportable: the document must not become a program, or this cell has no such controllers.
    """
    plan = exportable(document, cell)
    files = _WRITERS[target](plan, cell, handshake)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted({**files, "plan.json": document.decode()}.items()):
            archive.writestr(zipfile.ZipInfo(name, _MOMENT), content, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def check_urscript(cell: Cell) -> None:
    """Refuse a cell whose controllers do not run URScript, or mean other forces than the plan does.

    Raises:
        NotExportable: an arm is none of `UR_ROBOTS`, or is not built as the one whose name it has; or, where hands
            exert forces, these are told in another frame than the controller's own.
    """
    for arm in ARMS:
        robot = cell.arms[arm].robot
        if robot.name not in UR_ROBOTS:
            raise NotExportable(f"the {arm} arm is {robot.name}, none of {', '.join(UR_ROBOTS)}: choose ros2 or csv")
        shipped = read_robot_file(shipped_shelf().find("robots", robot.name))
        T_base_controllers = _between_bases(robot.dh, table_of(shipped))
        first = T_base_controllers[0]
        if not all(_near(first, each) for each in T_base_controllers):
            raise NotExportable(f"the {arm} arm is called {robot.name} and is not built as one: choose ros2 or csv")
        if cell.pusher_arms and not _near(first, np.eye(4)):
            turn = np.degrees(rotation_angle(first[:3, :3], np.eye(3)))
            raise NotExportable(
                f"the {arm} arm's first frame is {1e3 * np.linalg.norm(first[:3, 3]):.0f} mm and {turn:.0f} degrees "
                f"off that of a {robot.name}'s controller, in which a program tells forces (a URDF of ROS begins with "
                f"such a link): describe the arm as the shipped {robot.name}, or choose ros2 or csv"
            )


def _between_bases(dh: Array, shipped: Array) -> list[Transform]:
    """Return where the base of one table is for another (4, 4), at some postures: the same at all, for the same arm."""
    postures = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSTURES, 6))
    return [flange_pose(dh, np.eye(4), q) @ inverse(flange_pose(shipped, np.eye(4), q)) for q in postures]


def _near(one: Transform, other: Transform) -> bool:
    """Tell whether two frames differ by no more than an arm's calibration does."""
    off, turn = np.linalg.norm(one[:3, 3] - other[:3, 3]), rotation_angle(one[:3, :3], other[:3, :3])
    return bool(off < _CALIBRATION[0] and turn < _CALIBRATION[1])


def _ur(plan: Plan, cell: Cell, handshake: Handshake) -> Files:
    check_urscript(cell)
    schedule = Schedule.of(plan)
    scripts = {f"{arm}.script": write_urscript(schedule, arm, handshake) for arm in ARMS}
    words = {"plan": plan, "physics": physics_words(plan), "steps": len(schedule.steps), "handshake": handshake.value}
    return {**scripts, "README.txt": _UR_README.format(**words)}


def _ros2(plan: Plan, cell: Cell, handshake: Handshake) -> Files:
    # Here, since it takes longer to load than anything else that a service needs to begin.
    from planners.program.ros2 import write_ros2

    return write_ros2(plan, cell)


def _csv(plan: Plan, cell: Cell, handshake: Handshake) -> Files:
    schedule = Schedule.of(plan)
    return {
        "trajectory.csv": trajectory_table(schedule),
        "forces.csv": forces_table(plan),
        "steps.csv": steps_table(schedule),
        "COLUMNS.md": COLUMNS,
    }


_UR_README = """{plan.cell.name}: a plan for two Universal Robots controllers
written by Liftwright {plan.software.version}
plan {plan.id}
digest {plan.digest}
cell hash {plan.cell.hash}
{plan.duration:.1f} s in {steps} steps; the controllers wait for each other by {handshake}
{physics}

  left.script, right.script   one for each controller; both begin with what has to be filled in for this site
  plan.json                   the plan itself

Nothing here is a safety function. docs/robot.md of Liftwright has what each part of a program does, the registers, and
the checklist for the first time.

With registers nothing moves until a computer confirms steps: `liftwright execute plan.json --left HOST --right HOST`
loads both programs itself. With digital wires load each on its controller, as a script node or over port 30002.
"""
_WRITERS: Mapping[ProgramTarget, Callable[[Plan, Cell, Handshake], Files]] = {
    ProgramTarget.UR: _ur,
    ProgramTarget.ROS2: _ros2,
    ProgramTarget.CSV: _csv,
}
