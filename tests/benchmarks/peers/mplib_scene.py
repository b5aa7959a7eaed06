"""Asks mplib, in an interpreter of its own, for the motion of arms beside a box."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import numpy as np

from planners.cell.cell import Cell
from planners.geometry.pose import Array, Transform
from planners.program.cell_description import CellDescription

INTERPRETER = "LIFTWRIGHT_MPLIB_PYTHON"
"""The environment variable that names an interpreter with mplib."""
REASON = (
    "its wheels ask for numpy < 2, which nothing else here works with, and end the process when they are imported "
    f"beside numpy 2; where `{INTERPRETER}` names an interpreter of another environment that has mplib, it is measured"
)
RANGE = 0.1
"""Of RRT-Connect, as `Planner.plan_qpos` has it unless told [rad]."""
_WORKER = Path(__file__).with_name("mplib_worker.py")


@dataclass(frozen=True, eq=False)
class BoxObstacle:
    """A box beside the cell."""

    name: str
    size: Sequence[float]
    T_world_box: Transform
    allowed: Sequence[str]
    """Links that may touch it."""


@dataclass(frozen=True, eq=False)
class MplibQuery:
    """One arm from a start to any of several goals."""

    arm: str
    start: Array
    goals: Array


@dataclass(frozen=True, eq=False)
class MplibAnswer:
    """A path (m, 6) or None, and the CPU time it took."""

    path: Array | None
    seconds: float
    touching: Sequence[Sequence[str]]
    """What it takes to touch at the start."""


class NoInterpreter(Exception):
    """Nothing names an interpreter that has mplib, or what it names has none."""


def ask_mplib(
    cell: Cell, obstacle: BoxObstacle, queries: Sequence[MplibQuery], planning_seconds: float
) -> list[MplibAnswer]:
    """Have all queries answered.

    Raises:
        NoInterpreter: There is no mplib.
    """
    interpreter = os.environ.get(INTERPRETER)
    if not interpreter:
        raise NoInterpreter(REASON)
    with TemporaryDirectory() as name:
        folder = Path(name)
        description = CellDescription(cell, "cell")
        (folder / "cell.urdf").write_text(description.urdf)
        (folder / "cell.srdf").write_text(description.srdf)
        for path, content in description.meshes.items():
            # It has a convex mesh in a file of this name, which it writes itself where its own tools may.
            for file in (folder / "cell" / path, folder / "cell" / f"{path}.convex.stl"):
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content)
        request = {
            "urdf": str(folder / "cell.urdf"),
            "srdf": str(folder / "cell.srdf"),
            "box": {"name": obstacle.name, "size": list(obstacle.size), "T": obstacle.T_world_box.tolist(),
                    "allowed": list(obstacle.allowed)},
            "rest": _rest(cell, description),
            "planning_time": planning_seconds,
            "range": RANGE,
            "queries": [
                {"arm": query.arm, "joints": list(cell.arms[query.arm].joint_names), "start": query.start.tolist(),
                 "goals": query.goals.tolist()}
                for query in queries
            ],
        }  # fmt: skip
        done = subprocess.run(
            [interpreter, str(_WORKER)], input=json.dumps(request), capture_output=True, text=True, check=False
        )
    if done.returncode:
        raise NoInterpreter(f"the interpreter that `{INTERPRETER}` names ends with code {done.returncode}")
    return [
        MplibAnswer(None if each["path"] is None else np.array(each["path"]), each["seconds"], each["touching"])
        for each in json.loads(done.stdout)["answers"]
    ]


def _rest(cell: Cell, description: CellDescription) -> dict[str, float]:
    """Return where all joints are while they rest: arms at home, fingers open; it does not know joints that mimic."""
    rest = {name: float(q) for arm in cell.arms.values() for name, q in zip(arm.joint_names, arm.home, strict=True)}
    rest |= {joint.name: joint.position(joint.width_max) for joint in description.finger_joints.values()}
    for joint in ElementTree.fromstring(description.urdf).iter("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            rest[joint.attrib["name"]] = float(mimic.attrib["multiplier"]) * rest[mimic.attrib["joint"]]
    return rest
