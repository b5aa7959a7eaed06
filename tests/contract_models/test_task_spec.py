"""Task specs: their defaults, and that writing and reading one gives the same."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from planners.contract.problems import json_pointer, problems_of
from planners.contract.strict_json import parse_json
from planners.contract.task_spec import read_task, write_task

TASKS = sorted((Path(__file__).parents[2] / "assets/tasks").glob("*.json"))
POSE = [0.3, 0.0, 1.114, 1.0, 0.0, 0.0, 0.0]
SMALLEST_LIFT = {
    "kind": "plate_lift",
    "plate": {"shape": {"type": "box", "size": [0.3, 0.3, 0.04]}, "mass": 4},
    "plate_pose": POSE,
    "cup": {"position": [0.1, 0], "radius": 0.0175, "max_force": 20},
}


@pytest.mark.parametrize("path", TASKS, ids=lambda path: path.stem)
def test_every_task_file_is_a_task_named_like_its_file(path):
    assert read_task(parse_json(path.read_bytes())).external_id == path.stem


@pytest.mark.parametrize("text", [str(TASKS[0]), TASKS[0].read_text(), "", "plate_lift"])
def test_text_is_no_task_and_whoever_gives_it_is_told_what_is(text):
    """It is never opened, nor parsed: over HTTP it is what any other value but an object is."""
    assert read_task(TASKS[0]) == read_task(TASKS[0].read_bytes()) == read_task(json.loads(TASKS[0].read_text()))
    with pytest.raises(ValueError, match=r"pathlib.Path.*bytes.*dict") as refused:
        read_task(text)
    with pytest.raises(ValidationError) as other:
        read_task(17)
    assert problems_of(refused.value) == problems_of(other.value)


def test_the_papers_experiments_are_there():
    assert {path.stem for path in TASKS} >= {"ab1", "ab2", "ab3", "pb1", "pb2", "pb1_weak_cup", "pb2_weak_cup"}


def test_a_plate_lift_has_the_defaults_of_the_contract():
    task = write_task(read_task(SMALLEST_LIFT))
    assert task["plate"].pop("com") is None  # What it stands for takes the scene: tests/scene/test_centres.py.
    assert (task["plate"].pop("mass_tolerance"), task["plate"].pop("com_tolerance")) == (0.02, 0.005)
    assert (task["cup"].pop("mu"), task["cup"].pop("kappa")) == (0.5, 0.005)
    options = task.pop("options")
    assert (options["goal_height"], options["minimise"], options["reserve"]) == (0.03, "cost", 0.1)
    assert task == {
        **SMALLEST_LIFT,
        "cell": "dual_ur3e_lift",
        "support": None,
        "lifter_model": "paper",
        "contact_model": "squeeze",
        "friction": {"grip": 0.5, "push": 0.5, "environment": 0.4, "eps": 0.0075},
        "hand_force_limit": {"normal": 17.0, "net": 19.0, "squeeze": None},
        "obstacles": [],
        "start_positions": None,
        "seed": 0,
        "external_id": None,
    }


def object_of(shape, **members):
    return {"name": "can", "shape": shape, "mass": 0.37, "pose": POSE, "goal_pose": POSE, **members}


CAN = {"type": "cylinder", "radius": 0.033, "height": 0.1222}
BLOCK = {"type": "box", "size": [0.13, 0.07, 0.02]}


def test_a_suction_tool_task_has_the_defaults_of_the_contract():
    task = write_task(read_task({"kind": "suction_tool", "objects": [object_of(CAN)]}))
    del task["objects"], task["options"]
    assert task == {
        "kind": "suction_tool",
        "cell": "dual_ur3e_tool",
        "tool": "long_symmetric",
        "tool_pose": None,
        "scene_id": None,
        "friction": {"grip": 0.5, "environment": 0.4},
        "grip_force_limit": 60.0,
        "carry_force_limit": None,
        "obstacles": [],
        "start_positions": None,
        "seed": 0,
        "external_id": None,
    }


@pytest.mark.parametrize(("shape", "symmetry"), [(CAN, "axis"), (BLOCK, "none")])
def test_a_cylinder_may_end_at_any_turn_about_its_axis_unless_told_otherwise(shape, symmetry):
    def goal_symmetry(**members):
        return read_task({"kind": "suction_tool", "objects": [object_of(shape, **members)]}).objects[0].goal_symmetry

    assert goal_symmetry() == symmetry
    assert goal_symmetry(goal_symmetry="shape") == "shape"


@pytest.mark.parametrize("max_force", [20, 60])
def test_a_tools_cup_bears_half_the_moment_at_which_it_peels(max_force):
    part = {"shape": BLOCK, "pose": POSE}
    tool = {"shapes": [part], "mass": 0.2, "cup": {"radius": 0.0175, "max_force": max_force}}
    task = read_task({"kind": "suction_tool", "tool": tool, "objects": [object_of(CAN)]})
    peel_limit = math.sqrt(2) * max_force / math.pi
    assert task.tool.cup.kappa == pytest.approx(peel_limit / 2)


def test_a_value_that_a_default_needs_is_reported_once():
    part = {"shape": BLOCK, "pose": POSE}
    tool = {"shapes": [part], "mass": 0.2, "cup": {"radius": 0.0175, "max_force": "20"}}
    body = {"kind": "suction_tool", "tool": tool, "objects": [object_of({"type": "ball"})]}
    with pytest.raises(ValidationError) as caught:
        read_task(body)
    pointers = [problem.pointer for problem in problems_of(caught.value)]
    assert pointers == ["/tool/cup/max_force", "/objects/0/shape/type"]


@given(st.floats(-0.9e-3, 0.9e-3), st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1))
def test_a_nearly_unit_quaternion_is_made_one_and_keeps_its_direction(error, values):
    norm = math.hypot(*values)
    given_one = [value / norm * (1 + error) for value in values]
    task = read_task({**SMALLEST_LIFT, "plate_pose": [0.3, 0, 1.114, *given_one]})
    assert math.hypot(*task.plate_pose[3:]) == pytest.approx(1, abs=1e-12)
    assert sum(a * b for a, b in zip(task.plate_pose[3:], values, strict=True)) == pytest.approx(norm)


LENGTHS = st.floats(1e-4, 10) | st.integers(1, 10)
COORDINATES = st.floats(-10, 10) | st.integers(-10, 10)
FORCES = st.floats(1e-3, 1e5)


@st.composite
def poses(draw):
    position = draw(st.tuples(COORDINATES, COORDINATES, COORDINATES))
    values = draw(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1))
    return [*position, *(value / math.hypot(*values) * 1.0005 for value in values)]


@st.composite
def outlines(draw):
    sides, radius, turn = draw(st.integers(3, 24)), draw(st.floats(0.01, 5)), draw(st.floats(0, 6))
    return [[radius * math.cos(turn + math.tau * k / sides), radius * math.sin(turn + math.tau * k / sides)]
            for k in range(sides)]  # fmt: skip


BOXES = st.fixed_dictionaries({"type": st.just("box"), "size": st.lists(LENGTHS, min_size=3, max_size=3)})
PRISMS = st.fixed_dictionaries({"type": st.just("prism"), "outline": outlines(), "height": LENGTHS})
CYLINDERS = st.fixed_dictionaries({"type": st.just("cylinder"), "radius": LENGTHS, "height": LENGTHS})
MESHES = st.fixed_dictionaries({"type": st.just("mesh"), "asset": st.just("can")}, optional={"scale": st.just(0.001)})
NAMES = st.from_regex(r"[A-Za-z0-9_-]{1,64}", fullmatch=True)
OBSTACLES = st.fixed_dictionaries({"name": NAMES, "shape": BOXES | PRISMS | CYLINDERS | MESHES, "pose": poses()})
LIFTS = st.fixed_dictionaries(
    {
        "kind": st.just("plate_lift"),
        "plate": st.fixed_dictionaries({"shape": BOXES | PRISMS, "mass": st.floats(1e-4, 1000)}),
        "plate_pose": poses(),
        "cup": st.fixed_dictionaries(
            {"position": st.lists(COORDINATES, min_size=2, max_size=2), "radius": LENGTHS, "max_force": FORCES},
            optional={"mu": st.floats(0.01, 10)},
        ),
    },
    optional={
        "support": st.none() | st.fixed_dictionaries({"shape": BOXES | CYLINDERS, "pose": poses()}),
        "lifter_model": st.sampled_from(["paper", "cable", "dexnet"]),
        "friction": st.fixed_dictionaries({}, optional={"grip": st.floats(0.01, 10)}),
        "obstacles": st.lists(OBSTACLES, max_size=3),
        "start_positions": st.none() | st.lists(st.floats(-7, 7), min_size=12, max_size=12),
        "seed": st.integers(0, 2**53 - 1),
        "options": st.fixed_dictionaries({}, optional={"minimise": st.sampled_from(["cost", "force"])}),
    },
)


@settings(max_examples=50, deadline=None)
@given(LIFTS)
def test_a_task_as_accepted_is_accepted_again_and_says_the_same(body):
    task = read_task(body)
    written = parse_json(json.dumps(write_task(task)).encode())
    assert read_task(written) == task
    assert write_task(read_task(written)) == written


KEYS = st.sampled_from(["kind", "plate", "shape", "type", "size", "cup", "pose", "objects", "tool", "name", "x/y~"])
WORDS = st.sampled_from(["plate_lift", "suction_tool", "box", "prism", "mesh", "long_symmetric", "custom tool"])
GARBAGE = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4) | WORDS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS | st.text(max_size=4), inner, max_size=5),
    max_leaves=30,
)


def resolves(pointer, body):
    """Whether the object or array that a pointer's last step is about exists in the body."""
    steps = [step.replace("~1", "/").replace("~0", "~") for step in pointer.split("/")[1:]]
    for step in steps[:-1]:
        body = body[int(step)] if isinstance(body, list) else body[step]
    return not steps or isinstance(body, dict | list)


@settings(max_examples=300, deadline=None)
@given(GARBAGE, st.sampled_from(["plate_lift", "suction_tool", None]))
@pytest.mark.slow
def test_garbage_is_refused_with_pointers_into_the_body(body, kind):
    if kind is not None and isinstance(body, dict):
        body = {**body, "kind": kind}
    with pytest.raises(ValidationError) as caught:
        read_task(body)
    found = problems_of(caught.value)
    assert found
    assert all(problem.detail and resolves(problem.pointer, body) for problem in found)


@given(st.lists(st.text(max_size=5), max_size=4))
def test_a_pointer_can_be_taken_apart_again(path):
    steps = json_pointer(path).split("/")[1:]
    assert [step.replace("~1", "/").replace("~0", "~") for step in steps] == path
