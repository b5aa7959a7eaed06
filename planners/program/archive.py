"""All files of a program in one zip: the same plan gives the same bytes."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Mapping
from enum import StrEnum

from planners.cell.cell import Cell
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from planners.program.guard import NotExportable, exportable
from planners.program.schedule import Schedule
from planners.program.table import COLUMNS, motion_table, steps_table
from planners.program.urscript import Handshake, write_urscript

UR_ROBOTS = ("ur3", "ur3e", "ur5", "ur5e", "ur10", "ur10e", "ur16e", "ur20", "ur30")
"""Arms whose controllers run URScript, by the names of their files."""
Files = Mapping[str, str | bytes]
"""By their names."""
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
    """Refuse a cell whose controllers do not run URScript.

    Raises:
        NotExportable: an arm is none of `UR_ROBOTS`.
    """
    for arm in ARMS:
        robot = cell.arms[arm].robot.name
        if robot not in UR_ROBOTS:
            raise NotExportable(f"the {arm} arm is {robot}, none of {', '.join(UR_ROBOTS)}: choose ros2 or csv")


def _ur(plan: Plan, cell: Cell, handshake: Handshake) -> Files:
    check_urscript(cell)
    schedule = Schedule.of(plan)
    return {f"{arm}.script": write_urscript(schedule, arm, handshake) for arm in ARMS}


def _ros2(plan: Plan, cell: Cell, handshake: Handshake) -> Files:
    # Here, since it takes longer to load than anything else that a service needs to begin.
    from planners.program.ros2 import write_ros2

    return write_ros2(plan, cell)


def _csv(plan: Plan, cell: Cell, handshake: Handshake) -> Files:
    return {
        "motion.csv": motion_table(plan),
        "steps.csv": steps_table(Schedule.of(plan)),
        "COLUMNS.md": COLUMNS,
    }


_WRITERS: Mapping[ProgramTarget, Callable[[Plan, Cell, Handshake], Files]] = {
    ProgramTarget.UR: _ur,
    ProgramTarget.ROS2: _ros2,
    ProgramTarget.CSV: _csv,
}
