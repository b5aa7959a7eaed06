"""Each lie told in an otherwise honest plan fails exactly the checks that it touches, where it was told."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import trimesh

from planners.certify import CellReference, Certificate, RobotSurfaces
from planners.certify.motion.kinematics import ArmKinematics
from planners.geometry.pose import from_pose7, inverse, rotation_x, rotation_z, to_pose7, transform
from tests.support.documents import certified
from tests.support.samples import among

Document = dict[str, Any]
TRANSIT, REACH, GRIP, PUSH, TILT, LIFT = range(6)


@dataclass(frozen=True)
class Lie:
    """What is changed, the checks that must fail, and words that one of them must name."""

    tell: Callable[[Document], None]
    fails: frozenset[str]
    where: str


LIES: dict[str, Lie] = {}


def lie(fails: str, where: str) -> Callable[[Callable[[Document], None]], Callable[[Document], None]]:
    def register(tell: Callable[[Document], None]) -> Callable[[Document], None]:
        LIES[tell.__name__] = Lie(tell, frozenset(fails.split()), where)
        return tell

    return register


def contacts_of(document: Document, segment: int, kind: str, sample: int | None = None) -> list[dict[str, Any]]:
    """The contacts of a kind at one sample; the second set of the segment unless said otherwise."""
    contacts = document["segments"][segment]["contacts"]
    if sample is None:
        sample = sorted({c["sample"] for c in contacts})[1]
    return [c for c in contacts if c["kind"] == kind and c["sample"] == sample]


def all_contacts(document: Document, kind: str) -> list[dict[str, Any]]:
    return [c for segment in document["segments"] for c in segment["contacts"] if c["kind"] == kind]


def squeeze(document: Document, segment: int, change: Callable[[float, float], float]) -> None:
    """Change both fingers' normal force by the same amount: the balance does not notice.

    `change` maps (normal force, shear of the finger that slides first) to the new normal force of that finger.
    """
    fingers = contacts_of(document, segment, "soft_finger")
    slides = []
    for finger in fingers:
        wrench, normal = np.array(finger["wrench"]), np.array(finger["normal"])
        pressed = float(wrench[:3] @ normal)
        shear = np.linalg.norm(wrench[:3] - pressed * normal)
        slides.append((pressed, float(np.hypot(shear, wrench[3:] @ normal / finger["eps"]))))
    worst = int(np.argmin([pressed - shear / 0.5 for pressed, shear in slides]))
    more = change(*slides[worst]) - slides[worst][0]
    for finger in fingers:
        wrench = np.array(finger["wrench"])
        wrench[:3] += more * np.array(finger["normal"])
        finger["wrench"] = wrench.tolist()


def widest_gap(document: Document) -> tuple[int, int]:
    """The two balances of the lift that are farthest apart in samples."""
    samples = sorted({c["sample"] for c in document["segments"][LIFT]["contacts"]})
    before, after = max(pairwise(samples), key=lambda pair: pair[1] - pair[0])
    assert after - before >= 8
    return before, after


def move_plate_aside(document: Document, sample: int, way: float) -> None:
    """Move the plate and what is on it by so much during the lift [m]."""
    for name in ("plate", "cup", "cable"):
        document["segments"][LIFT]["body_poses"][name][sample][1] += way


def keep_samples(segment: Document, first: int, end: int) -> None:
    """Leave only the samples of a segment from one to before another; its contacts stay as they are."""
    for name in ("time", "positions", "velocities", "accelerations"):
        segment[name] = segment[name][first:end]
    for rows in (segment["gripper_width"], segment["body_poses"]):
        rows.update({name: values[first:end] for name, values in rows.items()})


def tremble(document: Document, segment: int, joint: int) -> float:
    """Let a resting joint swing between samples only: at every sample it is where it was, with velocities that agree.

    Returns the greatest swing [rad]. The document's limits of acceleration and torque are raised to hide it.
    """
    rows = document["segments"][segment]["velocities"]
    n = len(rows)
    speed = np.minimum(np.arange(n), np.arange(n)[::-1]) * 0.038
    hardest = 2 * float(speed.max()) / 0.02
    for k, (row, accelerations) in enumerate(zip(rows, document["segments"][segment]["accelerations"], strict=True)):
        row[joint] = float(speed[k]) * (-1.0) ** k
        accelerations[joint] = hardest * (-1.0) ** (k + 1)
    for arm in document["cell"]["arms"].values():
        arm["acceleration_max"], arm["torque_max"] = [1e5] * 6, [1e5] * 6
    document["segments"][segment]["movers"] = ["left", "right"]
    return float(speed.max()) * 0.02 / 4


@lie("velocity_consistency joint_accelerations", "segment 0 (transit), sample 10")
def a_joint_is_moved_at_one_sample(document: Document) -> None:
    document["segments"][TRANSIT]["positions"][10][9] += 0.001


@lie("acceleration_consistency", "_joint")
def no_acceleration_is_stated(document: Document) -> None:
    for segment in document["segments"]:
        segment["accelerations"] = [[0.0] * 12 for _ in segment["time"]]


@lie("acceleration_consistency", "segment 5 (transfer)")
def one_slow_segment_states_no_acceleration(document: Document) -> None:
    document["segments"][LIFT]["accelerations"] = [[0.0] * 12 for _ in document["segments"][LIFT]["time"]]


@lie("kinds", "segment 4 (transit): plate moves")
def a_transfer_is_called_a_transit(document: Document) -> None:
    document["segments"][TILT]["kind"] = "transit"


@lie("kinds rest", "segment 5 (handover): has no place in a plate lift")
def a_transfer_is_called_a_handover(document: Document) -> None:
    document["segments"][LIFT]["kind"] = "handover"


@lie("kinds collision", "segment 2 (release): no fingers move as the kind says")
def the_fingers_close_in_a_release(document: Document) -> None:
    document["segments"][GRIP]["kind"] = "release"
    document["segments"][GRIP]["hold"] = None


@lie("rest", "segment 0 (transit), sample 0 (t = 0.000 s): right_")
def the_plan_starts_in_motion(document: Document) -> None:
    transit, half = document["segments"][TRANSIT], len(document["segments"][TRANSIT]["time"]) // 2
    keep_samples(transit, half, len(transit["time"]))
    document["task"]["start_positions"], begin = transit["positions"][0], transit["time"][0]
    for segment in document["segments"]:
        segment["time"] = [time - begin for time in segment["time"]]


@lie("rest", "segment 0 (transit), sample 1 (t = 0.020 s): left_")
def an_arm_that_is_no_mover_swings_between_samples(document: Document) -> None:
    inner = len(document["segments"][TRANSIT]["time"]) - 1
    for k, row in enumerate(document["segments"][TRANSIT]["velocities"][1:inner], start=1):
        row[0] = 1e-3 * (-1.0) ** k
    for k, row in enumerate(document["segments"][TRANSIT]["accelerations"]):
        row[0] = 0.1 * (-1.0) ** k


@lie("inertia", "2 samples do not tell the inertia of plate")
def a_lift_is_cut_where_its_inertia_is_not_to_be_seen(document: Document) -> None:
    lift = document["segments"].pop()
    samples = len(lift["time"])
    for first, last in ((0, 2), (2, 3), (3, samples - 1)):
        part = copy.deepcopy(lift)
        keep_samples(part, first, last + 1)
        # The plate has hardly moved: the same contacts bear it.
        shown = [each for each in lift["contacts"] if each["sample"] == 0]
        later = [each for each in lift["contacts"] if each["sample"] > first] if first == 3 else []
        part["contacts"] = [
            *({**each, "sample": 0} for each in shown),
            *({**each, "sample": each["sample"] - first} for each in later),
            *({**each, "sample": last - first} for each in shown if first < 3),
        ]
        document["segments"].append(part)


@lie("task_bodies", "body post: convex parts")
def a_mesh_is_larger_than_what_stands_for_it(document: Document) -> None:
    document["task"]["obstacles"][0]["shape"] = {"type": "mesh", "asset": "rack", "upload": None, "scale": 1.0}
    block, part = (trimesh.creation.box([size] * 3) for size in (0.5, 0.02))
    document["bodies"]["post"]["shape"] = {
        "type": "mesh",
        "vertices": block.vertices.tolist(),
        "faces": block.faces.tolist(),
        "convex_parts": [part.vertices.tolist()],
    }


@lie("movers", "segment 0 (transit): left is a mover and rests")
def an_arm_is_a_mover_and_rests(document: Document) -> None:
    document["segments"][TRANSIT]["movers"] = ["left", "right"]


@lie("movers", "segment 2 (grip): left and right is a mover and rests")
def arms_are_movers_while_the_fingers_close(document: Document) -> None:
    document["segments"][GRIP]["movers"] = ["left", "right"]


@lie("unstated_contacts", "touches, which is not stated")
def nothing_is_said_to_touch_while_the_plate_is_on_its_edge(document: Document) -> None:
    for segment in document["segments"][GRIP:]:
        segment["contact_state"] = {"element": "none", "index": None, "with": None, "vertices": []}


@lie("unstated_contacts", "segment 4 (transfer)")
def an_edge_is_called_a_vertex(document: Document) -> None:
    state = document["segments"][TILT]["contact_state"]
    document["segments"][TILT]["contact_state"] = state | {"element": "vertex", "vertices": state["vertices"][:1]}


@lie("unstated_contacts", "segment 3 (approach), sample 0")
def a_plate_at_rest_on_its_face_is_said_to_be_on_its_edge(document: Document) -> None:
    document["segments"][PUSH]["contact_state"] = document["segments"][TILT]["contact_state"]


@lie("joins", "segment 3 (approach), sample 0 (t = 3.010 s): time")
def time_jumps_between_two_segments(document: Document) -> None:
    for segment in document["segments"][PUSH:]:
        segment["time"] = [t + 0.01 for t in segment["time"]]


@lie("time", "segment 2 (grip), sample 4")
def one_step_is_too_long(document: Document) -> None:
    late = 0.005
    document["segments"][GRIP]["time"][5:] = [t + late for t in document["segments"][GRIP]["time"][5:]]
    for segment in document["segments"][PUSH:]:
        segment["time"] = [t + late for t in segment["time"]]


@lie("time", "segment 0 (transit), sample 0")
def the_first_time_is_not_zero(document: Document) -> None:
    for segment in document["segments"]:
        segment["time"] = [t + 1.0 for t in segment["time"]]


@lie(
    "time joint_accelerations joint_velocities velocity_consistency acceleration_consistency",
    "segment 2 (grip), sample 4",
)
def time_stands_still(document: Document) -> None:
    document["segments"][GRIP]["time"][5] = document["segments"][GRIP]["time"][4]


@lie(
    "joins velocity_consistency joint_accelerations joint_velocities joint_positions",
    "positions of right_wrist_3_joint",
)
def a_joint_winds_once_around_between_segments(document: Document) -> None:
    document["segments"][REACH]["positions"][0][11] += 2 * np.pi


@lie("joins", "segment 3 (approach), sample 0 (t = 3.000 s): opening of the right gripper")
def the_gripper_jumps_between_segments(document: Document) -> None:
    for row in range(len(document["segments"][GRIP]["time"])):
        document["segments"][GRIP]["gripper_width"]["right"][row] += 1e-6
    document["segments"][REACH]["gripper_width"]["right"][-1] += 1e-6


@lie("rest", "segment 5 (transfer), sample 70")
def the_plan_ends_in_motion(document: Document) -> None:
    document["segments"][LIFT]["velocities"][-1][3] = 0.002


@lie("rest", "segment 2 (grip), sample 7")
def an_arm_moves_while_the_fingers_close(document: Document) -> None:
    document["segments"][GRIP]["velocities"][7][8] = 0.002


@lie("movers rest", "right_")
def an_arm_moves_that_is_no_mover(document: Document) -> None:
    document["segments"][TRANSIT]["movers"] = []


@lie("start", "left_elbow_joint")
def the_plan_starts_elsewhere(document: Document) -> None:
    document["task"]["start_positions"][2] += 1e-6


@lie("joint_positions", "right_wrist_1_joint")
def a_joint_limit_is_narrower(document: Document) -> None:
    peak = max(row[9] for segment in document["segments"] for row in segment["positions"])
    document["cell"]["arms"]["right"]["position_max"][3] = peak - 0.01 * abs(peak)


@lie("joint_velocities", "segment 0 (transit)")
def a_joint_is_too_fast(document: Document) -> None:
    peak = max(abs(row[8]) for row in document["segments"][TRANSIT]["velocities"])
    document["cell"]["arms"]["right"]["velocity_max"][2] = 0.99 * peak


@lie("joint_accelerations", "segment 0 (transit)")
def a_joint_accelerates_too_hard(document: Document) -> None:
    peak = max(abs(row[8]) for row in document["segments"][TRANSIT]["accelerations"])
    document["cell"]["arms"]["right"]["acceleration_max"][2] = 0.99 * peak


@lie("attachments", "segment 4 (transfer)")
def an_attached_body_drifts(document: Document) -> None:
    document["segments"][TILT]["attached"]["plate"][0]["pose"][0] += 0.0003


@lie("attachment_angles", "segment 5 (transfer)")
def an_attached_body_is_turned(document: Document) -> None:
    entry = document["segments"][LIFT]["attached"]["plate"][0]
    entry["pose"] = to_pose7(from_pose7(entry["pose"]) @ transform(rotation_x(np.radians(0.06))))


@lie("attachment_rules", "segment 4 (transfer): plate is held by the right hand and not attached")
def a_held_body_is_not_attached(document: Document) -> None:
    document["segments"][TILT]["attached"] = {}


@lie("attachment_rules", "segment 2 (grip): plate is attached")
def a_body_is_attached_while_the_fingers_close(document: Document) -> None:
    document["segments"][GRIP]["attached"] = document["segments"][PUSH]["attached"]


@lie("attachment_rules", "attached to a stick")
def the_stick_attaches(document: Document) -> None:
    segment, arm = document["segments"][LIFT], document["cell"]["arms"]["left"]
    kinematics = ArmKinematics(np.array(arm["dh"]), from_pose7(arm["base"]))
    T_world_flange = kinematics.frames(np.array(segment["positions"])[:1, :6])[0, 6]
    T_flange_plate = inverse(T_world_flange) @ from_pose7(segment["body_poses"]["plate"][0])
    segment["attached"]["plate"].append({"to": "left", "pose": to_pose7(T_flange_plate)})


@lie("lifter", "segment 4 (transfer), sample 30 (t = 4.600 s): the cup leaves the plate")
def the_cup_slides(document: Document) -> None:
    document["segments"][TILT]["body_poses"]["cup"][30][1] += 0.0003


@lie("lifter", "the cable leans")
def the_cable_leans(document: Document) -> None:
    poses = document["segments"][TILT]["body_poses"]["cable"]
    foot = transform(None, [0.0, 0.0, -0.55])
    lean = foot @ transform(rotation_x(0.01)) @ inverse(foot)
    poses[30] = to_pose7(from_pose7(poses[30]) @ lean)


@lie("resting_bodies kinds", "segment 0 (transit), sample 9")
def a_resting_plate_moves_by_itself(document: Document) -> None:
    rest = document["bodies"]["plate"]["pose"]
    rows = [list(rest) for _ in document["segments"][TRANSIT]["time"]]
    rows[9][1] += 0.0001
    document["segments"][TRANSIT]["body_poses"]["plate"] = rows


@lie("resting_bodies", "post is static")
def a_static_body_has_poses(document: Document) -> None:
    rest = document["bodies"]["post"]["pose"]
    document["segments"][TRANSIT]["body_poses"]["post"] = [list(rest) for _ in document["segments"][TRANSIT]["time"]]


@lie("grips", "right hand on plate")
def the_hold_is_elsewhere(document: Document) -> None:
    document["segments"][TILT]["hold"]["grip"]["pose"][0] += 0.0003


@lie("grip_width", "width of the hold")
def the_hold_is_wider_than_the_plate(document: Document) -> None:
    document["segments"][TILT]["hold"]["grip"] = document["segments"][TILT]["hold"]["grip"] | {"width": 0.041}


@lie("pushes", "left tip on plate")
def the_push_slides(document: Document) -> None:
    hold = document["segments"][LIFT]["hold"]
    document["segments"][LIFT]["hold"] = hold | {"push": hold["push"] | {"point": [0.001, 0.15, 0.0]}}


@lie("contact_states contact_slip unstated_contacts", "contact vertex 0 of plate is off its support")
def the_wrong_edge_is_said_to_touch(document: Document) -> None:
    state = document["segments"][TILT]["contact_state"]
    state["vertices"] = [[-x, y, z] for x, y, z in state["vertices"]]


@lie("contact_states unstated_contacts", "is no corner of plate")
def an_edge_is_said_to_be_shorter(document: Document) -> None:
    state = document["segments"][TILT]["contact_state"]
    state["vertices"] = [[x, 0.9 * y, z] for x, y, z in state["vertices"]]


@lie("goal_height", "segment 5 (transfer), sample 70")
def the_goal_is_not_reached(document: Document) -> None:
    document["task"]["options"]["goal_height"] = 0.0352


@lie("goal_hold contact_sets", "no contact set of plate at the last sample")
def the_last_balance_is_missing(document: Document) -> None:
    segment = document["segments"][LIFT]
    segment["contacts"] = [c for c in segment["contacts"] if c["sample"] != 70]


@lie("goal_hold collision", "plate is not pushed")
def the_plan_ends_without_a_push(document: Document) -> None:
    document["segments"][LIFT]["hold"]["push"] = None


@lie("contact_sets", "segment 4 (transfer)")
def a_balance_is_missing(document: Document) -> None:
    segment = document["segments"][TILT]
    dropped = sorted({c["sample"] for c in segment["contacts"]})[2]
    segment["contacts"] = [c for c in segment["contacts"] if c["sample"] != dropped]


@lie("contact_sets inertia attachments grips pushes", "segment 5 (transfer)")
def the_plate_goes_aside_and_comes_back_between_two_balances(document: Document) -> None:
    before, after = widest_gap(document)
    for sample in range(before + 1, after):
        move_plate_aside(document, sample, 0.006 * np.sin(np.pi * (sample - before) / (after - before)) ** 2)


@lie("inertia", "segment 5 (transfer)")
def the_plate_is_jolted_between_two_balances(document: Document) -> None:
    move_plate_aside(document, sum(widest_gap(document)) // 2, 1.5e-4)


@lie("contact_sets", "segment 3 (approach)")
def a_balance_is_missing_while_held_still(document: Document) -> None:
    segment = document["segments"][PUSH]
    dropped = sorted({c["sample"] for c in segment["contacts"]})[2]
    segment["contacts"] = [c for c in segment["contacts"] if c["sample"] != dropped]


@lie("balance_force", "segment 5 (transfer)")
def the_counted_inertia_is_left_out(document: Document) -> None:
    segment = document["segments"][LIFT]
    segment["contacts"] = [c for c in segment["contacts"] if c["kind"] != "inertia"]


@lie("inertia balance_force", "segment 4 (transfer)")
def inertia_is_invented(document: Document) -> None:
    contacts_of(document, TILT, "inertia")[0]["wrench"][0] += 1.2


@lie("angular_inertia balance_moment", "segment 4 (transfer)")
def an_angular_inertia_is_invented(document: Document) -> None:
    contacts_of(document, TILT, "inertia")[0]["wrench"][4] += 0.3


@lie("balance_force", "segment 4 (transfer)")
def a_force_is_smaller(document: Document) -> None:
    # At the centre of mass: inertia has no lever.
    contacts_of(document, TILT, "inertia")[0]["wrench"][2] += 0.002


@lie("balance_moment", "segment 4 (transfer)")
def a_torque_is_smaller(document: Document) -> None:
    contacts_of(document, TILT, "inertia")[0]["wrench"][5] += 0.0015


@lie("balance_moment balance_force task_bodies", "body plate: mass")
def the_plate_is_lighter_than_the_task_says(document: Document) -> None:
    document["bodies"]["plate"]["mass"] = 1.9
    for contact in all_contacts(document, "inertia"):
        contact["wrench"][3] = 0.01


@lie("friction reserve", "by right finger")
def a_finger_is_past_its_cone_by_one_percent(document: Document) -> None:
    squeeze(document, TILT, lambda pressed, shear: 0.99 * shear / 0.5)


@lie("normal_force reserve", "by right finger")
def a_finger_presses_too_hard(document: Document) -> None:
    squeeze(document, TILT, lambda pressed, shear: 17.5)


@lie("contact_torque balance_moment", "by left (point)")
def a_point_transmits_a_torque(document: Document) -> None:
    contacts_of(document, TILT, "point")[0]["wrench"][4] += 0.002


@lie("hand_force reserve", "plate by ")
def a_hand_bears_too_much(document: Document) -> None:
    document["task"]["hand_force_limit"]["net"] = 1.0


@lie("cup_force reserve", "by cup")
def the_cup_pulls_too_hard(document: Document) -> None:
    document["task"]["cup"]["max_force"] = 14.0
    for contact in all_contacts(document, "suction"):
        contact["limit"] = 14.0


@lie("suction", "suction_force")
def the_suction_force_is_not_the_pull(document: Document) -> None:
    contacts_of(document, TILT, "suction")[0]["suction_force"] -= 0.01


@lie("suction reserve", "shear")
def the_cup_slips(document: Document) -> None:
    document["task"]["cup"]["mu"] = 0.01
    for contact in all_contacts(document, "suction"):
        contact["mu"] = 0.01


@lie("suction_moment balance_moment reserve", "peel")
def the_cup_bears_a_moment(document: Document) -> None:
    contact = contacts_of(document, TILT, "suction")[0]
    contact["wrench"][3:] = (0.002 * np.array(contact["x_axis"])).tolist()


@lie("contact_parameters", "by left (point): mu")
def friction_is_better_than_the_task_says(document: Document) -> None:
    contacts_of(document, TILT, "point")[0]["mu"] = 0.6


@lie("contact_parameters", "limit")
def a_limit_is_higher_than_the_task_says(document: Document) -> None:
    contacts_of(document, TILT, "soft_finger")[0]["limit"] = 25.0


@lie("contact_normals", "by left")
def a_normal_is_turned(document: Document) -> None:
    contact = contacts_of(document, TILT, "point")[0]
    contact["normal"] = (rotation_z(np.radians(1.0)) @ contact["normal"]).tolist()


@lie("contact_normals", "x axis")
def the_pad_is_turned(document: Document) -> None:
    contact = contacts_of(document, TILT, "suction")[0]
    turn = rotation_z(np.radians(1.0))
    contact["x_axis"] = (turn @ contact["x_axis"]).tolist()
    normal = np.array(contact["normal"])
    x = np.array(contact["x_axis"]) - normal * (normal @ contact["x_axis"])
    contact["x_axis"] = (x / np.linalg.norm(x)).tolist()


@lie("contact_points balance_moment", "by right finger 0: at the pad")
def a_finger_is_not_where_its_pad_is(document: Document) -> None:
    contacts_of(document, TILT, "soft_finger")[0]["point"][0] += 0.002


@lie("contact_points", "height of support")
def the_support_presses_from_above_itself(document: Document) -> None:
    # Along the force, nearly: the moment stays.
    for contact in contacts_of(document, PUSH, "environment"):
        contact["point"][2] += 0.001


@lie("task_bodies", "body plate: com")
def the_centre_of_mass_is_elsewhere(document: Document) -> None:
    document["task"]["plate"]["com"] = [0.01, 0.0, 0.0]


@lie("task_bodies", "body fence: is in the task")
def an_obstacle_is_left_out(document: Document) -> None:
    fence = {"name": "fence", "shape": {"type": "box", "size": [0.1, 0.1, 0.1]}, "pose": [0.8, 0.5, 1.2, 1, 0, 0, 0]}
    document["task"]["obstacles"].append(fence)


@lie("gripper", "tcp table")
def the_pads_are_said_to_be_elsewhere(document: Document) -> None:
    # Row 0 is the closed gripper, which the plan never uses.
    document["cell"]["hands"]["right"]["tcp"][0][1] += 0.001


@lie("collision", "plate and post")
def an_obstacle_stands_in_the_plate(document: Document) -> None:
    move_post(document, [0.1, 0.0, 1.3])


@lie("contact_states contact_points contact_normals contact_sets task_bodies touch_depth", "plate and support")
def the_plate_sinks_into_its_support(document: Document) -> None:
    document["bodies"]["support"]["pose"][2] += 0.0015


@lie("touch_depth", "segment 3 (approach)")
def the_plate_dips_into_its_support_between_samples(document: Document) -> None:
    # The shoulder lifts and lowers the held plate by about 4 mm, at no sample.
    assert tremble(document, PUSH, 7) > 0.004


@lie("collision", "and post")
def an_arm_hits_an_obstacle_between_two_samples(document: Document) -> None:
    swing = tremble(document, TRANSIT, 0)
    arm = document["cell"]["arms"]["left"]
    T_base = from_pose7(arm["base"])
    frames = ArmKinematics(np.array(arm["dh"]), T_base).frames(
        np.array(document["segments"][TRANSIT]["positions"])[:1, :6]
    )[0]
    tip = frames[6, :3, :3] @ [0.0, 0.0, 0.2944] + frames[6, :3, 3]
    way = np.cross(T_base[:3, 2], tip - T_base[:3, 3])
    assert swing * np.linalg.norm(way) > 0.0015
    # A plate square to the tip's motion, 1 mm off: the cylinder's flat end.
    way /= np.linalg.norm(way)
    x = np.cross(way, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R = np.column_stack([x, np.cross(way, x), way])
    move_post(document, tip + way * (0.010 + 0.001 + 0.005), R, {"type": "cylinder", "radius": 0.01, "height": 0.01})


def move_post(document: Document, position: Any, R: Any = None, shape: dict[str, Any] | None = None) -> None:
    """Move the obstacle in the task and in the document."""
    pose = to_pose7(transform(R, position))
    shape = shape or {"type": "box", "size": [0.05, 0.05, 0.05]}
    document["task"]["obstacles"][0] |= {"pose": pose, "shape": shape}
    document["bodies"]["post"] |= {"pose": pose, "shape": shape}


def failures(certificate: Certificate) -> dict[str, str]:
    return {check.name: check.where for check in certificate.failures}


def test_an_honest_plan_passes(document: Document, surfaces: RobotSurfaces, reference: CellReference) -> None:
    certificate = certified(document, surfaces, reference)
    assert failures(certificate) == {}
    assert certificate.passed
    assert all(check.margin is None or check.margin >= 0 for check in certificate.checks)


def one_of_each_check() -> list[str]:
    """Return the name of a lie for each set of checks that one fails."""
    return list({lie.fails: name for name, lie in LIES.items()}.values())


@pytest.mark.parametrize("name", among(LIES, one_of_each_check()))
def test_a_lie_fails_exactly_the_checks_it_touches(name: str, document: Document, surfaces: RobotSurfaces) -> None:
    LIES[name].tell(document)
    certificate = certified(document, surfaces)
    assert set(failures(certificate)) == LIES[name].fails
    assert any(LIES[name].where in where for where in failures(certificate).values())
    assert all(check.margin is not None and check.margin < 0 for check in certificate.failures)


@pytest.mark.parametrize(("slide", "fails"), [(4e-4, set()), (6e-4, {"contact_slip"})])
def test_a_plate_that_slides_on_its_edge_fails(
    slide: float, fails: set[str], sliding_document: Callable[[float], Document], surfaces: RobotSurfaces
) -> None:
    found = failures(certified(sliding_document(slide), surfaces))
    assert set(found) == fails
    assert all("segment 4 (transfer), sample 70" in where for where in found.values())


def test_a_cell_that_is_not_the_one_it_names_fails(
    document: Document, surfaces: RobotSurfaces, reference: CellReference
) -> None:
    document["cell"]["arms"]["left"]["velocity_max"][1] = 4.0
    assert failures(certified(document, surfaces, reference)) == {"cell": "/cell/arms/left/velocity_max/1"}


def test_a_cell_body_that_is_left_out_fails(
    document: Document, surfaces: RobotSurfaces, reference: CellReference
) -> None:
    del document["bodies"]["platform_column"]
    assert failures(certified(document, surfaces, reference)) == {"cell": "/bodies/platform_column"}


def test_the_start_is_the_cells_home_when_the_task_names_none(
    document: Document, surfaces: RobotSurfaces, reference: CellReference
) -> None:
    document["task"]["start_positions"] = None
    assert set(failures(certified(document, surfaces, reference))) == {"start"}


@pytest.mark.parametrize(("millimetres", "fails"), [(0.9, set()), (-0.9, set()), (1.1, {"task_bodies"})])
def test_a_plate_that_was_given_a_millimetre_off_is_the_one_that_was_settled(
    millimetres: float, fails: set[str], document: Document, surfaces: RobotSurfaces, reference: CellReference
) -> None:
    document["task"]["plate_pose"][2] += 1e-3 * millimetres
    assert set(failures(certified(document, surfaces, reference))) == fails


@pytest.mark.parametrize(
    ("larger", "where"),
    [
        ({"cup_height": 0.05}, "cup: height"),
        ({"cable_radius": 0.02}, "radius"),
        ({"cable_length": 1.2}, "cable: height"),
    ],
)
def test_a_lifter_that_is_smaller_than_the_cells_fails(
    larger: dict[str, float], where: str, document: Document, surfaces: RobotSurfaces, reference: CellReference
) -> None:
    known = replace(reference, lifter=replace(reference.lifter, **larger))
    told = failures(certified(document, surfaces, known))
    assert set(told) == {"task_bodies"}
    assert where in told["task_bodies"]
