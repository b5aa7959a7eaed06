"""mplib on motion queries, run by an interpreter of its own: its wheels want another numpy than ours.

Reads a request as JSON from standard input and writes the answers to standard output. Imports nothing of ours, which
that interpreter does not have.
"""

from __future__ import annotations

import json
import os
import sys
import time

import numpy as np


def main() -> None:
    """Answer all queries of a request."""
    answers = os.fdopen(os.dup(1), "w")
    # What the library says while it loads and plans is not for whoever reads the answers.
    os.dup2(2, 1)
    request = json.load(sys.stdin)
    import mplib

    planners = {arm: _planner(mplib, request, arm) for arm in {query["arm"] for query in request["queries"]}}
    found = [_answer(planners[query["arm"]], request, query) for query in request["queries"]]
    json.dump({"answers": found}, answers)
    answers.close()


def _planner(mplib, request: dict, arm: str):
    """Return a planner of one arm in the scene, its other joints where they rest."""
    fcl = mplib.collision_detection.fcl
    box = request["box"]
    shape = fcl.CollisionObject(fcl.Box(np.array(box["size"])), mplib.Pose())
    obstacle = fcl.FCLObject(box["name"], mplib.Pose(np.array(box["T"])), [shape], [mplib.Pose()])
    planner = mplib.Planner(
        request["urdf"],
        f"{arm}_flange",
        srdf=request["srdf"],
        use_convex=True,
        objects=[obstacle],
    )
    allowed = planner.planning_world.get_allowed_collision_matrix()
    for name in box["allowed"]:
        allowed.set_entry(box["name"], name, True)
    return planner


def _answer(planner, request: dict, query: dict) -> dict:
    rest = np.array([request["rest"][name] for name in planner.user_joint_names])
    moved = planner.move_group_joint_indices
    assert [planner.user_joint_names[i] for i in moved] == query["joints"]
    start = rest.copy()
    start[moved] = query["start"]
    planner.robot.set_qpos(start, True)
    touching = [[each.link_name1, each.link_name2] for each in planner.planning_world.check_collision()]
    begun = time.process_time()
    status, path = planner.planner.plan(
        start[moved],
        [np.array(goal) for goal in query["goals"]],
        time=request["planning_time"],
        range=request["range"],
        simplify=True,
    )
    seconds = time.process_time() - begun
    path = np.asarray(path).tolist() if status == "Exact solution" else None
    return {"seconds": seconds, "status": status, "path": path, "touching": touching}


if __name__ == "__main__":
    main()
