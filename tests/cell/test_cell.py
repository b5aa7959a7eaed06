"""Cells: what is shipped, what is never checked for collision, and cells of one's own."""

from __future__ import annotations

import datetime
import itertools
import shutil

import fcl
import numpy as np
import pytest
import yaml

from assets import assets_folder
from planners.cell.cell import Cell, known_cells, load_cell
from planners.errors import AssetError
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import from_pose7, pose_row, rotation_x, rotation_z
from tests.cell.cell_probe import cell_frames, fcl_distance, fcl_object
from tests.support.documents import bodies_of, cell_of
from tests.support.own_cell import load_cell_file


@pytest.fixture(scope="module", params=["dual_ur3e_lift", "dual_ur3e_tool"])
def cell(request) -> Cell:
    return load_cell(request.param)


@pytest.fixture
def shelf(tmp_path):
    """Copy the shipped assets into a folder that a test may spoil."""
    for kind in ("robots", "hands", "sensors", "mounts", "cells"):
        shutil.copytree(assets_folder() / kind, tmp_path / kind)
    return tmp_path


def edit(path, keys, value):
    """Replace the member that `keys` lead to; None of the file's other members change."""
    data = yaml.safe_load(path.read_text())
    owner = data
    for key in keys[:-1]:
        owner = owner[key]
    owner[keys[-1]] = value
    path.write_text(yaml.safe_dump(data))


def checked_pairs(cell: Cell) -> list[tuple[CollisionBody, CollisionBody]]:
    pairs = itertools.combinations(cell.collision_bodies(), 2)
    return [(a, b) for a, b in pairs if tuple(sorted((a.name, b.name))) not in cell.excluded_pairs]


def test_both_cells_of_the_contract_are_shipped():
    assert {"dual_ur3e_lift", "dual_ur3e_tool"} <= set(known_cells())


def test_bases_and_table_are_where_the_lab_says(cell):
    left, right = (cell.arms[name].T_world_base for name in ("left", "right"))
    np.testing.assert_allclose(left[:3, 3], [0.0, 0.258485, 1.610515])
    np.testing.assert_allclose(right[:3, 3], [0.0, -0.258485, 1.610515])
    np.testing.assert_allclose(left[:3, :3], rotation_x(np.radians(-135)), atol=1e-15)
    np.testing.assert_allclose(right[:3, :3], rotation_x(np.radians(135)) @ rotation_z(np.pi), atol=1e-15)
    assert cell.table_top == pytest.approx(1.094)


def test_base_axes_point_outward_and_down(cell):
    for name, outward in (("left", 1.0), ("right", -1.0)):
        axis = cell.arms[name].T_world_base[:3, 2]
        np.testing.assert_allclose(axis, [0.0, outward * np.sqrt(0.5), -np.sqrt(0.5)], atol=1e-15)


def test_home_is_symmetric_about_the_middle(cell):
    """Every flange point and approach axis of one arm is the other's in the mirror."""
    frames = cell_frames(cell, cell.home)
    mirror = np.array([1.0, -1.0, 1.0])
    for i in range(7):
        left, right = frames[f"left/{i}"], frames[f"right/{i}"]
        np.testing.assert_allclose(right[:3, 3], mirror * left[:3, 3], atol=1e-12)
    np.testing.assert_allclose(frames["right/6"][:3, 2], mirror * frames["left/6"][:3, 2], atol=1e-12)


def test_home_is_free_of_collision_at_every_opening(cell):
    frames = cell_frames(cell, cell.home)
    for width in (0.0, 0.04, 0.085):
        bodies = {body.name: body for body in cell.collision_bodies(dict.fromkeys(cell.gripper_arms, width))}
        objects = {name: fcl_object(body, frames[body.frame]) for name, body in bodies.items()}
        for a, b in checked_pairs(cell):
            assert fcl_distance(objects[a.name], objects[b.name]) > 0.01, (a.name, b.name)


def test_pairs_are_excluded_because_nothing_moves_them_or_because_they_are_neighbours(cell):
    frames = {body.name: body.frame for body in cell.collision_bodies()}
    for pair in cell.excluded_pairs:
        assert list(pair) == sorted(pair)
        a, b = (frames[name] for name in pair)
        both_fixed = {a, b} <= {"world", "left/0", "right/0"}
        neighbours = a[:-1] == b[:-1] and abs(int(a[-1]) - int(b[-1])) <= 1 if "world" not in (a, b) else False
        assert both_fixed or neighbours, pair
    two_joints_apart = {(f"{arm}_forearm", f"{arm}_wrist_2") for arm in cell.arms}
    assert not two_joints_apart & cell.excluded_pairs


def test_what_is_mounted_on_the_flange_cannot_reach_its_neighbour(cell):
    """A plane square to the last joint's axis parts wrist 2 from sensor and hand, however that joint turns."""
    for name, arm in cell.arms.items():
        neighbour, own = f"{name}_wrist_2", f"{name}_wrist_3"
        bodies = {body.name: body for body in cell.collision_bodies() if body.group == name}
        # Frame 5 has the axis of joint 6 as its z; frame 6 is d6 farther along it.
        highest = bodies[neighbour].shapes[0].vertices[:, 2].max() - arm.dh[5, 2]
        for body in bodies.values():
            if body.frame == f"{name}/6" and body.name != own:
                shape = body.shapes[0]
                assert shape.vertices[:, 2].min() - shape.radius > highest


def test_the_arms_are_checked_against_each_other_and_against_the_cell(cell):
    checked = {(a.name, b.name) for a, b in checked_pairs(cell)}
    bodies = cell.collision_bodies()
    moving = {body.name: body.group for body in bodies if body.frame not in ("world", "left/0", "right/0")}
    for a, b in itertools.combinations([body.name for body in bodies], 2):
        groups = moving.get(a), moving.get(b)
        if groups != (None, None) and groups[0] != groups[1] and "base" not in a + b:
            assert (a, b) in checked


def test_a_hand_that_reaches_through_the_table_is_found(cell):
    """Excluded pairs leave no hole where it matters: fingers and tip against the table, hand against hand."""
    pairs = {(a.name, b.name) for a, b in checked_pairs(cell)}
    reaching = "left_tip" if "left" in cell.pusher_arms else "left_pad_0"
    assert (reaching, "table") in pairs
    assert (reaching, "right_pad_1") in pairs
    assert ("right_wrist_3", "table") in pairs


def test_the_cells_differ_in_their_hands_and_the_tool_rest_only():
    lift, tool = load_cell("dual_ur3e_lift"), load_cell("dual_ur3e_tool")
    assert (lift.gripper_arms, lift.pusher_arms) == (("right",), ("left",))
    assert (tool.gripper_arms, tool.pusher_arms) == (("left", "right"), ())
    one, other = cell_of(lift), cell_of(tool)
    for document in (one, other):
        document.pop("hands"), document.pop("name"), document.pop("hash")
    assert one == other
    rest = {wall.name for wall in tool.tool_rest.walls}
    assert lift.tool_rest is None
    assert bodies_of(tool) == bodies_of(lift) | {name: bodies_of(tool)[name] for name in rest}
    np.testing.assert_array_equal(lift.home, tool.home)
    assert lift.hash != tool.hash


def test_the_document_says_all_that_the_contract_lists(cell):
    document = cell_of(cell)
    assert set(document) == {"name", "hash", "gravity", "arms", "hands"}
    for name, arm in document["arms"].items():
        limits = {"position_min", "position_max", "velocity_max", "acceleration_max", "payload"}
        assert set(arm) == {"base", "dh", "torque_max", "links"} | limits
        np.testing.assert_allclose(from_pose7(arm["base"]), cell.arms[name].T_world_base, atol=1e-12)
        np.testing.assert_array_equal(arm["dh"], cell.arms[name].dh)
        assert arm["torque_max"] == [54.0, 54.0, 28.0, 9.0, 9.0, 9.0]
        assert arm["links"][1] == {"mass": 3.4445, "com": [0.13, 0.0, 0.1157]}
        mass, *com = cell.arms[name].masses[6]
        assert (document["hands"][name]["mass"], document["hands"][name]["com"]) == (mass, com)
    assert len(cell.joint_names) == len(set(cell.joint_names)) == 12
    assert cell.joint_names[0] == "left_shoulder_pan_joint"
    assert cell.joint_names[-1] == "right_wrist_3_joint"


def test_documented_bodies_are_the_ones_that_are_checked(cell):
    for name, document in bodies_of(cell).items():
        body = next(body for body in cell.bodies if body.name == name)
        T = from_pose7(document["pose"])
        box = fcl.CollisionObject(fcl.Box(*document["shape"]["size"]), fcl.Transform(T[:3, :3], T[:3, 3]))
        size = np.ptp(body.shapes[0].vertices, axis=0)
        np.testing.assert_allclose(size, document["shape"]["size"])
        np.testing.assert_allclose(body.shapes[0].vertices.mean(axis=0), T[:3, 3], atol=1e-12)
        assert fcl_distance(box, fcl_object(body, np.eye(4))) <= 0.0
        assert document["role"] == ("table" if name == "table" else "frame")


@pytest.mark.slow
def test_the_same_files_have_the_same_hash_and_any_changed_number_another(shelf):
    path = shelf / "cells" / "dual_ur3e_lift.yaml"
    assert load_cell_file(path).hash == load_cell("dual_ur3e_lift").hash
    edit(shelf / "robots" / "ur3e.yaml", ["joints", 0, "torque"], 55.0)
    assert load_cell_file(path).hash != load_cell("dual_ur3e_lift").hash


def test_bases_table_and_frame_can_stand_elsewhere(shelf):
    mount = shelf / "mounts" / "dual_column.yaml"
    edit(mount, ["arms", "left", "position"], [0.1, 0.5, 1.2])
    edit(mount, ["arms", "left", "rpy_deg"], [0, 0, 90])
    edit(mount, ["table", "center"], [0.6, 0.1, 0.9])
    edit(mount, ["frame", "columns"], [[-0.5, 0.7]])
    cell = load_cell_file(shelf / "cells" / "dual_ur3e_lift.yaml")
    np.testing.assert_allclose(cell.arms["left"].T_world_base[:3, 3], [0.1, 0.5, 1.2])
    np.testing.assert_allclose(cell.arms["left"].T_world_base[:3, :3], rotation_z(np.pi / 2), atol=1e-15)
    assert cell.table_top == pytest.approx(0.912)
    column = next(body for body in cell.bodies if body.name == "frame_0").shapes[0].vertices
    np.testing.assert_allclose([column.min(axis=0), column.max(axis=0)], [[-0.53, 0.67, 0.0], [-0.47, 0.73, 2.4]])
    shipped = load_cell("dual_ur3e_lift")
    np.testing.assert_array_equal(cell.arms["right"].T_world_base, shipped.arms["right"].T_world_base)


@pytest.mark.slow
def test_a_robot_may_be_mounted_with_another_frame_than_that_before_its_first_joint(shelf):
    """An arm turned by 90 degrees on its foot, and mounted turned back, stands where it stood."""
    robot, mount = shelf / "robots" / "ur3e.yaml", shelf / "mounts" / "dual_column.yaml"
    edit(mount, ["arms", "left"], {"position": [0.1, 0.2, 1.5], "rpy_deg": [0, 0, 0], "home_deg": [0] * 6})
    edit(robot, ["base"], {"position": [0, 0, 0.3], "rpy_deg": [0, 0, 90]})
    turned = load_cell_file(shelf / "cells" / "dual_ur3e_lift.yaml")
    edit(robot, ["base"], None)
    edit(mount, ["arms", "left"], {"position": [0.1, 0.2, 1.8], "rpy_deg": [0, 0, 90], "home_deg": [0] * 6})
    upright = load_cell_file(shelf / "cells" / "dual_ur3e_lift.yaml")
    np.testing.assert_allclose(turned.arms["left"].T_world_base, upright.arms["left"].T_world_base, atol=1e-15)
    np.testing.assert_array_equal(turned.arms["left"].document().base, pose_row(turned.arms["left"].T_world_base))


def test_arms_can_be_other_robots_and_swap_their_hands(shelf):
    path = shelf / "cells" / "dual_ur3e_lift.yaml"
    edit(path, ["arms", "left"], {"robot": "ur3", "hand": "robotiq_2f85_ft300"})
    edit(path, ["arms", "right", "hand"], "pushing_stick_ft300")
    cell = load_cell_file(path)
    assert (cell.gripper_arms, cell.pusher_arms) == (("left",), ("right",))
    assert cell.arms["left"].robot.name == "ur3"
    assert cell.arms["right"].robot.name == "ur3e"


def test_a_cell_of_ones_own_may_name_shipped_parts(tmp_path):
    (tmp_path / "cells").mkdir()
    path = tmp_path / "cells" / "mine.yaml"
    text = (assets_folder() / "cells" / "dual_ur3e_lift.yaml").read_text()
    path.write_text(text.replace("dual_ur3e_lift", "mine"))
    assert load_cell_file(path).name == "mine"


A_JOINT = {
    **{"name": "joint", "a": 0.1, "alpha_deg": 0, "d": 0.1, "theta0_deg": 0},
    **{"position_deg": [-170, 170], "velocity_deg": 90, "acceleration": 5, "torque": 10},
}
WRONG = {
    "an unknown field": ("cells/dual_ur3e_lift", ["color"], "red", "/color: is not known here"),
    "two sticks": (
        "cells/dual_ur3e_lift",
        ["arms", "right", "hand"],
        "pushing_stick_ft300",
        "/arms: two sticks hold nothing: a plate lift needs a gripper and a stick",
    ),
    "a string for a number": (
        "mounts/dual_column",
        ["table", "size", 0],
        "0.8",
        "/table/size/0: must be a number",
    ),
    "a boolean for a number": ("robots/ur3e", ["payload"], True, "/payload: must be a number"),
    "not a number": ("mounts/dual_column", ["table", "center", 2], float("nan"), "/table/center/2: must be a number"),
    "a flat table": ("mounts/dual_column", ["table", "size", 2], 0.0, "/table/size/2: must be greater than 0"),
    "no joints": ("robots/ur3e", ["joints"], [], "/joints: "),
    "seven joints": ("robots/ur3e", ["joints"], [A_JOINT] * 7, "/joints: 7 are listed. An arm has six joints here"),
    "a range of many turns": ("robots/ur3e", ["joints", 5, "position_deg", 1], 2700, "less than or equal to 540"),
    "an angle beyond half a turn": ("robots/ur3e", ["joints", 0, "alpha_deg"], 270, "less than or equal to 180"),
    "limits the wrong way round": (
        "robots/ur3e",
        ["joints", 2, "position_deg"],
        [180, -180],
        "/joints/2: position_deg must list the lower limit first",
    ),
    "an arm of another family": ("robots/ur3e", ["joints", 1, "alpha_deg"], 90, "alpha 2 is 90 deg, not 0 or 180"),
    "links in another order": ("robots/ur3e", ["links", 0, "name"], "forearm", "/links: base is missing"),
    "a link without a centre of mass": (
        "robots/ur3e",
        ["masses", 2],
        {"name": "forearm", "mass": 1.437},
        "/masses/2/com: is required",
    ),
    "a link twice": (
        "robots/ur3e",
        ["links", 1],
        {"name": "base", "cylinders": [{"start": [0, 0, 0], "end": [0, 0, 1], "radius": 1}]},
        "/links: shoulder is missing",
    ),
    "a table that is a mesh": (
        "mounts/dual_column",
        ["table"],
        {"mesh": {"path": "meshes/table.stl"}, "position": [0, 0, 0], "rpy_deg": [0, 0, 0]},
        "/table: the table is a box, by center and size",
    ),
    "an umlaut": (
        "mounts/dual_column",
        ["platform"],
        {"Säule": {"center": [0, 0, 0], "size": [1, 1, 1]}},
        "must be 1 to 64 letters from A to Z or a to z, digits",
    ),
    "a path with a blank": (
        "hands/robotiq_2f85_ft300",
        ["meshes", "base", "path"],
        "my base.obj",
        "/meshes/base/path: must be a path inside the cell's folder: letters from A to Z",
    ),
    "links without masses": ("robots/ur3e", ["masses"], [], "/masses: "),
    "masses in another order": ("robots/ur3e", ["masses", 5, "name"], "base", "/masses: wrist_3 is missing"),
    "a mesh that is not there": (
        "robots/ur3e",
        ["links", 4, "mesh", "path"],
        "arms/none.obj",
        "/links/4: the package 'airo_models' ships no arms/none.obj",
    ),
    "a mesh that is no mesh": (
        "hands/robotiq_2f85_ft300",
        ["meshes", "base", "path"],
        "files.py",
        "/meshes/base: files.py of the package 'airo_models' spans no volume",
    ),
    "an unknown package": (
        "hands/robotiq_2f85_ft300",
        ["meshes", "base", "package"],
        "no_models",
        "/meshes/base/package: is none of the valid choices",
    ),
    "a linkage that cannot close": (
        "hands/robotiq_2f85_ft300",
        ["linkage", "outer_knuckle"],
        [0.2, 0.05],
        "/linkage: the pads are never 0.0 m apart",
    ),
    "a hand of no kind": ("hands/pushing_stick_ft300", ["kind"], "hook", "/kind: must be one of gripper, jaws, stick"),
    "a stick inside its sensor": (
        "hands/pushing_stick_ft300",
        ["tip_distance"],
        0.05,
        "/tip_distance: leaves no stick",
    ),
    "an unknown hand": ("cells/dual_ur3e_lift", ["arms", "left", "hand"], "hook", "/arms/left/hand: no file 'hook'"),
    "an unknown sensor": ("hands/pushing_stick_ft300", ["sensor"], "ft9", "/sensor: no file 'ft9' among the sensors"),
    "an unknown robot": ("cells/dual_ur3e_lift", ["arms", "left", "robot"], "ur9", ", ur10, "),
    "an unknown mount": ("cells/dual_ur3e_lift", ["mount"], "wall", "/mount: no file 'wall'"),
    "a third arm": (
        "cells/dual_ur3e_lift",
        ["arms", "middle"],
        {"robot": "ur3", "hand": "x"},
        "/arms/middle: is none of the valid choices",
    ),
    "one arm": ("mounts/dual_column", ["arms"], {}, "arms.left is required"),
    "a name that is not the file's": ("mounts/dual_column", ["name"], "wall", "/name: must be that of the file"),
    "a date": ("cells/dual_ur3e_lift", ["gravity"], [0, 0, datetime.date(2026, 1, 1)], "/gravity/2: must be a number"),
}


def test_a_number_that_is_wrong_is_no_list_that_is_too_short(shelf):
    edit(shelf / "robots" / "ur3e.yaml", ["masses", 2, "mass"], -1.0)
    with pytest.raises(AssetError) as caught:
        load_cell_file(shelf / "cells" / "dual_ur3e_lift.yaml")
    assert {fault.pointer for fault in caught.value.faults} == {"/masses/2/mass"}


@pytest.mark.parametrize(("file", "keys", "value", "message"), WRONG.values(), ids=WRONG.keys())
def test_a_wrong_file_is_refused_with_the_names_of_file_and_field(shelf, file, keys, value, message):
    path = shelf / f"{file}.yaml"
    edit(path, keys, value)
    with pytest.raises(AssetError) as caught:
        load_cell_file(shelf / "cells" / "dual_ur3e_lift.yaml")
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.slow
def test_a_hand_that_an_arm_cannot_bear_is_refused_with_both_masses(shelf):
    path = shelf / "cells" / "dual_ur3e_lift.yaml"
    edit(shelf / "robots" / "ur3e.yaml", ["payload"], 1.3)
    assert load_cell_file(path).arms["right"].spare_payload == pytest.approx(1.3 - 0.300 - 0.905)
    edit(shelf / "robots" / "ur3e.yaml", ["payload"], 1.2)
    with pytest.raises(AssetError, match=r"/arms/right/hand: robotiq_2f85_ft300 weighs 1\.205 kg, and ur3e bears 1\.2"):
        load_cell_file(path)


@pytest.mark.parametrize("text", ["- a\n- b\n", "a: [1\n", "", "\xff\xfe"])
def test_a_file_that_is_no_mapping_is_refused_by_name(shelf, text):
    path = shelf / "mounts" / "dual_column.yaml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(AssetError, match=r"dual_column\.yaml: (must be a mapping|the file is not (YAML|UTF-8))"):
        load_cell_file(shelf / "cells" / "dual_ur3e_lift.yaml")


def test_an_unknown_cell_is_refused_with_the_ones_there_are():
    with pytest.raises(
        AssetError, match=r"no file 'none' among the cells; there are: .*dual_ur3e_lift, dual_ur3e_tool"
    ):
        load_cell("none")


def test_a_missing_cell_file_is_refused_by_its_path(tmp_path):
    with pytest.raises(AssetError, match=r"none\.yaml: cannot be read"):
        load_cell_file(tmp_path / "cells" / "none.yaml")
