"""Small documents of suction-tool plans, to reckon with by hand."""

from __future__ import annotations

from typing import Any

import numpy as np

from planners.cell.cell import Cell
from planners.contract.task_spec import read_task, write_task
from planners.plan.scenery import JOINT_NAMES
from tests.support.documents import bodies_of, cell_of
from tests.support.lift_documents import SOFTWARE, segment
from workers.simulation.recording import TOOL_UNITS

CUP = {"radius": 0.0175, "max_force": 20.0, "mu": 0.5, "kappa": 4.5}
OBJECTS = ("first", "second")
BOX = {"type": "box", "size": [0.1, 0.1, 0.02]}
GRIP = {"arm": "right", "body": "tool", "pose": [0.0, 0.0, 0.15, 1.0, 0.0, 0.0, 0.0], "width": 0.018}
OTHER = {**GRIP, "arm": "left"}
REACH, TOUCH = "The arm does not reach it.", "The hand would touch something."


def hold(*grips: dict[str, Any]) -> dict[str, Any]:
    first, second = (*grips, None)[:2]
    return {"grip": first, "push": None, "second_grip": second}


def move(name: str) -> list[dict[str, Any]]:
    """Return the segments that move one object with the tool in the right hand."""
    held = {"tool": [{"to": "right", "pose": [0.0] * 3 + [1.0, 0.0, 0.0, 0.0]}]}
    on_cup = {**held, name: [{"to": "tool", "pose": [0.0] * 3 + [1.0, 0.0, 0.0, 0.0]}]}
    kinds = [
        ("transfer", held),
        ("attach", held),
        ("transfer", on_cup),
        ("transfer", on_cup),
        ("transfer", on_cup),
        ("detach", held),
        ("transfer", held),
    ]
    return [{"kind": kind, "movers": ["right"], "hold": hold(GRIP), "attached": attached} for kind, attached in kinds]


def tool_document(cell: Cell) -> dict[str, Any]:
    """Return a plan in which the right hand takes the tool and moves two objects, 0.1 s a segment."""
    rest = [0.22, 0.0, 1.094, 1.0, 0.0, 0.0, 0.0]
    bodies = {
        "tool": _body("tool", {"type": "cylinder", "radius": 0.0175, "height": 0.25}, rest, 0.25),
        **{name: _body("object", BOX, [0.4, 0.1 * i, 1.104, 1, 0, 0, 0], 0.1) for i, name in enumerate(OBJECTS)},
    }
    parts = [
        {"kind": "transit", "movers": ["right"]},
        {"kind": "grip", "movers": [], "hold": hold(GRIP)},
        *move("first"),
        *move("second"),
    ]
    both = {"left": [0.085] * 2, "right": [0.018] * 2}
    segments = [segment(0.1 * i, 2, **{"gripper_width": both, **part}) for i, part in enumerate(parts)]
    task = {
        "kind": "suction_tool",
        "external_id": "tool by hand",
        "tool": "long_symmetric",
        "objects": [
            {
                **{"name": name, "mass": 0.1, "shape": BOX, "pose": bodies[name]["pose"]},
                "goal_pose": [0.4, 0.0, 1.104 + 0.02 * i, 1.0, 0.0, 0.0, 0.0],
            }
            for i, name in enumerate(OBJECTS)
        ],
    }
    return {
        "schema_version": "1.0",
        "id": "1" * 32,
        "task": write_task(read_task(task)),
        "seed": 0,
        "software": SOFTWARE,
        "outcome": "solved",
        "explanation": {"summary": "2 objects moved", "causes": []},
        "cell": cell_of(cell),
        "joint_names": list(JOINT_NAMES),
        "bodies": {**bodies_of(cell), **bodies},
        "segments": segments,
        "certificate": None,
        "simulation": None,
        "statistics": {
            "total_seconds": None,
            "stages": [],
            "graph": {},
            "search": {},
            "rejections": {},
            "considered": considered(),
        },
    }


def considered() -> dict[str, Any]:
    """Return what was looked at: two places, three grasps, and a graph of the first object."""
    pose = [0.4, 0.0, 1.114, 1.0, 0.0, 0.0, 0.0]
    chosen = {"round": 0, "goal": None, "state": "chosen", "reason": None}
    return {
        "order": list(OBJECTS),
        "steps": [],
        "places": {
            "first": [
                {"point": [0.0, 0.0, 0.01], "normal": [0.0, 0.0, 1.0], "reason": None},
                {"point": [0.05, 0.0, 0.01], "normal": [0.0, 0.0, 1.0], "reason": "The pad would reach over."},
            ]
        },
        "suction_poses": [],
        "tool_grasps": {"poses": [GRIP["pose"]] * 3, "widths": [0.018, 0.018, 0.017]},
        "regrasp_graphs": [
            {
                "object": "first",
                "moved": moved,
                "suction_pose": pose,
                "arms": ["left", "right"],
                "layers": [
                    {"layer": "initial", "goal": None, "tool_pose": pose, "possible": [3, 4], "rejected": {REACH: [0]}},
                    {
                        "layer": "suction",
                        "goal": None,
                        "tool_pose": pose,
                        "possible": [4],
                        "rejected": {REACH: [0, 1], TOUCH: [5]},
                    },
                    {"layer": "goal", "goal": 0, "tool_pose": pose, "possible": [4], "rejected": {}},
                ],
                "handover_pairs": [7, 5],
                "edges": [
                    {"kind": "pick", "from": None, "to": 4, **chosen},
                    {"kind": "transfer", "from": 4, "to": 4, **chosen},
                    {"kind": "transfer", "from": 4, "to": 4, **chosen, "round": 1, "goal": 0},
                ],
                "sequence": [0, 1, 2] if moved else [],
            }
            for moved in (False, True)
        ],
    }


def tool_simulation(duration: float, **members: Any) -> dict[str, Any]:
    """Return a simulation in which nothing moves and nothing is borne."""
    time = np.arange(0.02, duration, 0.02).round(4).tolist()
    still = {"time": [time[0], time[-1]], "poses": [[0.4, 0.0, 1.104, 1.0, 0.0, 0.0, 0.0]] * 2}
    return {
        "kind": "suction_tool",
        "outcome": "done",
        "time": duration,
        "failed_at": None,
        "cause": None,
        "force_curves": [
            {"name": name, "unit": unit, "time": time, "value": [0.0] * len(time)} for name, unit in TOOL_UNITS.items()
        ],
        "goals": {name: {"distance": 0.001 * (i + 1), "angle": 0.0} for i, name in enumerate(OBJECTS)},
        "largest": {"suction_share": 0.0, "squeeze": 0.0, "tool_off_plan": 0.0, "object_off_plan": 0.0},
        "motion": {
            "time": time,
            "positions": [[0.0] * 12] * len(time),
            "bodies": dict.fromkeys(("tool", *OBJECTS), still),
        },
        "model": [],
        "settings": {},
        **members,
    }


def _body(role: str, shape: dict[str, Any], pose: list[float], mass: float) -> dict[str, Any]:
    return {"role": role, "shape": shape, "mass": mass, "com": [0.0, 0.0, 0.0], "pose": pose, "static": False}
