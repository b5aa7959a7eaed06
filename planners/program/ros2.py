"""A plan for ROS 2: a package with the cell's description, a bag, and all trajectories as JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

import planners.program.ros2_messages as ros
from planners.cell.cell import Cell
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from planners.program.cell_description import CellDescription
from planners.program.guard import NotExportable, physics_words
from planners.program.ros2_bag import gripper_topic, segment_times, trajectory_topic, vacuum_topic, write_bag
from planners.program.schedule import Schedule

GROUP = "both"
"""Of the SRDF, whose joints a trajectory has."""


def write_ros2(plan: Plan, cell: Cell) -> dict[str, str | bytes]:
    """Return all files, by their paths in the package.

    Args:
        plan: that may be exported, see `guard`.
        cell: in which it runs.

    Raises:
        NotExportable: a body has the name of a link, so that there would be two frames of one name.
    """
    description = CellDescription(cell, package_name(cell))
    taken = sorted({*plan.bodies, *ARMS} & ({*description.links} - {body.name for body in cell.still}))
    if taken:
        raise NotExportable(f"{', '.join(taken)} would name a body and a link of the cell: name the body otherwise")
    schedule = Schedule.of(plan)
    return {
        **write_bag(schedule, description),
        **description.meshes,
        "cell.urdf": description.urdf,
        "cell.srdf": description.srdf,
        "joint_limits.yaml": description.joint_limits,
        "trajectories.json": json.dumps(trajectories(schedule, description), allow_nan=False, separators=(",", ":")),
        "package.xml": _package(description),
        "CMakeLists.txt": _BUILD.format(package=description.package),
        "README.txt": _readme(plan, description),
    }


def package_name(cell: Cell) -> str:
    """Return the name of the ROS package that describes a cell: small letters, digits and single underscores."""
    return "liftwright_" + re.sub(r"[^a-z0-9]+", "_", cell.name.lower()).strip("_")


def trajectories(schedule: Schedule, description: CellDescription) -> dict[str, Any]:
    """Return `trajectories.json`: what each step needs, members of messages named as MoveIt has them."""
    plan, steps = schedule.plan, []
    for step, segment in zip(schedule.steps, plan.segments, strict=True):
        joints = ros.joint_trajectory(
            plan.joint_names,
            segment_times(segment),
            segment.positions,
            segment.velocities,
            segment.accelerations,
        )
        hands: dict[str, Any] = {}
        for arm in ARMS:
            does = step.arms[arm]
            finger = description.finger_joints.get(arm)
            position = None if finger is None or does.width is None else finger.position(does.width)
            hands[arm] = {
                "payload": {"mass": does.load.mass, "com": does.load.com},
                "width": does.width,
                "finger_position": position,
                "squeeze": does.squeeze,
                "vacuum": does.vacuum,
            }
        steps.append(
            {
                "number": step.number,
                "kind": step.kind.value,
                "words": step.words,
                "stop_share": step.stop_share,
                **hands,
                "robot_trajectory": ros.as_json(ros.message("moveit_msgs/RobotTrajectory", joint_trajectory=joints)),
            }
        )
    return {
        "plan": plan.id,
        "digest": plan.digest,
        "cell": {"name": plan.cell.name, "hash": plan.cell.hash},
        "group": GROUP,
        "openings": {
            arm: {"width": width, "finger_position": description.finger_joints[arm].position(width)}
            for arm, width in schedule.openings.items()
        },
        "steps": steps,
    }


def _package(description: CellDescription) -> str:
    return f"""<?xml version="1.0"?>
<package format="3">
  <name>{description.package}</name>
  <version>0.0.0</version>
  <description>The cell {description.cell.name}, and a plan for it.</description>
  <maintainer email="nobody@example.com">nobody</maintainer>
  <license>Proprietary</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <exec_depend>robot_state_publisher</exec_depend>
  <exec_depend>rosbag2_storage_mcap</exec_depend>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""


_BUILD = """cmake_minimum_required(VERSION 3.8)
project({package})
find_package(ament_cmake REQUIRED)
install(DIRECTORY meshes DESTINATION share/${{PROJECT_NAME}})
install(
  FILES cell.urdf cell.srdf joint_limits.yaml trajectories.json plan.json plan.mcap metadata.yaml
  DESTINATION share/${{PROJECT_NAME}})
ament_package()
"""


def _readme(plan: Plan, description: CellDescription) -> str:
    assert plan.certificate is not None, "only plans with a certificate are exported"
    fingers = description.finger_joints
    rows: Mapping[str, str] = {
        **{
            trajectory_topic(arm): "trajectory_msgs/JointTrajectory: the samples of each step, as it begins"
            for arm in ARMS
        },
        **{
            gripper_topic(arm): f"control_msgs/GripperCommand: position of the joint {joint.name}, force of a pad [N]; "
            "0: they open"
            for arm, joint in fingers.items()
        },
        **{vacuum_topic(arm): "std_msgs/Bool: vacuum of the tool, whichever hand has it" for arm in fingers},
        "/liftwright/step": "std_msgs/String: what is done, for a person",
        "/joint_states": "sensor_msgs/JointState: both arms, and the fingers",
        "/tf, /tf_static": "tf2_msgs/TFMessage: bodies in the frame world, by their names in the plan",
        "/liftwright/bodies": "visualization_msgs/MarkerArray: their shapes, each in its own frame",
        "/planning_scene": "moveit_msgs/PlanningScene: bodies, and what hangs on which flange",
    }
    topics = "\n".join(f"  {topic:36}{what}" for topic, what in rows.items())
    return f"""{description.cell.name}: a plan for ROS 2, written by Liftwright {plan.software.version}
plan {plan.id}
digest {plan.digest}
cell hash {plan.cell.hash}
certificate passed, {len(plan.certificate.checks)} checks; {plan.duration:.1f} s in {len(plan.segments)} steps
{physics_words(plan)}

Nothing here is a safety function. docs/robot.md of Liftwright has the checklist for the first time.

WHAT IS HERE
  plan.mcap, metadata.yaml  the plan as a bag (rosbag2, storage mcap); this folder is the bag
  trajectories.json         for each step: moveit_msgs/RobotTrajectory of the group {GROUP}, payloads, fingers, vacuum
  cell.urdf, cell.srdf      the cell; meshes/ has the convex shapes that the plan was checked with
  joint_limits.yaml         speeds and accelerations, for MoveIt
  package.xml, CMakeLists.txt  this folder is a package, {description.package}, so that meshes are found
  plan.json                 the plan itself

TO LOOK AT IT
  Unpack it as src/{description.package} of a workspace, and there:
    colcon build --packages-select {description.package} && source install/setup.bash
    ros2 run robot_state_publisher robot_state_publisher --ros-args -p use_sim_time:=true \\
      -p robot_description:="$(cat src/{description.package}/cell.urdf)"
    rviz2 --ros-args -p use_sim_time:=true     fixed frame world; RobotModel, and MarkerArray of /liftwright/bodies
    ros2 bag play --clock 100 src/{description.package}
  Do so where no robot listens, with a ROS_DOMAIN_ID of its own: a bag says /joint_states too.

THE BAG
{topics}
  Stamps are the plan's clock, which begins at 0. Trajectories carry it as their stamp: what sends them to a controller
  puts there when the step shall begin, the same for both arms, or 0 for at once.

TO MOVE ROBOTS
  - Both arms begin a step together, and none before both have ended the one before. In a step in which an arm rests its
    trajectory says so.
  - Between two samples the plan is the cubic with the positions and velocities there. A joint_trajectory_controller
    takes that cubic if it is sent no accelerations, else a quintic that is within {_quintic(plan):.1e} rad of it.
  - Before the first step bring the fingers to the openings that trajectories.json states, and the vacuum off: wait
    until they are there.
  - Before a step set the payload that trajectories.json states, and fingers and vacuum as the bag says; wait until
    fingers have closed before the next step begins. Of a payload, mass is in kg and com in m in <arm>_flange, the hand
    included; width is in m, squeeze the force of each pad in N.
  - A stop within 1/16 s from more than stop_share of the planned speed may lose what a tool carries in a step.
  - Check that the arms are where the first step begins, to 0.01 rad.
  - The lift behind a vacuum lifter follows what wrists feel, and is not in here.

THE MODEL
  Frames: <arm>_base before the first joint, <arm>_flange behind the last one, <arm>_tcp; world is on the floor.
  Groups: left, right, both, left_hand, right_hand; the state home is where the cell has the arms at rest.
  Links that the SRDF does not check against each other are those that the plan was not checked for either: what never
  moves, and what is at most one joint apart. With each step a planning scene allows what touches in it as well: what
  hands hold, and what bears what.
  Links have the masses of the cell's files; what turns them is as if these were spread evenly over the shapes. How fast
  fingers are the files do not say: 1 s for all of their way.
"""


def _quintic(plan: Plan) -> float:
    """Return a bound on how far a quintic with the samples' accelerations is from the plan's cubic [rad].

    Both have the same values and slopes at the ends of a step h, so that they differ by h^2 (c0 s^2 (1-s)^3 +
    c1 s^3 (1-s)^2) / 2 with the differences c of their second derivatives there.
    """
    farthest = 0.0
    for segment in plan.segments:
        h = np.diff(segment.time)[:, None]
        q, v, a = segment.positions, segment.velocities, segment.accelerations
        slope = np.diff(q, axis=0) / h
        first = a[:-1] - (6.0 * slope - 4.0 * v[:-1] - 2.0 * v[1:]) / h
        last = a[1:] - (2.0 * v[:-1] + 4.0 * v[1:] - 6.0 * slope) / h
        farthest = max(farthest, float((0.5 * h**2 * _PEAK * (np.abs(first) + np.abs(last))).max()))
    return farthest


_PEAK = 0.4**2 * 0.6**3
"""The most that s^2 (1-s)^3 is between 0 and 1."""
