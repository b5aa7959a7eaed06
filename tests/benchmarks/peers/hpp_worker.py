"""HPP on a tool that passes from one hand to the other, in a process of its own.

Its wheels find their libraries only where `LD_LIBRARY_PATH` names the folder as the process begins. Reads a request as
JSON from standard input and writes what was found to standard output.
"""

from __future__ import annotations

import json
import os
import sys
import time

import numpy as np

GIVER, RECEIVER = "cell/giver", "cell/receiver"
"""The grippers."""
GIVEN, TAKEN = "tool/given", "tool/taken"
"""The handles."""
MOST_ITERATIONS = 1_000_000
"""The time ends the search before."""


def main() -> None:
    """Plan the same transfer several times."""
    answers = os.fdopen(os.dup(1), "w")
    # What the libraries say is not for whoever reads the answers.
    os.dup2(2, 1)
    request = json.load(sys.stdin)
    json.dump({"answers": [_plan(request) for _ in range(request["runs"])]}, answers)
    answers.close()


def _plan(request: dict) -> dict:
    from pyhpp.core import RandomShortcut
    from pyhpp.manipulation import ManipulationPlanner

    robot, problem = _stated(request)
    start, goal = (_configuration(robot, request, request[end]) for end in ("start", "goal"))
    problem.initConfig(start)
    problem.addGoalConfig(goal)
    planner = ManipulationPlanner(problem)
    planner.maxIterations(MOST_ITERATIONS)
    planner.timeOut(request["planning_time"])
    begun, path, shorter, said = time.process_time(), None, None, ""
    try:
        path = planner.solve()
        shorter = RandomShortcut(problem).optimize(path)
    except Exception as error:  # noqa: BLE001 - whatever it says is told
        said = str(error)
    seconds = time.process_time() - begun
    found = path if shorter is None else shorter
    return {"seconds": seconds, "said": said, "samples": None if found is None else _sampled(robot, request, found)}


def _stated(request: dict):
    """Return the robot with the tool, and the problem with its graph: given, in both hands, taken, and nothing else."""
    from pinocchio import SE3
    from pyhpp.core import Dichotomy, ProgressiveProjector, Straight
    from pyhpp.manipulation import Device, Graph, Problem, urdf
    from pyhpp.manipulation.constraint_graph_factory import ConstraintGraphFactory, Rule
    from pyhpp.manipulation.security_margins import SecurityMargins

    robot = Device("cell-and-tool")
    urdf.loadModelFromString(robot, 0, "cell", "anchor", request["urdf"], request["srdf"], SE3.Identity())
    urdf.loadModelFromString(
        robot, 0, "tool", "freeflyer", request["tool_urdf"], '<robot name="tool"/>', SE3.Identity()
    )
    robot.setJointBounds("tool/root_joint", [*[-2.0, 2.0] * 3, *[-1.0001, 1.0001] * 4])
    for gripper, handle, each in ((GIVER, GIVEN, request["giver"]), (RECEIVER, TAKEN, request["receiver"])):
        robot.addGripper(f"cell/{each['link']}", gripper, SE3(np.array(each["T_link_gripper"])), request["clearance"])
        robot.addHandle("tool/tool", handle, SE3(np.array(each["T_tool_handle"])), 0.0, _all())
    problem = Problem(robot)
    problem.clearConfigValidations()
    problem.addConfigValidation("CollisionValidation")
    problem.addConfigValidation("JointBoundValidation")
    graph = Graph("handover", robot, problem)
    graph.maxIterations(40)
    graph.errorThreshold(1e-4)
    problem.steeringMethod = Straight(problem)
    # Bodies may overlap by nothing.
    problem.pathValidation = Dichotomy(robot, 0.0)
    problem.pathProjector = ProgressiveProjector(problem.distance(), problem.steeringMethod, 0.05)
    factory = ConstraintGraphFactory(graph)
    factory.setGrippers([GIVER, RECEIVER])
    factory.setObjects(["tool"], [[GIVEN, TAKEN]], [[]])
    factory.setRules(
        [
            Rule(grippers=[GIVER, RECEIVER], handles=[GIVEN, "^$"], link=True),
            Rule(grippers=[GIVER, RECEIVER], handles=[GIVEN, TAKEN], link=True),
            Rule(grippers=[GIVER, RECEIVER], handles=["^$", TAKEN], link=True),
        ]
    )
    factory.generate()
    margins = SecurityMargins(problem, factory, ["cell", "tool"], robot)
    margins.defaultMargin = request["margin"]
    margins.apply()
    problem.constraintGraph(graph)
    graph.initialize()
    return robot, problem


def _all():
    from pinocchio import StdVec_Bool

    mask = StdVec_Bool()
    mask.extend([True] * 6)
    return mask


def _configuration(robot, request: dict, end: dict) -> np.ndarray:
    q = np.array(robot.currentConfiguration(), dtype=float)
    for name, value in zip(request["joints"], end["q"], strict=True):
        q[robot.rankInConfiguration[f"cell/{name}"]] = value
    rank = robot.rankInConfiguration["tool/root_joint"]
    q[rank : rank + 7] = end["tool"]
    return q


def _sampled(robot, request: dict, path) -> list[list[float]]:
    """Return joints and pose of the tool along a path."""
    ranks = [robot.rankInConfiguration[f"cell/{name}"] for name in request["joints"]]
    tool = robot.rankInConfiguration["tool/root_joint"]
    span = path.timeRange()
    first, last = float(span.first), float(span.second)
    rows = []
    for t in np.linspace(first, last, max(2, int(np.ceil((last - first) / request["step"])) + 1)):
        q, good = path(float(t))
        if good:
            rows.append([*q[ranks].tolist(), *q[tool : tool + 7].tolist()])
    return rows


if __name__ == "__main__":
    main()
