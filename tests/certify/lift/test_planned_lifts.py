"""A planned lift passes; each lie told in it about forces, squeeze, reserve, tolerances or torque is found out."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from planners import solve
from planners.balance.contacts import Cup, Friction, GripContacts, HandLimits, PushContact
from planners.certify import CellReference, RobotSurfaces
from planners.certify.lift.load_program import LoadProgram, stated_factors
from planners.certify.lift.task import LiftTask
from planners.contract.task_spec import read_task
from planners.geometry.pose import from_pose7
from planners.planning import CertificateFailed, plan
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from tests.manipulation.lift_probe import task_body
from tests.support.balance_statement import Plate, contact_frames, state_balance
from tests.support.documents import certified, evidence_of
from tests.support.samples import among

Document = dict[str, Any]


@pytest.fixture(scope="module")
def planned_lift() -> Document:
    """AB1 with nothing kept back, as it is stored."""
    task = read_task(task_body("ab1"))
    document = plan(task, build_scene(task), lambda *_: None, lambda: 0.0).document()
    assert document["outcome"] == "solved"
    document |= {"id": "planned", "software": {"name": "liftwright", "version": "0", "commit": None}}
    return json.loads(json.dumps(document))


@pytest.fixture
def document(planned_lift: Document) -> Document:
    return copy.deepcopy(planned_lift)


def failures(document: Document, surfaces: RobotSurfaces) -> dict[str, str]:
    certificate = certified(document, surfaces)
    assert certificate is not None
    return {check.name: check.where for check in certificate.failures}


def test_a_planned_lift_passes(planned_lift: Document, surfaces: RobotSurfaces, reference: CellReference) -> None:
    certificate = certified(planned_lift, surfaces, reference)
    assert certificate is not None
    assert {check.name: check.where for check in certificate.failures} == {}
    margins = {check.name: check.margin for check in certificate.checks}
    for name in ("payload", "squeeze", "reserve", "uncertainty", "joint torque"):
        assert margins[name] is not None, name


@pytest.mark.slow
def test_a_plan_that_knows_of_no_rim_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sheet lies on a board of its own outline: a little off, the board's edge bears its bottom face."""
    monkeypatch.setattr(PlateLiftScene, "at_the_rim", np.zeros((0, 2)))
    with pytest.raises(CertificateFailed) as refused:
        solve(read_task(task_body("sheet_ur10e", reserve=0.05, remedies=False, simulate=False)))
    certificate = refused.value.plan.certificate
    assert certificate is not None
    found = {check.name: check.where for check in certificate.failures}
    assert set(found) <= {"friction", "reserve", "uncertainty"}
    assert "by support (environment)" in found["friction"]


def gripping(document: Document) -> list[Document]:
    """The segments in which the plate is gripped."""
    return [segment for segment in document["segments"] if segment["hold"] and segment["hold"]["grip"]]


def fingers(segments: list[Document]) -> list[Document]:
    return [contact for segment in segments for contact in segment["contacts"] if contact["kind"] == "soft_finger"]


# Payload.


def in_the_air(document: Document) -> tuple[int, list[Document]]:
    """The last contact set: both hands and the cup, and nothing else."""
    contacts = document["segments"][-1]["contacts"]
    last = max(contact["sample"] for contact in contacts)
    found = [contact for contact in contacts if contact["sample"] == last]
    assert sorted(contact["kind"] for contact in found) == ["point", "soft_finger", "soft_finger", "suction"]
    return last, found


def press_against_one_another(document: Document, force: float) -> None:
    """Let the stick press harder and the gripper hold against it, in balance and within friction, cup and squeeze."""
    task, (sample, contacts) = document["task"], in_the_air(document)
    T = from_pose7(document["segments"][-1]["body_poses"]["plate"][sample])
    R, p = T[:3, :3], T[:3, 3]
    first, second, pusher = (
        next(c for c in contacts if (c["kind"], c["finger"]) == key)
        for key in (("soft_finger", 0), ("soft_finger", 1), ("point", None))
    )
    own = [(R.T @ (np.array(c["point"]) - p), R.T @ np.array(c["normal"])) for c in (first, second, pusher)]
    grip = GripContacts(np.array([own[0][0], own[1][0]]), np.array([own[0][1], own[1][1]]))
    push = PushContact(*own[2])
    cup, friction = task["cup"], task["friction"]
    position = (*cup["position"], task["plate"]["shape"]["size"][2] / 2)
    plate = Plate(
        task["plate"]["mass"], np.array(task["plate"]["com"]),
        Cup.on_top(position, cup["radius"], cup["max_force"], mu=cup["mu"], kappa=cup["kappa"]),
        Friction(friction["grip"], friction["push"], friction["environment"], friction["eps"]),
        HandLimits(100.0, 100.0, 100.0, first["squeeze"]), task["lifter_model"],
    )  # fmt: skip
    statement = state_balance(plate, R, np.zeros((0, 3)), grip, push)
    weight = np.concatenate([-9.81 * plate.mass * R[2], np.zeros(3)])
    pressed = [statement.wrenches["push"][2] == force, statement.total + weight == 0]
    cp.Problem(cp.Minimize(statement.hand_effort), [*statement.limits, *pressed]).solve(solver="CLARABEL")
    frames = contact_frames(plate, R[2], np.zeros((0, 3)), grip, push)
    suction = next(c for c in contacts if c["kind"] == "suction")
    suction["suction_force"] = float(statement.pull.value)
    for contact, name in ((first, "grip_0"), (second, "grip_1"), (pusher, "push"), (suction, "cup")):
        wrench = statement.wrenches[name].value.reshape(2, 3)
        contact["wrench"] = (wrench @ (R @ frames[name][:3, :3]).T).ravel().tolist()


def allow(document: Document, hands: float) -> None:
    """Let the task ask for so much, and the contacts state what follows from it; hands and arms are as they are."""
    document["task"]["hand_force_limit"] |= {"normal": hands, "net": hands}
    cell = document["cell"]
    left = {a: 9.81 * (cell["arms"][a]["payload"] - cell["hands"][a]["mass"]) for a in ("left", "right")}
    for segment in document["segments"]:
        for contact in segment["contacts"]:
            if contact["kind"] == "soft_finger":
                contact["limit"] = contact["squeeze"] + 0.5 * min(hands, left[contact["by"]])
            elif contact["kind"] == "point":
                contact["limit"] = min(hands, left[contact["by"]])


def test_a_task_that_allows_more_than_arms_bear_changes_nothing(document: Document, surfaces: RobotSurfaces) -> None:
    allow(document, 100.0)
    assert failures(document, surfaces) == {}


def test_hands_that_press_against_one_another_pass_up_to_the_payload(
    document: Document, surfaces: RobotSurfaces
) -> None:
    allow(document, 100.0)
    press_against_one_another(document, 14.0)
    assert set(failures(document, surfaces)) <= {"reserve", "joint torque"}


def test_more_than_the_payload_of_an_arm_is_refused_whatever_the_task_allows(
    document: Document, surfaces: RobotSurfaces
) -> None:
    allow(document, 100.0)
    press_against_one_another(document, 24.0)
    found = failures(document, surfaces)
    assert "payload" in found
    assert found["payload"].endswith("by right")
    # All else is in order but what follows from it.
    assert set(found) <= {"payload", "hand_force", "reserve", "joint torque"}


# Squeeze.


def squeeze_less(document: Document) -> None:
    """Fifteen newtons, told everywhere, the fingers' forces with it; with pads that hold it all the same."""
    document["task"]["friction"]["grip"] = 10.0
    for segment in gripping(document):
        segment["hold"]["grip"]["squeeze"] = 15.0
    for finger in fingers(gripping(document)):
        press(finger, 15.0 - finger["squeeze"])
        finger["limit"] += 15.0 - finger["squeeze"]
        finger["squeeze"], finger["mu"] = 15.0, 10.0


def press(finger: Document, more: float) -> None:
    wrench = np.array(finger["wrench"])
    wrench[:3] += more * np.array(finger["normal"])
    finger["wrench"] = wrench.tolist()


def squeeze_harder_in_the_middle_of_a_hold(document: Document) -> None:
    segments = gripping(document)
    begun = len(segments) // 2
    assert segments[begun]["kind"] not in ("grip", "release")
    assert segments[begun - 1]["kind"] not in ("grip", "release")
    for segment in segments[begun:]:
        segment["hold"]["grip"]["squeeze"] += 5.0
    for finger in fingers(segments[begun:]):
        press(finger, 5.0)
        finger["limit"] += 5.0
        finger["squeeze"] += 5.0


def press_with_both_fingers_less_than_commanded(document: Document) -> None:
    """A balance all the same, the pads being opposite; what the friction of that one set leaves changes with it."""
    for contact in in_the_air(document)[1]:
        if contact["kind"] == "soft_finger":
            press(contact, -0.05)


def say_nothing_of_the_squeeze(document: Document) -> None:
    for segment in gripping(document):
        segment["hold"]["grip"]["squeeze"] = None


# Reserve.


def state_more_reserve_than_there_is(document: Document) -> None:
    document["statistics"]["reserve"]["value"] += 0.01
    for segment in document["segments"]:
        if segment["reserve"] is not None:
            segment["reserve"] = [None if value is None else value + 0.01 for value in segment["reserve"]]


def state_more_reserve_in_the_summary_alone(document: Document) -> None:
    document["statistics"]["reserve"]["value"] += 0.01


def state_more_reserve_in_a_curve_alone(document: Document) -> None:
    segment = next(s for s in reversed(document["segments"]) if s["reserve"] is not None)
    segment["reserve"] = [value if value is None else value + 0.5 for value in segment["reserve"]]


# Tolerances, torque.


def let_the_plate_be_heavier(document: Document) -> None:
    document["task"]["plate"]["mass_tolerance"] = 0.2


def let_the_centre_of_mass_be_farther_off(document: Document) -> None:
    document["task"]["plate"]["com_tolerance"] = 0.03


def give_the_arms_weaker_joints(document: Document) -> None:
    for arm in document["cell"]["arms"].values():
        arm["torque_max"] = [0.5 * torque for torque in arm["torque_max"]]


LIES = [
    (squeeze_less, "squeeze", "hand"),
    (squeeze_harder_in_the_middle_of_a_hold, "squeeze", "not as before"),
    (press_with_both_fingers_less_than_commanded, "squeeze", "both fingers together"),
    (say_nothing_of_the_squeeze, "squeeze", "no squeeze is"),
    (state_more_reserve_than_there_is, "reserve", "is stated"),
    (state_more_reserve_in_the_summary_alone, "reserve", "the smallest reserve"),
    (state_more_reserve_in_a_curve_alone, "reserve", "is stated"),
    (let_the_plate_be_heavier, "uncertainty", "plate"),
    (let_the_centre_of_mass_be_farther_off, "uncertainty", "plate"),
    (give_the_arms_weaker_joints, "joint torque", "_joint"),
]


@pytest.mark.parametrize(("tell", "check", "place"), among(LIES, list({lie[1]: lie for lie in LIES}.values())))
def test_a_lie_fails_the_check_that_it_is_about(
    tell: Callable[[Document], None], check: str, place: str, document: Document, surfaces: RobotSurfaces
) -> None:
    tell(document)
    found = failures(document, surfaces)
    also = {"reserve"} if tell is press_with_both_fingers_less_than_commanded else set()
    assert set(found) - also == {check}
    assert place in found[check]


def test_both_load_programs_agree_on_the_contact_sets_of_a_planned_lift(planned_lift: Document) -> None:
    evidence = evidence_of(planned_lift)
    bounds = LiftTask.of(evidence.plan.stated.task, None).bounds(evidence.plan)
    plate, sets = evidence.plan.bodies["plate"], evidence.contacts
    rng = np.random.default_rng(11)
    for number in rng.permutation(len(sets))[:15]:
        contacts = sets[number].bearing
        load = np.array([0.0, 0.0, -9.81 * plate.mass, *rng.uniform(-0.3, 0.3, 3)])
        centre = sets[number].T_world_body[:3, 3]
        (stated,) = stated_factors(contacts, centre, bounds, [load])
        assert LoadProgram(contacts, centre, bounds).factor(load) == pytest.approx(stated, abs=2e-6)
