"""Small documents of plate lifts, to reckon with by hand."""

from __future__ import annotations

from typing import Any

import numpy as np

from planners.cell.cell import Cell
from planners.contract.task_spec import read_task, write_task
from planners.plan.scenery import JOINT_NAMES
from tests.support.documents import bodies_of, cell_of
from workers.simulation.recording import LIFT_UNITS

SOFTWARE = {"name": "liftwright", "version": "0.1.0", "commit": None}
OF_KIND = {
    "soft_finger": {"eps": 0.0075},
    "suction": {"radius": 0.0175, "kappa": 0.005, "suction_force": 0.0, "x_axis": [1.0, 0.0, 0.0]},
}
"""Members that only contacts of one kind have."""


def contact(sample: int, by: str, kind: str, force: tuple[float, float, float], **members: Any) -> dict[str, Any]:
    """Return a contact on the plate at the origin, its normal up."""
    return {
        "sample": sample,
        "body": "plate",
        "by": by,
        "finger": None,
        "kind": kind,
        "point": [0.0, 0.0, 1.1],
        "normal": [0.0, 0.0, 1.0],
        "wrench": [*force, 0.0, 0.0, 0.0],
        "mu": 0.5,
        "limit": 20.0,
        **OF_KIND.get(kind, {}),
        **members,
    }


def segment(start: float, n: int, **members: Any) -> dict[str, Any]:
    """Return a segment of `n` samples a tenth of a second apart in which nothing moves."""
    return {
        "kind": "transit",
        "movers": ["left"],
        "contact_state": None,
        "hold": None,
        "time": [start + 0.1 * i for i in range(n)],
        "positions": np.zeros((n, 12)).tolist(),
        "velocities": np.zeros((n, 12)).tolist(),
        "accelerations": np.zeros((n, 12)).tolist(),
        "gripper_width": {"right": [0.085] * n},
        "attached": {},
        "body_poses": {},
        "contacts": [],
        **members,
    }


def simulation(duration: float, **members: Any) -> dict[str, Any]:
    """Return a simulation of 50 samples a second in which nothing moves and no force is felt."""
    time = np.arange(0.0, duration, 0.02)
    rest = [0.3, 0.0, 1.114, 1.0, 0.0, 0.0, 0.0]
    return {
        "kind": "plate_lift",
        "outcome": "lifted",
        "time": duration,
        "cause": None,
        "force_curves": [
            {"name": name, "unit": unit, "time": time.tolist(), "value": np.zeros(len(time)).tolist()}
            for name, unit in LIFT_UNITS.items()
        ],
        "minimum_total_force": 19.24,
        "lift": None,
        "dips": {"count": 0, "seconds": 0.0, "lowest": None},
        "manipulation": {
            "nodes": [],
            "largest_difference": 0.0,
            "largest_difference_of_weight": 0.0,
            "largest_distance": 0.0,
            "largest_angle": 0.0,
        },
        "motion": {
            "time": time.tolist(),
            "positions": np.zeros((len(time), 12)).tolist(),
            "plate": [rest] * len(time),
        },
        "model": [],
        "seed": 0,
        "settings": {},
        **members,
    }


def lift(begin: float, **members: Any) -> dict[str, Any]:
    """Return the `lift` of a simulation."""
    return {
        "begin": begin,
        "height": 0.2,
        "reachable_height": 0.25,
        "end_of_reach": "a joint",
        "goal_force": 14.0,
        "cup_reserve": 0.2,
        "lifter_travel": 0.2,
        "lifter_seconds": 5.0,
        "controlled": True,
        **members,
    }


def set_curve(document: dict[str, Any], name: str, values: Any) -> None:
    """Give one curve of a document's simulation other values: a number, or a function of time."""
    curve = next(curve for curve in document["simulation"]["force_curves"] if curve["name"] == name)
    curve["value"] = [float(values(time) if callable(values) else values) for time in curve["time"]]


def lift_document(cell: Cell) -> dict[str, Any]:
    """Return a plan without segments."""
    plate = {
        "role": "plate",
        "shape": {"type": "box", "size": [0.3, 0.3, 0.04]},
        "mass": 4.0,
        "com": [0.0, 0.0, 0.0],
        "pose": [0.3, 0.0, 1.114, 1.0, 0.0, 0.0, 0.0],
        "static": False,
    }
    lifter = {
        "cup": _part("cup", 0.0175, 0.04, 1.154),
        "cable": _part("cable", 0.01, 1.1, 1.724),
    }
    task = {
        "kind": "plate_lift",
        "external_id": "by hand",
        "plate": {"mass": 4.0, "shape": plate["shape"]},
        "plate_pose": plate["pose"],
        "cup": {"position": [0.1, 0.0], "radius": 0.0175, "max_force": 20.0, "mu": 0.5},
        "lifter_model": "paper",
    }
    return {
        "schema_version": "1.0",
        "id": "0" * 32,
        "task": write_task(read_task(task)),
        "seed": 0,
        "software": SOFTWARE,
        "outcome": "infeasible",
        "explanation": {"summary": "nothing was planned", "causes": []},
        "cell": cell_of(cell),
        "joint_names": list(JOINT_NAMES),
        "bodies": {**bodies_of(cell), "plate": plate, **lifter},
        "segments": [],
        "certificate": None,
        "simulation": None,
        "statistics": {"total_seconds": None, "stages": [], "graph": {}, "search": {}, "rejections": {}},
    }


def _part(role: str, radius: float, height: float, z: float) -> dict[str, Any]:
    """Return a part of the lifter, upright over the plate."""
    return {
        "role": role,
        "shape": {"type": "cylinder", "radius": radius, "height": height},
        "mass": None,
        "com": [0.0, 0.0, 0.0],
        "pose": [0.4, 0.0, z, 1.0, 0.0, 0.0, 0.0],
        "static": False,
    }
