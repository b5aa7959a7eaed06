"""Small suction-tool plans for the certificate to look at."""

from __future__ import annotations

from itertools import count
from typing import Any

from planners.cell.cell import Cell, load_cell
from planners.certify import CellReference
from planners.contract.task_spec import read_task
from planners.geometry.solid_mesh import SolidMesh
from planners.planning import HandoverSource, plan, reference_of
from planners.progress import Progress, silent
from planners.regrasp.grasps.handover_place import HandoverPlaceSettings
from planners.regrasp.grasps.handovers import HandoverDatabase, HandoverSettings, find_handovers, handover_key
from planners.regrasp.grasps.tool_grasps import ToolGraspSettings
from planners.scene.scene import build_scene
from planners.scene.suction_tool import SuctionTool

Document = dict[str, Any]
QUARTER = [0.7071067811865476, 0.0, 0.0, 0.7071067811865476]
"""Quaternion of a quarter turn about z."""
FEW = HandoverSettings(
    ToolGraspSettings(rolls=8), HandoverPlaceSettings(step=0.2, finest=0.2, grasps=16, best=2), axis_rolls=1
)
"""Fewer grasps and handovers than a job has: soon found."""
_found: dict[str, HandoverDatabase] = {}


def few_handovers(
    cell: Cell, tool: SuctionTool, settings: HandoverSettings, progress: Progress = silent
) -> HandoverDatabase:
    """Find them once for all tests of a process: they depend on the robot and the tool alone."""
    key = handover_key(cell, tool, FEW)
    if key not in _found:
        _found[key] = find_handovers(cell, tool, FEW, progress)
    return _found[key]


def block(**members: Any) -> dict[str, Any]:
    """An object of a task: a flat block on the left of the table, and its goal nearer to the middle."""
    return {
        "name": "block", "shape": {"type": "box", "size": [0.13, 0.07, 0.02]}, "mass": 0.1,
        "pose": [0.3, 0.3, 1.104, *QUARTER], "goal_pose": [0.4, 0.15, 1.104, *QUARTER],
    } | members  # fmt: skip


def answered(
    body: dict[str, Any], uploads: dict[str, SolidMesh] | None = None, handovers: HandoverSource = few_handovers
) -> Document:
    """Return what the planner makes of a task; its clock counts calls."""
    task = read_task({"kind": "suction_tool", **body})
    scene = build_scene(task, uploads=(uploads or {}).get)
    ticks = count()
    return plan(task, scene, silent, lambda: float(next(ticks)), handovers).document()


def planned(
    body: dict[str, Any], uploads: dict[str, SolidMesh] | None = None, handovers: HandoverSource = few_handovers
) -> Document:
    """Return the document of a task that has a plan, without its certificate."""
    document = answered(body, uploads, handovers)
    assert document["outcome"] == "solved", document["explanation"]
    return document | {"id": "probe", "software": {"name": "liftwright", "version": "0", "commit": None}}


def reference_of_the_tool_cell() -> CellReference:
    """What the certificate may take for known."""
    return reference_of(load_cell("dual_ur3e_tool"))
