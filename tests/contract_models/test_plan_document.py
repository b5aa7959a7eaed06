"""The plan document's model: what it accepts, and that numbers keep their digits."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from planners.contract.task_spec import read_task, write_task
from planners.plan.plan import Plan, plan_schema
from planners.plan.scenery import JOINT_NAMES

AB1 = json.loads((Path(__file__).parents[2] / "assets/tasks/ab1.json").read_text())
POSE = [0.3, 0.0, 1.114, 1.0, 0.0, 0.0, 0.0]
ARM = {
    "base": POSE,
    "dh": [[0.0, 0.0, 0.0, 0.0]] * 6,
    "position_min": [-6.0] * 6,
    "position_max": [6.0] * 6,
    "velocity_max": [3.0] * 6,
    "acceleration_max": [5.0] * 6,
    "payload": 3.0,
}
CUP = {"type": "cylinder", "radius": 0.02, "height": 0.05}
TABLE = {"type": "box", "size": [1.0, 1.0, 0.1]}
CONTACT = {
    "sample": 0,
    "body": "plate",
    "by": "right",
    "finger": 0,
    "kind": "soft_finger",
    "point": [0.3, 0.1, 1.1],
    "normal": [0.0, 0.0, 1.0],
    "wrench": [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
    "mu": 0.5,
    "eps": 0.0075,
    "limit": 17.0,
}


def segment(samples):
    return {
        "kind": "transfer",
        "movers": ["left", "right"],
        "contact_state": {"element": "edge", "index": 0, "with": "table", "vertices": [[0.0] * 3] * 2},
        "hold": {"grip": None, "push": None},
        "time": [0.01 * k for k in range(samples)],
        "positions": [[0.1] * 12] * samples,
        "velocities": [[0.0] * 12] * samples,
        "accelerations": [[0.0] * 12] * samples,
        "gripper_width": {"right": [0.04] * samples},
        "attached": {"plate": [{"to": "right", "pose": POSE}], "cup": [{"to": "plate", "pose": POSE}]},
        "body_poses": {"plate": [POSE] * samples},
        "contacts": [CONTACT],
    }


def document(samples=3):
    return {
        "schema_version": "1.0",
        "id": "plan",
        "task": write_task(read_task(AB1)),
        "seed": 0,
        "software": {"name": "liftwright", "version": "0.1.0", "commit": None},
        "outcome": "solved",
        "explanation": {"summary": "A plan was found.", "causes": []},
        "cell": {
            "name": "dual_ur3e_lift",
            "hash": "0",
            "gravity": [0, 0, -9.81],
            "arms": {"left": ARM, "right": ARM},
            "hands": {
                "right": {"kind": "gripper", "mass": 1.2, "tcp": [[0.0, 0.19], [0.085, 0.18]]},
                "left": {"kind": "stick", "mass": 0.7, "tcp": POSE, "tip_radius": 0.01},
            },
        },
        "joint_names": list(JOINT_NAMES),
        "bodies": {
            "plate": {
                "role": "plate",
                "shape": AB1["plate"]["shape"],
                "mass": 4.0,
                "com": [0, 0, 0],
                "pose": POSE,
                "static": False,
            },
            "cup": {"role": "cup", "shape": CUP, "mass": None, "com": [0, 0, 0], "pose": POSE, "static": False},
            "table": {"role": "table", "shape": TABLE, "mass": None, "com": [0, 0, 0], "pose": POSE, "static": True},
        },
        "segments": [segment(samples)],
        "certificate": {"passed": True, "checks": [{"name": "balance", "passed": True, "margin": 1.0, "unit": "N"}]},
        "simulation": None,
        "statistics": {"total_seconds": 1.0, "stages": [], "graph": {}, "search": {}, "rejections": {"reach": 3}},
    }


def test_joints_are_named_left_arm_first():
    assert len(set(JOINT_NAMES)) == 12
    assert (JOINT_NAMES[0], JOINT_NAMES[-1]) == ("left_shoulder_pan_joint", "right_wrist_3_joint")


def test_a_document_as_the_contract_says_is_accepted():
    Plan.model_validate(document())


def member(data, path):
    for step in path:
        data = data[step]
    return data


FIRST = ("segments", 0)


@pytest.mark.parametrize(
    ("path", "key", "value"),
    [
        ((), "schema_version", "2.0"),
        ((), "outcome", "maybe"),
        ((), "extra", 1),
        (("task",), "kind", "plate_drop"),
        (("bodies", "plate"), "pose", [0, 0, 0]),
        (("bodies", "plate"), "role", "lid"),
        (("certificate", "checks", 0), "margin", float("nan")),
        (FIRST, "kind", "jump"),
        (FIRST, "time", [0.0]),
        (FIRST, "positions", [[0.1] * 12] * 2),
        (FIRST, "velocities", [[0.1] * 11] * 3),
        (FIRST, "accelerations", []),
        (FIRST, "gripper_width", {"right": [0.04]}),
        (FIRST, "body_poses", {"plate": [[0.0] * 6] * 3}),
        (FIRST, "movers", ["middle"]),
        (FIRST, "contacts", [{**CONTACT, "sample": 3}]),
        (FIRST, "contacts", [{**CONTACT, "kind": "glue"}]),
        (FIRST, "contacts", [{k: v for k, v in CONTACT.items() if k != "eps"}]),
        ((*FIRST, "contact_state"), "with_", "table"),
    ],
)
def test_a_document_that_says_something_else_is_refused(path, key, value):
    wrong = copy.deepcopy(document())
    member(wrong, path)[key] = value
    with pytest.raises(ValidationError):
        Plan.model_validate(wrong)


def test_what_was_read_is_written_as_it_was():
    sent = json.dumps(document(), separators=(",", ":")).encode()
    again = Plan.read(sent).write()
    assert json.loads(again) == json.loads(sent)
    assert Plan.read(again).write() == again


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e3, max_value=1e3))
def test_a_sample_is_read_as_it_was_written(number):
    first = document()
    first["segments"][0]["time"] = [number, number]
    first["segments"][0] |= {
        name: first["segments"][0][name][:2] for name in ("positions", "velocities", "accelerations")
    }
    first["segments"][0] |= {"gripper_width": {"right": [0.0, 0.0]}, "body_poses": {}}
    written = Plan.model_validate(first).write()
    assert json.loads(written)["segments"][0]["time"][0] == pytest.approx(number, abs=1e-12)
    assert Plan.read(written).write() == written


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e10, "1", True, None])
def test_a_number_that_is_none_is_refused(number):
    wrong = document()
    wrong["segments"][0]["time"][0] = number
    with pytest.raises(ValidationError):
        Plan.model_validate(wrong)


def test_the_schema_shows_arrays_that_are_not_checked_one_by_one():
    segment_schema = plan_schema()["$defs"]["Segment"]["properties"]
    assert segment_schema["positions"]["items"]["items"] == {"type": "number"}


def test_the_contracts_members_are_those_of_the_model():
    assert list(Plan.model_fields) == [
        *("schema_version", "id", "task", "seed", "software", "outcome", "explanation", "cell", "joint_names"),
        *("bodies", "segments", "certificate", "simulation", "statistics", "digest"),
    ]


def test_arrays_are_what_plain_json_and_numpy_read():
    sent = json.dumps(document(samples=4)).encode()
    plain, plan = json.loads(sent), Plan.read(sent)
    for told, read in zip(plain["segments"], plan.segments, strict=True):
        for name in ("time", "positions", "velocities", "accelerations"):
            assert np.array_equal(getattr(read, name), np.array(told[name]))
        assert all(np.array_equal(read.gripper_width[arm], rows) for arm, rows in told["gripper_width"].items())
        for name, rows in told["body_poses"].items():
            assert np.array_equal(read.body_poses[name], np.array(rows))
            turned = Rotation.from_quat(np.array(rows)[:, 3:], scalar_first=True).as_matrix()
            assert np.allclose(read.transforms[name][:, :3, :3], turned, atol=1e-15)
            assert np.array_equal(read.transforms[name][:, :3, 3], np.array(rows)[:, :3])
        for contact, one in zip(told["contacts"], read.contacts, strict=True):
            assert all(np.array_equal(getattr(one, name), contact[name]) for name in ("point", "normal", "wrench"))
            assert all(getattr(one, name) == contact[name] for name in ("sample", "body", "by", "kind", "mu", "limit"))
