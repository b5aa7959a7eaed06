"""Each lie told in an otherwise honest suction-tool plan fails the checks that it touches, where it was told."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from planners.certify import CellReference, Certificate, RobotSurfaces
from planners.contract.shapes import InlineMesh
from planners.geometry.pose import Array, from_pose7, rotation_x, rotation_z, to_pose7, transform
from planners.plan.plan import Plan
from tests.geometry.mesh_shapes import angle
from tests.support.documents import certified
from tests.support.samples import among
from tests.support.tool_plans import QUARTER, Document, block, planned, reference_of_the_tool_cell

POST = {"name": "post", "shape": {"type": "box", "size": [0.05, 0.05, 0.05]}, "pose": [0.7, 0.7, 1.12, 1, 0, 0, 0]}


@pytest.fixture(scope="module")
def honest() -> Document:
    """A block is moved by the arm on its side."""
    return planned({"objects": [block()], "obstacles": [POST]})


@pytest.fixture(scope="module")
def known() -> CellReference:
    return reference_of_the_tool_cell()


@pytest.fixture
def document(honest: Document) -> Document:
    return copy.deepcopy(honest)


@dataclass(frozen=True)
class Lie:
    """What is changed, a check that must fail, and words that one of the failures must say."""

    tell: Callable[[Document], None]
    fails: str
    where: str


LIES: dict[str, Lie] = {}


def lie(fails: str, where: str) -> Callable[[Callable[[Document], None]], Callable[[Document], None]]:
    def register(tell: Callable[[Document], None]) -> Callable[[Document], None]:
        LIES[tell.__name__] = Lie(tell, fails, where)
        return tell

    return register


def first(document: Document, kind: str, after: str | None = None) -> Document:
    """The first segment of a kind; with `after`, the first that follows one of that kind."""
    segments = document["segments"]
    begin = 0 if after is None else 1 + next(i for i, s in enumerate(segments) if s["kind"] == after)
    return next(s for s in segments[begin:] if s["kind"] == kind)


def contacts(segment: Document, kind: str, body: str) -> list[dict[str, Any]]:
    """The contacts of a kind on a body, at a sample in the middle if there is one."""
    samples = sorted({c["sample"] for c in segment["contacts"] if c["body"] == body})
    sample = samples[len(samples) // 2]
    return [c for c in segment["contacts"] if (c["kind"], c["body"], c["sample"]) == (kind, body, sample)]


def sway_between_sets(document: Document, way: Array) -> None:
    """Move tool and block aside and back, smoothly, between the two of the block's sets with most samples between."""
    segment = first(document, "transfer", after="attach")
    samples = sorted({c["sample"] for c in segment["contacts"] if c["body"] == "block"})
    before, after = max(pairwise(samples), key=lambda pair: pair[1] - pair[0])
    assert after - before >= 4
    for sample in range(before + 1, after):
        part = np.sin(np.pi * (sample - before) / (after - before)) ** 2
        for rows in segment["body_poses"].values():
            rows[sample][:3] = (np.array(rows[sample][:3]) + part * way).tolist()


@lie("hands", "held by")
def a_hold_is_left_out(document: Document) -> None:
    first(document, "transfer")["hold"] = None


@lie("hands", "the tool is not in both hands")
def one_hand_hands_over(document: Document) -> None:
    first(document, "transfer")["kind"] = "handover"


@lie("hands", "holds the tool: it is no free hand")
def a_transfer_is_called_a_transit(document: Document) -> None:
    first(document, "transfer")["kind"] = "transit"


@lie("kinds", "moves")
def a_carrying_motion_is_called_an_approach(document: Document) -> None:
    first(document, "transfer", after="attach")["kind"] = "approach"


@lie("attachment_rules", "block is held by tool and not attached")
def the_object_floats(document: Document) -> None:
    del first(document, "transfer", after="attach")["attached"]["block"]


@lie("attachment_rules", "which does not hold it")
def an_object_is_attached_to_a_hand(document: Document) -> None:
    segment = first(document, "transfer", after="attach")
    arm = segment["hold"]["grip"]["arm"]
    segment["attached"]["block"].append({"to": arm, "pose": segment["attached"]["tool"][0]["pose"]})


@lie("kinds", "fingers and vacuum have 1 ms, and need 200")
def the_vacuum_holds_after_a_millisecond(document: Document) -> None:
    segments = document["segments"]
    attach = segments.index(first(document, "attach"))
    begin, end = segments[attach]["time"][0], segments[attach]["time"][-1]
    segments[attach]["time"] = [begin + 1e-3 * (t - begin) / (end - begin) for t in segments[attach]["time"]]
    for segment in segments[attach + 1 :]:
        segment["time"] = [t - (end - begin) + 1e-3 for t in segment["time"]]


@lie("attachment_rules", "while fingers open or close")
def the_tool_is_attached_while_fingers_close(document: Document) -> None:
    first(document, "grip")["attached"] = {"tool": first(document, "transfer")["attached"]["tool"]}


@lie("attachments", "block on tool")
def the_object_drifts_on_the_cup(document: Document) -> None:
    first(document, "transfer", after="attach")["attached"]["block"][0]["pose"][0] += 0.0003


@lie("attachment_angles", "tool on")
def the_tool_turns_in_the_hand(document: Document) -> None:
    entry = first(document, "transfer")["attached"]["tool"][0]
    entry["pose"] = to_pose7(from_pose7(entry["pose"]) @ transform(rotation_x(np.radians(0.06))))


@lie("resting_bodies", "block moves, held by nothing")
def a_resting_object_moves_by_itself(document: Document) -> None:
    segment, rest = first(document, "transit"), document["bodies"]["block"]["pose"]
    rows = [list(rest) for _ in segment["time"]]
    rows[3][0] += 1e-4
    segment["body_poses"]["block"] = rows


@lie("grips", "hand on tool")
def the_hold_is_elsewhere(document: Document) -> None:
    first(document, "transfer")["hold"]["grip"]["pose"][2] += 0.0005


def creep(rows: Iterator[list[float]]) -> None:
    """Have poses differ by less than they may from where things are, and from one another by more."""
    for row, side in zip(rows, (1.0, -1.0), strict=False):
        row[0] += side * 1.5e-4


@lie("grips", "not as before")
def the_tool_creeps_in_the_hand_from_segment_to_segment(document: Document) -> None:
    creep(s["hold"]["grip"]["pose"] for s in document["segments"] if s["hold"] is not None)


@lie("attachments", "block on tool, not as before")
def the_object_creeps_on_the_cup_from_segment_to_segment(document: Document) -> None:
    creep(s["attached"]["block"][0]["pose"] for s in document["segments"] if "block" in s["attached"])


@lie("grip_width", "the pads do not meet tool together")
def the_pads_are_off_the_tool(document: Document) -> None:
    for segment in document["segments"]:
        for grip in ((segment["hold"] or {}).get("grip"), (segment["hold"] or {}).get("second_grip")):
            if grip is not None:
                T = from_pose7(grip["pose"]) @ transform(None, [0.0, 0.002, 0.0])
                grip["pose"] = to_pose7(T)


def open_before_the_grip(document: Document, width: float) -> None:
    """Have the hand that takes the tool come with its fingers at a width, and close them from there."""
    segments = document["segments"]
    number = next(i for i, segment in enumerate(segments) if segment["kind"] == "grip")
    arm = segments[number]["hold"]["grip"]["arm"]
    opening = np.array([w for segment in segments[: number + 1] for w in segment["gripper_width"][arm]])
    most, coming, held = opening[0], segments[number]["gripper_width"][arm][0], opening[-1]
    changed = np.where(
        opening >= coming,
        most + (opening - most) * (most - width) / (most - coming),
        held + (opening - held) * (width - held) / (coming - held),
    )
    begin = 0
    for segment in segments[: number + 1]:
        end = begin + len(segment["time"])
        segment["gripper_width"][arm] = changed[begin:end].tolist()
        begin = end


@lie("grip_width", "hand is not open")
def the_hand_comes_with_its_fingers_closed(document: Document) -> None:
    open_before_the_grip(document, first(document, "grip")["hold"]["grip"]["width"] + 1e-6)


@lie("vacuum", "block is sucked, and was never attached")
def the_vacuum_never_goes_on(document: Document) -> None:
    first(document, "attach")["kind"] = "transit"


@lie("vacuum", "is still on the cup")
def the_vacuum_never_goes_off(document: Document) -> None:
    segments = document["segments"]
    document["segments"] = segments[: next(i for i, s in enumerate(segments) if s["kind"] == "detach")]


@lie("vacuum", "bears something without vacuum")
def the_cup_bears_before_it_sucks(document: Document) -> None:
    for contact in first(document, "attach")["contacts"]:
        if contact["kind"] == "suction" and contact["sample"] == 0:
            contact["wrench"][2] += 0.5 if contact["body"] == "block" else -0.5


@lie("vacuum", "not opposite")
def the_tool_does_not_feel_the_object(document: Document) -> None:
    contacts(first(document, "transfer", after="attach"), "suction", "tool")[0]["wrench"][2] += 0.1


@lie("vacuum", "the suction is not listed on both")
def the_object_is_left_out_of_the_tools_load(document: Document) -> None:
    segment = first(document, "transfer", after="attach")
    segment["contacts"] = [c for c in segment["contacts"] if (c["kind"], c["body"]) != ("suction", "tool")]


@lie("supports", "nothing bears it")
def an_object_is_let_go_of_in_the_air(document: Document) -> None:
    segment = first(document, "detach")
    segment["contacts"] = [c for c in segment["contacts"] if c["kind"] != "environment"]


@lie("contact_points", "by table: on table")
def the_table_bears_beside_itself(document: Document) -> None:
    for contact in contacts(first(document, "detach"), "environment", "block"):
        contact["point"][2] += 0.001


@lie("contact_normals", "the lip on block")
def the_cup_is_not_wholly_on_the_object(document: Document) -> None:
    # The object is said to be smaller than the pad, in the task as in the document.
    for shape in (document["bodies"]["block"]["shape"], document["task"]["objects"][0]["shape"]):
        shape["size"] = [0.03, 0.03, 0.02]


@lie("contact_normals", "x axis")
def the_pad_is_turned(document: Document) -> None:
    contact = contacts(first(document, "transfer", after="attach"), "suction", "block")[0]
    x, z = np.array(contact["x_axis"]), np.array(contact["normal"])
    angle = np.radians(1.0)
    contact["x_axis"] = (np.cos(angle) * x + np.sin(angle) * np.cross(z, x)).tolist()


@lie("contact_points", "at the pad")
def a_finger_presses_where_it_is_not(document: Document) -> None:
    contacts(first(document, "transfer"), "soft_finger", "tool")[0]["point"][2] += 0.002


@lie("contact_sets", "no contact set of tool at the last sample")
def a_set_is_missing_at_the_end(document: Document) -> None:
    segment = first(document, "transfer")
    last = len(segment["time"]) - 1
    segment["contacts"] = [c for c in segment["contacts"] if c["sample"] != last]


@lie("contact_sets", "block")
def sets_of_the_object_are_missing(document: Document) -> None:
    segment = first(document, "transfer", after="attach")
    last = len(segment["time"]) - 1
    segment["contacts"] = [c for c in segment["contacts"] if c["body"] != "block" or c["sample"] in (0, last)]


@lie("contact_sets", "transfer")
def the_object_goes_away_and_comes_back_between_two_sets(document: Document) -> None:
    sway_between_sets(document, np.array([0.0, 0.03, 0.0]))


@lie("inertia", "transfer")
def the_object_shakes_between_two_sets(document: Document) -> None:
    sway_between_sets(document, np.array([0.0, 0.002, 0.0]))


@lie("cup_hold", "block presses")
def the_object_is_jerked_between_two_sets(document: Document) -> None:
    sway_between_sets(document, np.array([0.0, 0.0, 0.15]))


@lie("inertia", "transfer")
def inertia_is_left_out(document: Document) -> None:
    for segment in document["segments"]:
        segment["contacts"] = [c for c in segment["contacts"] if c["kind"] != "inertia"]


@lie("balance_force", "block")
def a_force_is_smaller(document: Document) -> None:
    contacts(first(document, "transfer", after="attach"), "suction", "block")[0]["wrench"][2] -= 0.002


@lie("friction", "finger")
def fingers_are_past_their_cones(document: Document) -> None:
    for contact in contacts(first(document, "transfer", after="attach"), "soft_finger", "tool"):
        contact["wrench"][:3] = (np.array(contact["wrench"][:3]) - 50.0 * np.array(contact["normal"])).tolist()


@lie("normal_force", "finger")
def fingers_press_too_hard(document: Document) -> None:
    for contact in contacts(first(document, "transfer", after="attach"), "soft_finger", "tool"):
        contact["wrench"][:3] = (np.array(contact["wrench"][:3]) + 60.0 * np.array(contact["normal"])).tolist()


def grips(document: Document) -> Iterator[dict[str, Any]]:
    """Every grip of every hold."""
    for segment in document["segments"]:
        for name in ("grip", "second_grip"):
            if segment["hold"] is not None and segment["hold"][name] is not None:
                yield segment["hold"][name]


def fingers(document: Document) -> Iterator[dict[str, Any]]:
    """Every contact of a finger."""
    for segment in document["segments"]:
        yield from (contact for contact in segment["contacts"] if contact["kind"] == "soft_finger")


def squeeze_with(document: Document, force: float) -> None:
    """Say everywhere that the grippers squeeze with a force, and have the contacts do so."""
    for contact in fingers(document):
        more = force - contact["squeeze"]
        contact["wrench"][:3] = (np.array(contact["wrench"][:3]) + more * np.array(contact["normal"])).tolist()
        contact["squeeze"] = force
    for grip in grips(document):
        grip["squeeze"] = force


@lie("squeeze", "no squeeze is stated")
def no_squeeze_is_commanded(document: Document) -> None:
    for grip in grips(document):
        del grip["squeeze"]


@lie("squeeze", "hand")
def the_gripper_squeezes_less_than_it_can(document: Document) -> None:
    squeeze_with(document, 19.9)


@lie("squeeze", "hand")
def the_gripper_squeezes_more_than_it_can(document: Document) -> None:
    squeeze_with(document, 235.1)


@lie("normal_force", "finger")
def the_gripper_squeezes_more_than_its_task_allows(document: Document) -> None:
    squeeze_with(document, 61.0)


@lie("squeeze", "not as before")
def the_squeeze_changes_during_a_hold(document: Document) -> None:
    later = first(document, "transfer", after="attach")
    for contact in later["contacts"]:
        if contact["kind"] == "soft_finger":
            contact["wrench"][:3] = (np.array(contact["wrench"][:3]) + np.array(contact["normal"])).tolist()
            contact["squeeze"] += 1.0
    later["hold"]["grip"]["squeeze"] += 1.0


@lie("squeeze", "both fingers together")
def fingers_press_more_than_they_squeeze(document: Document) -> None:
    for contact in contacts(first(document, "transfer", after="attach"), "soft_finger", "tool"):
        contact["wrench"][:3] = (np.array(contact["wrench"][:3]) + 0.001 * np.array(contact["normal"])).tolist()


@lie("squeeze", "finger 0: squeeze")
def a_finger_squeezes_otherwise_than_its_hand(document: Document) -> None:
    for contact in contacts(first(document, "transfer", after="attach"), "soft_finger", "tool"):
        contact["squeeze"] += 0.001


@lie("squeeze", "both fingers together")
def a_hand_squeezes_with_one_finger(document: Document) -> None:
    segment = first(document, "transfer", after="attach")
    away = contacts(segment, "soft_finger", "tool")[0]
    segment["contacts"].remove(away)


@lie("contact_parameters", "finger 1 (soft_finger): limit")
def a_finger_may_press_more_than_the_squeeze_and_half_of_the_load(document: Document) -> None:
    contacts(first(document, "transfer", after="attach"), "soft_finger", "tool")[1]["limit"] += 1.0


@lie("cell", "/cell/hands/right/force_range")
def a_gripper_squeezes_harder_than_it_can(document: Document) -> None:
    document["cell"]["hands"]["right"]["force_range"][1] = 500.0


def overstate(document: Document, by: float) -> None:
    """Say that so much more is left of all limits, all along."""
    for segment in document["segments"]:
        segment["reserve"] = [None if left is None else left + by for left in segment["reserve"]]
    document["statistics"]["reserve"]["value"] += by


@lie("reserve", "is stated")
def more_is_said_to_be_left_all_along(document: Document) -> None:
    overstate(document, 1e-5)


@lie("reserve", "the smallest reserve")
def more_is_said_to_be_left_at_least(document: Document) -> None:
    document["statistics"]["reserve"]["value"] += 1e-3


@lie("reserve", "the smallest reserve is not at sample")
def least_is_said_to_be_left_elsewhere(document: Document) -> None:
    document["statistics"]["reserve"]["segment"] = 0


@lie("reserve", "is stated")
def more_is_said_to_be_left_at_one_sample(document: Document) -> None:
    segment = first(document, "transfer", after="attach")
    segment["reserve"][segment["contacts"][0]["sample"]] += 1e-3


@lie("reserve", "cup: friction")
def less_of_the_cups_friction_is_left_than_is_said(document: Document) -> None:
    """The cup is said to be more slippery, everywhere, so that only the reserve is not what it was."""
    for segment in document["segments"]:
        for contact in segment["contacts"]:
            if contact["kind"] == "suction":
                contact["mu"] *= 0.1


@lie("reserve", "payload")
def less_of_the_payload_is_left_than_is_said(document: Document) -> None:
    document["task"]["carry_force_limit"] = (0.25 + 0.1) * 9.81 * 1.05


@lie("contact_parameters", "limit")
def the_cup_is_stronger_than_it_is(document: Document) -> None:
    for segment in document["segments"]:
        for contact in segment["contacts"]:
            if contact["kind"] == "suction":
                contact["limit"] = 40.0


@lie("suction", "shear")
def the_cup_slips(document: Document) -> None:
    for segment in document["segments"]:
        for contact in segment["contacts"]:
            if contact["kind"] == "suction":
                contact["mu"] = 1e-4


@lie("cup_force", "presses")
def the_cup_pushes(document: Document) -> None:
    for contact in contacts(first(document, "transfer", after="attach"), "suction", "block"):
        contact["wrench"][:3] = (-np.array(contact["wrench"][:3])).tolist()
        contact["suction_force"] *= -1.0


@lie("goals", "the end: block")
def the_goal_is_missed(document: Document) -> None:
    document["task"]["objects"][0]["goal_pose"][0] += 0.0012


@lie("goal_angles", "the end: block")
def the_goal_is_turned(document: Document) -> None:
    goal = document["task"]["objects"][0]
    goal["goal_pose"] = to_pose7(from_pose7(goal["goal_pose"]) @ transform(rotation_z(np.radians(0.6))))


@lie("goal_angles", "the end: block")
def the_block_ends_the_other_way_round(document: Document) -> None:
    goal = document["task"]["objects"][0]
    goal["goal_pose"] = to_pose7(from_pose7(goal["goal_pose"]) @ transform(rotation_z(np.pi)))


@lie("task_bodies", "body tool: mass")
def the_tool_is_lighter(document: Document) -> None:
    document["bodies"]["tool"]["mass"] = 0.2


@lie("task_bodies", "body tool: shape")
def the_tool_is_thinner(document: Document) -> None:
    shape = document["bodies"]["tool"]["shape"]
    shape["vertices"] = (0.97 * np.array(shape["vertices"])).tolist()


@lie("cell", "/bodies/shelf")
def a_shelf_is_made_up(document: Document) -> None:
    """It could carry what is let go of in the air."""
    shelf = {"shape": {"type": "box", "size": [0.1, 0.1, 0.01]}, "pose": [0.7, -0.7, 1.2, 1.0, 0.0, 0.0, 0.0]}
    document["bodies"]["shelf"] = document["bodies"]["table"] | shelf


@lie("task_bodies", "body post: shape")
def an_obstacle_keeps_its_corners_and_loses_most_of_itself(document: Document) -> None:
    half = np.array(document["bodies"]["post"]["shape"]["size"]) / 2
    corners = half * [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    shape = InlineMesh.of(corners, np.array([[0, 1, 2], [0, 2, 4], [0, 4, 1], [1, 4, 2]]), [corners[[0, 1, 2, 4]]])
    document["bodies"]["post"]["shape"] = shape.model_dump(mode="json")


@lie("task_bodies", "convex parts")
def a_part_of_the_tool_cannot_be_hit(document: Document) -> None:
    document["bodies"]["tool"]["shape"]["convex_parts"].pop()


@lie("task_bodies", "body block: pose")
def the_object_starts_elsewhere(document: Document) -> None:
    document["task"]["objects"][0]["pose"][0] += 0.002


@lie("collision", "post")
def an_obstacle_stands_in_the_way(document: Document) -> None:
    pose = list(first(document, "transfer", after="attach")["body_poses"]["tool"][-1][:3])
    for body in (document["bodies"]["post"], document["task"]["obstacles"][0]):
        body["pose"] = [*pose, 1.0, 0.0, 0.0, 0.0]


@lie("touch_depth", "block")
def the_object_sinks_into_the_table(document: Document) -> None:
    segment = first(document, "detach")
    before = document["segments"][document["segments"].index(segment) - 1]
    rest = from_pose7(before["attached"]["block"][0]["pose"]) @ transform(None, [0.0, 0.0, -0.0015])
    before["attached"]["block"][0]["pose"] = to_pose7(rest)


@lie("joins", "pose of block")
def the_object_jumps_between_segments(document: Document) -> None:
    first(document, "transfer", after="attach")["body_poses"]["block"][0][0] += 1e-6


@lie("hand_force", "by left")
def a_hand_carries_more_than_its_task_lets_it(document: Document) -> None:
    document["task"]["carry_force_limit"] = (0.25 + 0.1) * 9.81 * 0.999


@lie("hand_force", "by left")
def a_hand_carries_more_than_the_payload_leaves(document: Document) -> None:
    document["cell"]["arms"]["left"]["payload"] = 1.205 + (0.25 + 0.1) * 0.999


@lie("payload", "by left")
def an_arm_carries_more_than_its_payload(document: Document) -> None:
    document["cell"]["arms"]["left"]["payload"] = 1.205 + (0.25 + 0.1) * 0.999


@lie("carried_force", "by left")
def a_hand_jerks_between_two_contact_sets(document: Document) -> None:
    segment = first(document, "transfer", after="attach")
    shown = sorted({contact["sample"] for contact in segment["contacts"]})
    before, after = next((a, b) for a, b in pairwise(shown) if b - a >= 5)
    for poses in segment["body_poses"].values():
        poses[(before + after) // 2][2] += 0.01
    document["task"]["carry_force_limit"] = 8.0


@lie("cell", "/cell/arms/left/payload")
def an_arm_is_stronger_than_it_is(document: Document) -> None:
    document["cell"]["arms"]["left"]["payload"] = 30.0


@lie("cell", "/cell/hands/right/mass")
def a_hand_is_lighter_than_it_is(document: Document) -> None:
    document["cell"]["hands"]["right"]["mass"] = 0.1


def failures(certificate: Certificate) -> dict[str, str]:
    return {check.name: check.where for check in certificate.failures}


def test_an_honest_plan_passes(honest: Document, surfaces: RobotSurfaces, known: CellReference) -> None:
    Plan.model_validate(honest)
    assert failures(certified(honest, surfaces, known)) == {}


def test_an_honest_plan_passes_in_which_the_tool_is_handed_over(surfaces: RobotSurfaces, known: CellReference) -> None:
    across = {"pose": [0.3, 0.42, 1.104, *QUARTER], "goal_pose": [0.3, -0.4, 1.104, *QUARTER]}
    document = planned({"objects": [block(**across)]})
    Plan.model_validate(document)
    assert "handover" in [segment["kind"] for segment in document["segments"]]
    assert failures(certified(document, surfaces, known)) == {}
    closed = copy.deepcopy(document)
    keep_closed_on_release(closed)
    assert "hand is not open" in failures(certified(closed, surfaces, known))["grip_width"]
    first(document, "handover")["kind"] = "transfer"
    assert "the tool moves, and not in one hand" in failures(certified(document, surfaces, known))["hands"]


def keep_closed_on_release(document: Document) -> None:
    """Have the hand that gives the tool away open by a micrometre only, and leave so."""
    release = first(document, "release")
    arm, number = release["hold"]["grip"]["arm"], document["segments"].index(release)
    held = release["gripper_width"][arm][0]
    release["gripper_width"][arm] = np.linspace(held, held + 1e-6, len(release["time"])).tolist()
    for segment in document["segments"][number + 1 :]:
        segment["gripper_width"][arm] = [held + 1e-6] * len(segment["time"])


def test_the_reserve_of_an_honest_plan_is_found_again_at_every_sample_that_is_shown(
    honest: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    shown = [s["reserve"][c["sample"]] for s in honest["segments"] for c in s["contacts"]]
    check = next(c for c in certified(honest, surfaces, known).checks if c.name == "reserve")
    assert (check.passed, check.unit) == (True, "1")
    assert check.margin == pytest.approx(min(shown), abs=1e-6)
    limited_by = honest["statistics"]["reserve"]["limited_by"]
    assert limited_by.split()[-2] in check.where


def one_of_each_check() -> list[str]:
    """Return the name of a lie for each check that one is told to."""
    return list({lie.fails: name for name, lie in LIES.items()}.values())


@pytest.mark.parametrize("name", among(LIES, one_of_each_check()))
def test_a_lie_fails_the_checks_it_touches(
    name: str, document: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    LIES[name].tell(document)
    found = failures(certified(document, surfaces, known))
    assert LIES[name].fails in found
    assert LIES[name].where in found[LIES[name].fails], found


@pytest.mark.parametrize(
    ("mass", "needed", "available", "unit", "passes"),
    [
        (3.0, 3.0 * 9.81, 20.0, "N", True),
        (3.0, 3.0 * 9.81, 19.0, "N", False),
        (0.1, 0.1 * 9.81, 20.0, "N", False),
        (0.1, 0.2, 0.085, "m", False),
        (1.6, (1.6 + 0.25) * 9.81, (3.0 - 1.205) * 9.81, "N", True),
        (1.6, (1.6 + 0.25) * 9.81, 2.0 * (3.0 - 1.205) * 9.81, "N", False),
        (1.6, 1.6 * 9.81, (3.0 - 1.205) * 9.81 * 0.8, "N", False),
        (1.5, (1.5 + 0.25) * 9.81, (3.0 - 1.205) * 9.81, "N", False),
    ],
)
def test_a_task_is_infeasible_only_with_a_proof(
    mass: float, needed: float, available: float, unit: str, passes: bool, document: Document,
    surfaces: RobotSurfaces, known: CellReference,
) -> None:  # fmt: skip
    document["task"]["objects"][0]["mass"] = document["bodies"]["block"]["mass"] = mass
    cause = {"reason": "too heavy", "needed": needed, "available": available, "unit": unit, "where": "block"}
    document |= {"outcome": "infeasible", "segments": [], "explanation": {"summary": "no", "causes": [cause]}}
    assert certified(document, surfaces, known).passed == passes


SHOULDER = np.array([0.0, 0.258485, 1.610515]) + 0.15185 * np.array([0.0, 1.0, -1.0]) / np.sqrt(2.0)
"""Of the left arm: where its first two axes meet; the right one's is its mirror image."""


@pytest.mark.parametrize("what", ["goal", "start", "tool"])
@pytest.mark.parametrize(
    ("x", "needed", "available", "passes"),
    [
        (2.0, 1.0, 1.33, True),
        (2.0, 1.0, 1.6, True),
        (2.0, 1.0, 0.9, False),
        (2.0, 1.01, 1.33, False),
        (2.0, 0.99, 1.33, False),
        (2.0, 1.0, 2.1, False),
        (1.0, 1.0, 0.5, False),
    ],
)
def test_a_task_is_out_of_reach_only_with_a_proof(
    what: str, x: float, needed: float, available: float, passes: bool, document: Document,
    surfaces: RobotSurfaces, known: CellReference,
) -> None:  # fmt: skip
    """At 2 m no arm reaches; at 1 m the bound proves nothing. `needed` is a share of the distance from the shoulder."""
    place = [x, 0.258485, 1.104]
    block, tool = document["task"]["objects"][0], document["bodies"]["tool"]
    if what == "goal":
        block["goal_pose"] = [*place, *QUARTER]
    elif what == "start":
        block["pose"] = document["bodies"]["block"]["pose"] = [*place, *QUARTER]
    else:
        document["task"]["tool_pose"] = tool["pose"] = [*place, 1.0, 0.0, 0.0, 0.0]
    far = float(np.linalg.norm(place - SHOULDER))
    cause = {"reason": "far", "needed": needed * far, "available": available, "unit": "m", "where": "block"}
    document |= {"outcome": "infeasible", "segments": [], "explanation": {"summary": "no", "causes": [cause]}}
    certificate = certified(document, surfaces, known)
    assert certificate.passed == passes, certificate.failures
    # Figures that say of what there is enough are no cause at all.
    wrong = "structure" if available > needed * far else "infeasibility"
    assert passes or [check.name for check in certificate.failures] == [wrong]
    assert wrong == "infeasibility" or certificate.failures[0].where.startswith("/explanation/causes/0: a cause has")


def test_things_stand_on_a_table_with_a_raised_rim_too(document: Document, surfaces: RobotSurfaces) -> None:
    """Its highest point is above their feet; what carries them is below."""
    depth, width, height = document["bodies"]["table"]["shape"]["size"]
    rim, above = 0.02, 0.05
    outline = [(0, 0), (width, 0), (width, height), (rim, height), (rim, height + above), (0, height + above)]
    half = np.array([depth, width, height]) / 2
    boxes = [[(u, v) for u in (0, far) for v in (0, top)] for far, top in ((width, height), (rim, height + above))]
    surface, *parts = (
        np.array([[w, *each] for w in (0.0, depth) for each in profile]) - half for profile in (outline, *boxes)
    )
    shape = InlineMesh.of(surface, np.asarray(angle().faces), parts)
    document["bodies"]["table"]["shape"] = shape.model_dump(mode="json")
    certificate = certified(document, surfaces)
    assert [check.name for check in certificate.failures] == []
