"""Bodies that are no task spec, and where the caller is pointed."""

import copy
import json
import math
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from planners.cell.asset_files import CellFile, GripperFile, MountFile, RobotFile, ToolFile
from planners.contract.problems import MAX_PROBLEMS, Problem, doubts_of, json_pointer, problems_of
from planners.contract.scan_spec import ScanSpec
from planners.contract.study_spec import StudySpec
from planners.contract.task_spec import UNION_TAGS, read_task, task_schema

ROOT = Path(__file__).parents[2]
AB1 = json.loads((ROOT / "assets/tasks/ab1.json").read_text())
DART = [[0, 0], [0.3, -0.2], [0.1, 0], [0.3, 0.2]]
POSE = [0.7, 0.5, 1.2, 1, 0, 0, 0]
CASES = yaml.load((ROOT / "tests/problems/task_spec_refusals.yaml").read_text(), yaml.CSafeLoader)


def step_to(body, pointer):
    """Return the container and the key that a JSON pointer names."""
    *path, key = [step.replace("~1", "/").replace("~0", "~") for step in pointer.split("/")[1:]]
    for step in path:
        body = body[int(step) if isinstance(body, list) else step]
    return body, int(key) if isinstance(body, list) else key


def changed(changes, without=()):
    body = copy.deepcopy(AB1)
    for pointer in without:
        container, key = step_to(body, pointer)
        del container[key]
    for pointer, value in changes.items():
        container, key = step_to(body, pointer)
        container[key] = value
    return body


def problems(body):
    with pytest.raises(ValidationError) as caught:
        read_task(body)
    return problems_of(caught.value)


@pytest.mark.parametrize("case", CASES, ids=[case["story"] for case in CASES])
def test_each_fault_is_pointed_at(case):
    found = problems(changed(case.get("with", {}), case.get("without", ())))
    assert sorted(problem.pointer for problem in found) == sorted(each["pointer"] for each in case["problems"])
    assert all(problem.detail for problem in found)
    choices = {each["pointer"]: each["allowed"] for each in case["problems"] if "allowed" in each}
    listed = {problem.pointer: problem.allowed for problem in found if problem.allowed is not None}
    assert {
        pointer: names for pointer, names in listed.items() if pointer in choices or not unknown(found, pointer)
    } == choices


def unknown(found, pointer):
    return any(problem.pointer == pointer and problem.detail == "is not known here" for problem in found)


def refused_as_unknown(body):
    try:
        read_task(body)
    except ValidationError as error:
        return {problem.pointer for problem in problems_of(error) if problem.detail == "is not known here"}
    return set()


@pytest.mark.parametrize("place", ["", "/cup", "/plate", "/plate/shape"])
def test_an_unknown_member_comes_with_those_that_are_known_there(place):
    (problem,) = problems(changed({f"{place}/colour": "red"}))
    given = changed({})
    for step in place.split("/")[1:]:
        given = given[step]
    assert set(given) <= set(problem.allowed)
    for name in problem.allowed:
        assert f"{place}/{name}" not in refused_as_unknown(changed({f"{place}/{name}": None}))


def test_a_plate_of_another_shape_is_told_how_it_may_be_described():
    mesh = {"type": "mesh", "upload": "0" * 64}
    (problem,) = problems(changed({"/plate/shape": mesh}))
    assert (problem.pointer, problem.allowed) == ("/plate/shape/type", ["box", "prism"])
    assert "the convex outline as a prism" in problem.detail


STUDY = {"task": {}, "axes": [{"pointer": "/cup/position/0", "values": [0.0]}], "points": None}
SHIPPED_FILES = {
    CellFile: ROOT / "assets/cells/dual_ur3e_lift.yaml",
    RobotFile: ROOT / "assets/robots/ur5e.yaml",
    MountFile: ROOT / "assets/mounts/dual_column.yaml",
    GripperFile: ROOT / "assets/hands/robotiq_2f85_ft300.yaml",
    ToolFile: ROOT / "assets/tools/short_asymmetric.yaml",
    ScanSpec: ROOT / "assets/scans/tissue_boxes/scan.json",
    StudySpec: None,
}


def objects_in(value, path=()):
    """Yield the path of each object."""
    if isinstance(value, dict):
        yield path
        for key, inner in value.items():
            yield from objects_in(inner, (*path, key))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from objects_in(inner, (*path, index))


def object_at(value, path):
    for step in path:
        value = value[step]
    return value


def unknown_with(model, given, path, name):
    """Return what is said of a member that is put into one of a body's objects; None: it is known there."""
    body = copy.deepcopy(given)
    object_at(body, path)[name] = "?"
    try:
        model.model_validate_json(json.dumps(body))
    except ValidationError as error:
        pointer = json_pointer((*path, name))
        found = (each for each in problems_of(error, model) if each.detail == "is not known here")
        return next((each for each in found if each.pointer == pointer), None)
    return None


@pytest.mark.parametrize(("model", "file"), SHIPPED_FILES.items(), ids=lambda each: getattr(each, "__name__", ""))
def test_unknown_members_of_cells_scans_and_studies_come_with_those_that_are_known_there(model, file):
    given = STUDY if file is None else yaml.load(file.read_text(), yaml.CSafeLoader)
    told = {path: unknown_with(model, given, path, "flavour") for path in objects_in(given)}
    listed = {path: problem.allowed for path, problem in told.items() if problem is not None and problem.allowed}
    assert () in listed
    assert max(map(len, listed)) > 0, "also within"
    for path, allowed in listed.items():
        members = object_at(given, path)
        assert {name for name in members if unknown_with(model, given, path, name) is None} <= set(allowed)
        assert [name for name in allowed if name not in members and unknown_with(model, given, path, name)] == []


@pytest.mark.parametrize("body", [None, 3, "plate", [], [AB1], True])
def test_a_body_that_is_no_object_is_pointed_at_as_a_whole(body):
    assert [problem.pointer for problem in problems(body)] == [""]


def numbers_in(value, pointer=""):
    """Yield the pointers of all numbers."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from numbers_in(inner, f"{pointer}/{key}")
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from numbers_in(inner, f"{pointer}/{index}")
    elif isinstance(value, int | float):
        yield pointer


FULL = read_task(AB1).model_dump(mode="json") | {
    "start_positions": [0.0] * 12,
    "support": {"shape": {"type": "cylinder", "radius": 0.4, "height": 0.04}, "pose": [0, 0, 0, 1, 0, 0, 0]},
    "obstacles": [
        {
            "name": "a",
            "shape": {"type": "prism", "outline": [[0, 0], [1, 0], [0, 1]], "height": 0.1},
            "pose": [0, 0, 0, 1, 0, 0, 0],
        },
        {"name": "b", "shape": {"type": "mesh", "asset": "x", "scale": 1.0}, "pose": [0, 0, 0, 1, 0, 0, 0]},
    ],
    "options": {
        "goal_height": 0.03,
        "contact_density": 1.0,
        "hold_density": 1.0,
        "grips": [{"position": [0.1, 0.1, 0], "approach": [1, 0, 0]}],
        "pushes": [{"position": [0.1, 0.1, 0], "normal": [1, 0, 0], "direction": [1, 0, 0]}],
    },
}


@pytest.mark.parametrize("pointer", list(numbers_in(FULL)))
def test_strings_and_booleans_and_infinities_are_numbers_nowhere(pointer):
    read_task(FULL)
    for wrong in ("1", True, None, float("nan"), float("inf"), 1e300, 10**400, [], {}):
        body = copy.deepcopy(FULL)
        container, key = step_to(body, pointer)
        container[key] = wrong
        assert [problem.pointer for problem in problems(body)] == [pointer]


def test_a_length_out_of_range_is_told_its_unit():
    (problem,) = problems(changed({"/plate/shape": {"type": "box", "size": [300, 0.15, 0.02]}}))
    assert problem == Problem("/plate/shape/size/0", "must be less than or equal to 10 metres: is it in millimetres?")


AWAY = [0.7, 300, 1.2, 1, 0, 0, 0]


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"/plate_pose/0": 300}, "/plate_pose/0"),
        ({"/support": {"shape": AB1["plate"]["shape"], "pose": AWAY}}, "/support/pose/1"),
        ({"/obstacles": [{"name": "a", "shape": AB1["plate"]["shape"], "pose": AWAY}]}, "/obstacles/0/pose/1"),
    ],
)
def test_a_position_out_of_range_is_told_its_unit(change, pointer):
    (problem,) = problems(changed(change))
    assert problem.pointer == pointer
    assert problem.detail.endswith(" metres: is it in millimetres?")


@pytest.mark.parametrize("change", [{"/plate_pose": [0.4, 0.0, 1.2, 0, 0, 90]}, {"/plate_pose": [0.4, 0.0, 1.2]}])
def test_what_is_no_pose_is_told_what_a_pose_is(change):
    told = problems(changed(change))
    assert {problem.pointer for problem in told} >= {"/plate_pose/6"}
    assert all(problem.detail.endswith(": a pose is [x, y, z, qw, qx, qy, qz]") for problem in told)


def test_a_mass_out_of_range_is_asked_whether_it_is_in_grams():
    (problem,) = problems(changed({"/plate/mass": 3200}))
    assert problem == Problem("/plate/mass", "must be less than or equal to 1000 kg: is it in grams?")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"/external_id": "a\0b"}, "1 to 128 characters, none of them a control character"),
        ({"/external_id": 129 * "a"}, "1 to 128 characters"),
        ({"/cell": 65 * "a"}, "1 to 64 letters"),
        ({"/obstacles": [{"name": "a b", "shape": AB1["plate"]["shape"], "pose": AB1["plate_pose"]}]}, "underscores"),
    ],
)
def test_what_a_string_must_be_is_told_in_words(change, told):
    (problem,) = problems(changed(change))
    assert told in problem.detail
    assert "^" not in problem.detail


def test_a_component_of_a_quaternion_has_no_unit():
    (problem,) = problems(changed({"/plate_pose/4": 300}))
    assert "metres" not in problem.detail


def test_a_refused_name_is_none_of_the_choices():
    shape = {"type": "box", "size": [0.1, 0.1, 0.1]}
    given = {"name": "lid", "shape": shape, "mass": 0.1, "pose": [0, 0, 1, 1, 0, 0, 0], "detection": "object_1"}
    (problem,) = problems({"kind": "suction_tool", "objects": [{**given, "goal_pose": given["pose"]}]})
    assert problem.pointer == "/objects/0/detection"
    choices = problem.allowed or []
    assert "goal_pose" in choices
    assert "detection" not in choices


def test_the_names_of_union_branches_are_members_of_nothing():
    """Else leaving them out of a pointer would lose a step of the body's own path."""
    schema = task_schema()
    members = {name for definition in schema["$defs"].values() for name in definition.get("properties", {})}
    assert members
    assert not members & UNION_TAGS


@pytest.mark.parametrize(
    ("name", "make_body"),
    [
        ("ten thousand obstacles", lambda: {**AB1, "obstacles": [{"name": f"o{i}"} for i in range(10_000)]}),
        ("ten thousand good obstacles", lambda: {**AB1, "obstacles": [FULL["obstacles"][0]] * 10_000}),
        ("a million unknown members", lambda: {**AB1, **{f"m{i}": i for i in range(1_000_000)}}),
        (
            "a million corners",
            lambda: changed({"/plate/shape": {"type": "prism", "outline": [[0, 0]] * 10**6, "height": 1}}),
        ),
        ("two hundred wide obstacles", lambda: {**AB1, "obstacles": [{f"m{i}": 0 for i in range(100)}] * 200}),
        ("a key of ten megabytes", lambda: {**AB1, "x" * 10**7: 1}),
        ("a kind of ten megabytes", lambda: {**AB1, "kind": "x" * 10**7}),
        ("a name of ten megabytes", lambda: {**AB1, "cell": "x" * 10**7}),
    ],
)
def test_hostile_bodies_get_a_short_answer(name, make_body):
    found = problems(make_body())
    assert len(found) <= MAX_PROBLEMS + 1
    assert len(json.dumps([problem.document() for problem in found])) < 100_000


def test_a_deeply_nested_member_is_refused_without_a_recursion_error():
    deep = []
    for _ in range(900):
        deep = [deep]
    for pointer in ("/plate", "/cell", "/kind", "/obstacles", "/options", "/deep"):
        assert problems(changed({pointer: deep}))


PLACE = [0.3, 0.2, 1.094]
NO_TURN, HALF_TURN, QUARTER_TURN = [1, 0, 0, 0], [0, 0, 0, 1], [0.5**0.5, 0, 0, 0.5**0.5]


@pytest.mark.parametrize(
    ("pose", "goal", "pointers"),
    [
        (HALF_TURN, HALF_TURN, ["/objects/0/pose", "/objects/0/goal_pose"]),
        (QUARTER_TURN, [0.0, 0.0, 0.0, 1.0], ["/objects/0/goal_pose"]),
        (NO_TURN, HALF_TURN, []),
        (QUARTER_TURN, QUARTER_TURN, []),
    ],
)
def test_half_a_turn_is_doubted_unless_its_writer_knows_how_no_turn_is_written(pose, goal, pointers):
    body = {"kind": "suction_tool", "objects": [{"name": "lid", "pose": PLACE + pose, "goal_pose": PLACE + goal}]}
    assert [doubt.pointer for doubt in doubts_of(body)] == pointers


@pytest.mark.parametrize(
    "shape",
    [
        {"type": "box", "size": [0.1, 0.2, 0.05]},
        {"type": "cylinder", "radius": (1e-3 / math.pi / 0.1) ** 0.5, "height": 0.1},
        {"type": "prism", "outline": [[0, 0], [0.2, 0], [0.2, 0.1], [0, 0.1]], "height": 0.05},
    ],
    ids=lambda shape: shape["type"],
)
def test_a_litre_that_no_metal_makes_as_heavy_is_doubted(shape):
    """Osmium, the densest, has 22.6 kg a litre; steel has 7.9."""
    for mass, pointers in ((7.9, []), (22.6, []), (850, ["/plate/mass", "/objects/0/mass"])):
        body = {"plate": {"shape": shape, "mass": mass}, "objects": [{"shape": shape, "mass": mass, "name": "box"}]}
        doubts = doubts_of(body)
        assert [doubt.pointer for doubt in doubts] == pointers
        assert all("850 kg a litre" in doubt.detail and "grams" in doubt.detail for doubt in doubts)


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ({"/start_positions": [15.0, -60.0, 120.0, -150.0, 0, 0, 0, 0, 0, 0, 0, 0]}, "rad: is it in degrees?"),
        ({"/options": {"goal_height": 30}}, "metres: is it in millimetres?"),
        ({"/plate/com_tolerance": 5}, "metres: is it in millimetres?"),
        ({"/plate/mass_tolerance": 2}, "a share: is it in per cent?"),
        ({"/plate/shape": {"type": "prism", "outline": DART, "height": 0.04}}, "options.pushes"),
        ({"/plate/shape": {"type": "cylinder", "radius": 0.1, "height": 0.04}}, "options.pushes"),
        ({"/obstacles": [{"name": "dart", "shape": {"type": "prism", "outline": DART, "height": 0.04}, "pose": POSE}]},
         "is given as a mesh"),
    ],
)  # fmt: skip
def test_what_is_refused_is_told_in_its_unit_and_with_what_helps(members, said):
    found = problems(changed(members, ()))
    assert found
    assert all(said in problem.detail for problem in found)


@pytest.mark.parametrize(
    "path", [("friction", "grip"), ("friction", "push"), ("friction", "environment"), ("cup", "mu")]
)
def test_more_friction_than_that_of_rubber_on_glass_is_doubted(path):
    of, member = path
    for value, pointers in ((0.5, []), (2.0, []), (5, [f"/{of}/{member}"]), ("5", []), (None, []), (math.nan, [])):
        assert [doubt.pointer for doubt in doubts_of({of: {member: value, "eps": 7.0}})] == pointers
        assert doubts_of({of: value}) == []


@pytest.mark.parametrize("mass", ["850", None, True, math.nan, -1.0, [850], 1e9])
def test_a_mass_or_a_shape_that_is_none_is_a_problem_and_no_doubt(mass):
    box = {"type": "box", "size": [0.1, 0.1, 0.1]}
    assert doubts_of({"plate": {"shape": box, "mass": mass}}) == []
    assert doubts_of({"plate": {"shape": {**box, "size": [mass] * 3}, "mass": 850.0}}) == []


DISC = {"type": "cylinder", "radius": 0.03, "height": 0.01}
OUTLINE = [[-0.03, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.03, 0.03]]


@pytest.mark.parametrize(
    ("shape", "reaches"),
    [
        (DISC, 0.03),
        ({"type": "box", "size": [0.06, 0.08, 0.01]}, 0.03),
        ({"type": "prism", "outline": OUTLINE, "height": 0.01}, 0.03),
    ],
    ids=lambda part: part["type"] if isinstance(part, dict) else "",
)  # fmt: skip
@pytest.mark.parametrize(
    "pose",
    [[0, 0, 0.005, *NO_TURN], [0, 0, 0.005, 0, 1, 0, 0], [0, 0, -0.005, *HALF_TURN]],
    ids=["up", "down", "turned"],
)
def test_a_pad_that_its_tools_shapes_leave_out_is_doubted(shape, reaches, pose):
    shaft = {"shape": {"type": "box", "size": [0.01, 0.01, 0.2]}, "pose": [0, 0, 0.1, *NO_TURN]}
    for radius, doubted in ((reaches, False), (reaches + 0.004, False), (reaches + 0.006, True)):
        cup = {"radius": radius, "max_force": 20.0}
        tool = {"shapes": [shaft, {"shape": shape, "pose": pose}], "mass": 0.2, "cup": cup}
        doubts = doubts_of({"kind": "suction_tool", "tool": tool})
        assert [doubt.pointer for doubt in doubts] == ["/tool/cup/radius"] * doubted
        assert all("reaches 6 mm beyond" in doubt.detail for doubt in doubts)


@pytest.mark.parametrize("turn", [NO_TURN, HALF_TURN, [0.5**0.5, 0.5**0.5, 0, 0], [0.5**0.5, 0, 0.5**0.5, 0]])
@pytest.mark.parametrize("gap", [-0.01, 0.0, 0.004, 0.006, 0.3])
def test_parts_of_a_tool_that_nothing_joins_to_its_pad_are_doubted(gap, turn):
    disc = {"shape": DISC, "pose": [0, 0, 0.005, *NO_TURN]}
    at = 0.01 + gap + 0.02
    block = {"shape": {"type": "box", "size": [0.04] * 3}, "pose": [0, 0, at, *turn]}
    # What is joined to what is apart is as far from the pad as that lets it be.
    handle = {"shape": {"type": "cylinder", "radius": 0.01, "height": 0.1}, "pose": [0, 0, at + 0.07, *NO_TURN]}
    for shapes, apart in (([disc, block, handle], [1, 2]), ([disc, handle, block], [1, 2]), ([disc, block], [1])):
        tool = {"shapes": shapes, "mass": 0.2, "cup": {"radius": 0.03, "max_force": 20.0}}
        doubts = doubts_of({"kind": "suction_tool", "tool": tool})
        assert [doubt.pointer for doubt in doubts] == [f"/tool/shapes/{number}" for number in apart if gap > 0.005]
        assert not doubts or any(f"hangs on that is {1e3 * gap:.0f} mm away" in doubt.detail for doubt in doubts)


def test_how_far_a_tool_of_meshes_reaches_and_a_tool_by_name_are_not_doubted():
    part = {"shape": {"type": "mesh", "upload": "0" * 64}, "pose": [0, 0, 0, *NO_TURN]}
    tool = {"shapes": [part], "mass": 0.2, "cup": {"radius": 0.5, "max_force": 20.0}}
    assert doubts_of({"kind": "suction_tool", "tool": tool}) == []
    assert doubts_of({"kind": "suction_tool", "tool": "long_symmetric"}) == []


@pytest.mark.parametrize("body", [None, [], "pose", {"pose": HALF_TURN}, {"pose": {"pose": "x"}}])
def test_what_is_no_task_is_not_doubted(body):
    assert doubts_of(body) == []
