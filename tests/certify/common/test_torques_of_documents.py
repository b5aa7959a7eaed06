"""The certificate's joint torques: against the planners' own kernel, and against documents that lie about them."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from planners.certify import CellReference, Check
from planners.certify.common.joint_torque import torque_check
from planners.geometry.pose import Array, from_pose7
from planners.kinematics.joint_torque import WeighedArm, joint_torques
from planners.plan.scenery import CellDocument
from tests.support.documents import certified, evidence_of
from tests.support.samples import among
from tests.support.tool_plans import QUARTER, block, planned, reference_of_the_tool_cell

Document = dict[str, Any]
NAME = "joint torque"


@pytest.fixture(scope="module")
def handed_over() -> Document:
    """The tool changes hands with a block on its cup."""
    across = {"pose": [0.3, 0.42, 1.104, *QUARTER], "goal_pose": [0.3, -0.4, 1.104, *QUARTER], "mass": 0.4}
    return planned({"objects": [block(**across)]})


@pytest.fixture(scope="module", params=among(["lift", "tool"], ["lift"]))
def honest(request: pytest.FixtureRequest) -> Document:
    return request.getfixturevalue("honest_document" if request.param == "lift" else "handed_over")


@pytest.fixture
def document(honest: Document) -> Document:
    return copy.deepcopy(honest)


@pytest.fixture(scope="module")
def known(honest: Document, reference: CellReference) -> CellReference:
    return reference if honest["task"]["kind"] == "plate_lift" else reference_of_the_tool_cell()


def checked(document: Document, reference: CellReference | None = None) -> Check:
    """This one check; the whole certificate takes longer."""
    return torque_check(evidence_of(document, reference))


def limits(document: Document, arm: str) -> Array:
    return 0.95 * np.array(document["cell"]["arms"][arm]["torque_max"])


def torques(document: Document, segment: Document, arm: str, wrenches: Array, points: Array) -> Array:
    """Torques (n, 6) by the planners' kernel, all taken from the JSON."""
    stated, hand = document["cell"]["arms"][arm], document["cell"]["hands"][arm]
    entries = [*stated["links"], {"mass": hand["mass"], "com": hand["com"]}]
    masses = np.array([[entry["mass"], *entry["com"]] for entry in entries])
    first = ("left", "right").index(arm) * 6
    state = [np.array(segment[name])[:, first : first + 6] for name in ("positions", "velocities", "accelerations")]
    state = [np.ascontiguousarray(one) for one in state]
    gravity = np.array(document["cell"]["gravity"])
    arm = WeighedArm(np.array(stated["dh"]), from_pose7(stated["base"]), masses, gravity)
    return joint_torques(arm, *state, wrenches, points)


def hands_wrench(segment: Document, arm: str, name: str, sample: int, centre: Array) -> Array:
    wrench = np.zeros(6)
    for contact in segment["contacts"]:
        if (contact["by"], contact["body"], contact["sample"]) == (arm, name, sample):
            force = np.array(contact["wrench"][:3])
            moment = np.array(contact["wrench"][3:]) + np.cross(np.array(contact["point"]) - centre, force)
            wrench += np.concatenate([force, moment])
    return wrench


def slacks(document: Document, share: float) -> list[tuple[float, float, str, str]]:
    """What is left where a sample's wrench is `share` of the next set's, the rest the last one's.

    Of each segment and arm at the worst place: the share of the largest torque, what is left of the limit [Nm], where,
    and of which joint.
    """
    found = []
    places = {name: body["pose"] for name, body in document["bodies"].items()}
    held = {"plate_lift": "plate", "suction_tool": "tool"}[document["task"]["kind"]]
    com = np.array(document["bodies"][held]["com"])
    for number, segment in enumerate(document["segments"]):
        n = len(segment["time"])
        rows = segment["body_poses"].get(held, [places[held]] * n)
        centres = np.array([from_pose7(row)[:3, :3] @ com + row[:3] for row in rows])
        samples = sorted({contact["sample"] for contact in segment["contacts"] if contact["body"] == held})
        for arm in ("left", "right"):
            shown = {sample: hands_wrench(segment, arm, held, sample, centres[sample]) for sample in samples}
            wrenches = np.zeros((n, 6))
            for before, after in pairwise(samples):
                wrenches[before + 1 : after] = (1.0 - share) * shown[before] + share * shown[after]
            for sample, wrench in shown.items():
                wrenches[sample] = wrench
            needed = np.abs(torques(document, segment, arm, wrenches, centres))
            left = 1.0 - needed / (limits(document, arm) / 0.95)
            sample, joint = np.unravel_index(int(np.argmin(left)), left.shape)
            name = document["joint_names"][joint + (0 if arm == "left" else 6)]
            margin = limits(document, arm)[joint] - needed[sample, joint]
            found.append(
                (float(left.min()), float(margin), f"segment {number} ({segment['kind']}), sample {sample} ", name)
            )
        places |= {name: poses[-1] for name, poses in segment["body_poses"].items()}
    return found


def test_the_margin_is_that_of_the_worst_joint_at_the_worst_sample(honest, surfaces, known):
    certificate = certified(honest, surfaces, known)
    assert certificate.passed
    check = next(check for check in certificate.checks if check.name == NAME)
    least, margin, place, joint = min(slacks(honest, 0.0) + slacks(honest, 1.0))
    assert check.share_left == pytest.approx(least, abs=1e-9)
    assert check.margin == pytest.approx(margin, abs=1e-9)
    assert check.unit == "Nm"
    assert check.where.startswith(place)
    assert check.where.endswith(joint)


@pytest.mark.slow
def test_what_one_contact_set_asks_for_counts_up_to_both_its_neighbours(honest_document):
    """Oracle: the planners' kernel, with the set before at all samples in between, and with the set after."""
    document, places = copy.deepcopy(honest_document), set()
    held = [segment for segment in document["segments"] if len({one["sample"] for one in segment["contacts"]}) > 1]
    for segment in held:
        hands = [contact for contact in segment["contacts"] if contact["by"] in ("left", "right")]
        for sample in sorted({contact["sample"] for contact in hands}):
            wrenches = [(contact, contact["wrench"]) for contact in hands if contact["sample"] == sample]
            for contact, wrench in wrenches:
                contact["wrench"] = [40.0 * value for value in wrench]
            check = checked(document)
            least, _, place, _ = min(slacks(document, 0.0) + slacks(document, 1.0))
            assert check.share_left == pytest.approx(least, abs=1e-9)
            worst = int(place.rsplit("sample ", 1)[1])
            places.add((worst > sample) - (worst < sample))
            for contact, wrench in wrenches:
                contact["wrench"] = wrench
    assert {-1, 1} <= places


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_no_mean_of_two_contact_sets_asks_for_more(honest, share):
    assert checked(honest).share_left <= min(slacks(honest, share))[0] + 1e-9


@pytest.mark.parametrize(("part", "passes"), [(0.999, False), (1.001, True)])
def test_a_joint_may_use_19_of_20_parts_of_its_largest_torque(part, passes, document):
    before = checked(document)
    arm, _, joint = before.where.rsplit(" ", 1)[1].partition("_")
    number = document["joint_names"].index(f"{arm}_{joint}") % 6
    torque_max = document["cell"]["arms"][arm]["torque_max"]
    torque_max[number] = part * (limits(document, arm)[number] - before.margin) / 0.95
    check = checked(document)
    assert (check.passed, check.where == before.where) == (passes, True)


def load_the_hand(document: Document) -> None:
    for hand in document["cell"]["hands"].values():
        hand["mass"], hand["com"] = 4.0, [0.0, 0.0, 0.2]


def load_a_link(document: Document) -> None:
    for arm in document["cell"]["arms"].values():
        arm["links"][4] = {"mass": 9.0, "com": [0.0, 0.0, 0.1]}


def exert_more(document: Document) -> None:
    for segment in document["segments"]:
        for contact in segment["contacts"]:
            if contact["by"] in ("left", "right"):
                contact["wrench"] = [40.0 * value for value in contact["wrench"]]


def accelerate(document: Document) -> None:
    for segment in document["segments"]:
        segment["accelerations"] = (1000.0 * np.array(segment["accelerations"])).tolist()


@pytest.mark.parametrize("tell", [load_the_hand, load_a_link, exert_more, accelerate])
def test_a_plan_that_asks_too_much_of_a_joint_is_refused(tell: Callable[[Document], None], document: Document) -> None:
    before = checked(document)
    tell(document)
    check = checked(document)
    assert not check.passed
    assert check.margin < 0.0 < before.margin
    assert check.where.endswith("_joint")


@pytest.mark.parametrize(
    ("member", "value", "pointer"),
    [
        (("arms", "left", "torque_max", 3), 50.0, "/cell/arms/left/torque_max/3"),
        (("arms", "right", "links", 1, "mass"), 0.5, "/cell/arms/right/links/1/mass"),
        (("hands", "right", "com", 2), 0.0, "/cell/hands/right/com/2"),
    ],
)
def test_a_cell_that_is_stronger_or_lighter_than_it_is_fails(document, surfaces, known, member, value, pointer):
    owner = document["cell"]
    for key in member[:-1]:
        owner = owner[key]
    owner[member[-1]] = value
    assert {check.name: check.where for check in certified(document, surfaces, known).failures} == {"cell": pointer}


def without_masses(document: Document) -> Document:
    """The document as 0.1.0 wrote it."""
    for arm in document["cell"]["arms"].values():
        del arm["links"], arm["torque_max"]
    for hand in document["cell"]["hands"].values():
        del hand["com"]
    CellDocument.model_validate(document["cell"])
    return document


def test_masses_that_a_document_of_0_1_0_lacks_are_those_of_the_cell_it_names(honest, document, known):
    assert checked(without_masses(document), known) == checked(honest)


def test_without_masses_and_a_known_cell_nothing_is_claimed(document, known):
    without_masses(document)
    for reference in (None, replace(known, cell=known.cell.model_copy(update={"name": "another"}))):
        check = checked(document, reference)
        assert (check.passed, check.margin) == (True, None)
        assert check.where.startswith("not checked: ")


@pytest.mark.parametrize(
    ("member", "value", "pointer"),
    [
        (("arms", "left", "torque_max"), [1.0] * 5, "/cell/arms/left/torque_max"),
        (("arms", "left", "links"), [], "/cell/arms/left/links"),
        (("arms", "left", "links", 2, "mass"), 0.0, "/cell/arms/left/links/2/mass"),
        (("arms", "left", "links", 2, "com"), "here", "/cell/arms/left/links/2/com"),
        (("hands", "right", "com"), [0.0, 0.1], "/cell/hands/right/com"),
    ],
)
def test_masses_that_are_none_are_pointed_at(document, surfaces, member, value, pointer):
    owner = document["cell"]
    for key in member[:-1]:
        owner = owner[key]
    owner[member[-1]] = value
    (check,) = certified(json.loads(json.dumps(document)), surfaces).checks
    assert (check.name, check.passed) == ("structure", False)
    assert check.where.startswith(pointer)
