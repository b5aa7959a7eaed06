"""The scene of a suction-tool task: what rests on what, and which goals are as good as the one given."""

import copy
import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from planners.cell.cell import load_cells
from planners.certify.settings import CertifySettings
from planners.contract.task_spec import read_task
from planners.errors import SceneError
from planners.geometry.pose import from_pose7, rotation_x, rotation_y, rotation_z, to_pose7, transform
from planners.planning import stated_bodies
from planners.scene.scene import build_scene
from planners.scene.suction_tool import known_tools, load_tool
from planners.scene.tool_placements import GOAL_OFF

TASKS = Path(__file__).parents[2] / "assets/tasks"
NAMES = ("domino_pile", "can_stack", "tissue_pile", "tissue_pile_short_tool", "lid_under_roof", "lid_too_heavy")
TABLE_TOP = 1.094
QUARTER = [0.5**0.5, 0, 0, 0.5**0.5]


@pytest.fixture(scope="module")
def build():
    cells = load_cells()
    return lambda body: build_scene(read_task(body), cells)


def task(name, **changes):
    return {**json.loads((TASKS / f"{name}.json").read_text()), **changes}


def box(name, size, pose, goal, **more):
    shape = {"type": "box", "size": list(size)}
    return {"name": name, "shape": shape, "mass": 0.1, "pose": list(pose), "goal_pose": list(goal), **more}


def lowest(body, T_world_body):
    vertices, _ = body.solid.surface()
    return float((vertices @ T_world_body[2, :3] + T_world_body[2, 3]).min())


@pytest.mark.parametrize("name", NAMES)
def test_every_object_stands_on_its_support_at_the_start_and_at_its_goal(name, build):
    scene = build(task(name))
    tops = {"table": TABLE_TOP}
    for moved in sorted(scene.objects, key=lambda moved: moved.T_world_goal[2, 3]):
        assert lowest(moved.body, moved.body.T_world_body) == pytest.approx(TABLE_TOP, abs=1e-9)
        assert moved.start_supports == ("table",)
        (support,) = moved.goal_supports
        bottom = lowest(moved.body, moved.T_world_goal)
        assert bottom == pytest.approx(tops[support], abs=1e-9)
        tops[moved.name] = bottom + np.ptp(moved.body.solid.surface()[0][:, 2])


def test_the_tool_stands_in_the_cells_rest_unless_told_otherwise(build):
    scene = build(task("domino_pile"))
    assert scene.tool.T_world_tool == pytest.approx(scene.cell.tool_rest.T_world_tool)
    assert scene.tool.supports == ("table",)
    standing = build(task("domino_pile", tool_pose=[0.4, -0.1, TABLE_TOP, 1, 0, 0, 0]))
    assert standing.tool.T_world_tool == pytest.approx(from_pose7([0.4, -0.1, TABLE_TOP, 1, 0, 0, 0]))


@pytest.mark.parametrize("tool", known_tools())
def test_a_tool_that_the_rest_is_too_narrow_for_is_refused_until_it_is_said_where_it_stands(tool, build):
    (*_, height), tall = np.ptp(load_tool(tool).body.solid.surface()[0], axis=0), 0.05
    vertices = np.vstack([part.vertices for part in load_tool(tool).body.solid.convex_parts])
    half = np.abs(vertices[vertices[:, 2] < tall][:, :2]).max()
    assert height > tall
    body = task("domino_pile", tool=tool)
    room = load_cells()["dual_ur3e_tool"].tool_rest
    clearance = min(wall.center[0] - 0.5 * wall.size[0] for wall in room.walls if wall.name.endswith("front"))
    if half <= clearance - room.T_world_tool[0, 3] + 1e-3:
        build(body)
        return
    with pytest.raises(SceneError, match=r"does not take this one: .* say where it stands") as caught:
        build(body)
    assert caught.value.pointer == "/tool_pose"
    build({**body, "tool_pose": [0.5, -0.6, TABLE_TOP, 1, 0, 0, 0]})


@pytest.mark.parametrize("tool", ["long_symmetric", "short_asymmetric"])
@pytest.mark.parametrize("turn", [rotation_y(np.pi / 2), rotation_x(np.pi / 2), rotation_y(2.0), rotation_x(np.pi)])
def test_the_pose_that_a_refusal_advises_is_one_in_which_the_tool_rests(tool, turn, build):
    askew = to_pose7(transform(turn @ rotation_x(0.05), [0.42, 0.0, 1.25]))
    with pytest.raises(SceneError, match="would rest at") as caught:
        build(task("domino_pile", tool=tool, tool_pose=askew))
    advised = json.loads(re.search(r"rest at (\[.*\])", caught.value.detail).group(1))
    scene = build(task("domino_pile", tool=tool, tool_pose=advised))
    assert lowest(scene.tool.body, scene.tool.T_world_tool) == pytest.approx(TABLE_TOP, abs=1e-9)
    assert scene.tool.T_world_tool == pytest.approx(from_pose7(advised), abs=1e-5)


@pytest.mark.parametrize("height", [0.0, 0.5, TABLE_TOP - 0.1, TABLE_TOP + 0.1])
def test_what_is_above_or_below_the_table_is_advised_onto_it(height, build):
    """Never onto what stands below the table: who counts heights from the table means the table."""
    body = task("domino_pile")
    body["objects"][0]["pose"] = [0.3, 0.3, height, 1, 0, 0, 0]
    with pytest.raises(SceneError, match="on table it would rest at") as caught:
        build(body)
    body["objects"][0]["pose"] = json.loads(re.search(r"rest at (\[.*?\])", caught.value.detail).group(1))
    assert build(body).objects[0].start_supports == ("table",)


@pytest.mark.parametrize(("inside", "is_refused"), [(-0.0001, True), (0.0, True), (0.0009, True), (0.0011, False)])
def test_nothing_is_brought_to_where_a_millimetre_off_it_would_tip_over(inside, is_refused, build):
    """The table ends at x = 0.85 m. What stands at such a place and stays there is not asked to move."""
    assert CertifySettings().goal_distance == GOAL_OFF
    edge = [0.85 - inside, 0.3, TABLE_TOP + 0.025, 1, 0, 0, 0]
    moved = box("chip", [0.06, 0.04, 0.05], [0.5, 0.3, *edge[2:]], edge)
    if is_refused:
        with pytest.raises(SceneError, match="tip over: its centre of mass is") as caught:
            build(task("domino_pile", objects=[moved]))
        assert caught.value.pointer == "/objects/0/goal_pose"
    else:
        build(task("domino_pile", objects=[moved]))
    if inside >= 0.0:
        build(task("domino_pile", objects=[{**moved, "pose": edge}]))


def test_a_move_that_is_told_ends_in_nothing_else(build):
    """Posts in and about the tool's rest: moved as told, none is deep in anything of the cell any more."""
    rng, told = np.random.default_rng(0), 0
    for _ in range(30):
        radius, (x, y) = rng.uniform(0.01, 0.04), rng.uniform([0.16, -0.08], [0.3, 0.08])
        shape = {"type": "cylinder", "radius": radius, "height": 0.3}
        post = {"name": "post", "shape": shape, "pose": [x, y, TABLE_TOP + 0.15, 1, 0, 0, 0]}
        faults = faults_of(build, task("domino_pile", obstacles=[post]))
        moves = [MOVED.search(fault) for fault in faults if "deep in tool_rest" in fault]
        for far, sign, axis in (move.groups() for move in moves if move is not None):
            told += 1
            place = np.array(post["pose"])
            place["xyz".index(axis)] += float(f"{sign}{far}") * 1e-3
            left = faults_of(build, task("domino_pile", obstacles=[{**post, "pose": place.tolist()}]))
            assert not [fault for fault in left if "post is" in fault and "deep in" in fault]
    assert told > 5


MOVED = re.compile(r"moved ([0-9.]+) mm towards the world's ([+-])([xyz]), post is clear of")


def faults_of(build, body):
    try:
        build(body)
    except SceneError as refused:
        return [fault.detail for fault in refused.all]
    return []


def test_an_object_a_little_off_what_carries_it_is_settled_onto_it(build):
    body = task("domino_pile")
    body["objects"][0]["pose"] = to_pose7(transform(rotation_x(0.001), [0.3, 0.3, TABLE_TOP + 0.0105]))
    body["objects"][2]["goal_pose"][2] += 0.0009
    scene = build(body)
    first, _, last = scene.objects
    assert first.body.T_world_body == pytest.approx(from_pose7([0.3, 0.3, TABLE_TOP + 0.01, 1, 0, 0, 0]), abs=1e-12)
    assert last.T_world_goal[2, 3] == pytest.approx(TABLE_TOP + 0.05, abs=1e-12)


def test_offsets_do_not_add_up_in_a_pile(build):
    body = task("domino_pile")
    body["objects"][1]["goal_pose"][2] += 0.0009
    body["objects"][2]["goal_pose"][2] += 0.0018
    with pytest.raises(SceneError, match=r"1\.8 mm above the top of domino_2"):
        build(body)


def test_a_goal_may_bridge_two_others_and_stick_out_over_an_edge(build):
    body = task("domino_pile")
    for one, y in zip(body["objects"], (-0.05, 0.05, 0.02), strict=True):
        one["goal_pose"] = [0.45, y, TABLE_TOP + 0.01, 1, 0, 0, 0]
    body["objects"][2]["goal_pose"] = [0.48, 0.0, TABLE_TOP + 0.03, 0.5**0.5, 0, 0, 0.5**0.5]
    assert build(body).objects[2].goal_supports == ("domino_1", "domino_2")


def test_objects_may_start_on_one_another_and_on_obstacles(build):
    board = {"name": "board", "shape": {"type": "box", "size": [0.2, 0.2, 0.03]}, "pose": [0.55, 0, 1.109, 1, 0, 0, 0]}
    body = task("domino_pile", obstacles=[board])
    body["objects"][0]["pose"] = [0.55, 0, TABLE_TOP + 0.06, 1, 0, 0, 0]
    body["objects"][1]["pose"] = [0.55, 0, TABLE_TOP + 0.04, 1, 0, 0, 0]
    one, other, _ = build(body).objects
    assert (one.start_supports, other.start_supports) == (("domino_2",), ("board",))


def turns_of(build, shape, symmetry, height, com=(0, 0, 0)):
    pose = [0.45, 0.0, TABLE_TOP + height / 2, 1, 0, 0, 0]
    one = {"name": "one", "shape": shape, "mass": 0.1, "com": list(com), "goal_symmetry": symmetry}
    return build(task("domino_pile", objects=[{**one, "pose": pose, "goal_pose": pose}])).objects[0]


HEXAGON = [[0.05 * np.cos(k * np.pi / 3), 0.05 * np.sin(k * np.pi / 3)] for k in range(6)]


@pytest.mark.parametrize(
    ("shape", "count"),
    [
        ({"type": "box", "size": [0.1, 0.08, 0.06]}, 4),
        ({"type": "box", "size": [0.08, 0.08, 0.06]}, 8),
        ({"type": "box", "size": [0.06, 0.08, 0.06]}, 8),
        ({"type": "box", "size": [0.06, 0.06, 0.06]}, 24),
        ({"type": "prism", "outline": HEXAGON, "height": 0.06}, 12),
        ({"type": "prism", "outline": [[0, 0], [0.1, 0], [0, 0.07]], "height": 0.06}, 1),
        ({"type": "prism", "outline": [[0, 0], [0.1, 0], [0, 0.1]], "height": 0.06}, 2),
        ({"type": "cylinder", "radius": 0.04, "height": 0.06}, 48),
    ],
)
def test_turns_of_a_shapes_symmetry_are_all_that_take_it_to_itself(shape, count, build):
    moved = turns_of(build, shape, "shape", 0.06)
    assert len(moved.goal_turns) == count
    assert moved.goal_turns[0] == pytest.approx(np.eye(4))
    vertices, _ = moved.body.solid.surface()
    corners = KDTree(vertices)
    for turn in moved.goal_turns:
        assert np.linalg.det(turn[:3, :3]) == pytest.approx(1)
        distances, _ = corners.query(vertices @ turn[:3, :3].T + turn[:3, 3])
        assert distances.max() < 1e-5 + (1e-4 if shape["type"] == "cylinder" else 0)
    assert len({tuple(np.round(turn[:3, :3], 4).ravel() + 0.0) for turn in moved.goal_turns}) == count


def test_turns_about_the_axis_are_kept_where_the_object_still_rests(build):
    assert len(turns_of(build, {"type": "box", "size": [0.1, 0.08, 0.06]}, "axis", 0.06).goal_turns) == 24
    lying = copy.deepcopy(task("domino_pile"))
    pose = to_pose7(transform(rotation_x(np.pi / 2), [0.45, 0.0, TABLE_TOP + 0.04]))
    lying["objects"] = [box("one", (0.1, 0.08, 0.06), pose, pose, goal_symmetry="axis")]
    (moved,) = build(lying).objects
    # On its side it rests on a face every quarter turn, but only half turns leave it at the same height.
    angles = sorted(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])) % 360 for turn in moved.goal_turns)
    assert angles == pytest.approx([0, 180])


def test_a_turned_goal_in_an_obstacle_is_none(build):
    post = {
        "name": "post",
        "shape": {"type": "box", "size": [0.02, 0.02, 0.1]},
        "pose": [0.45, 0.055, 1.144, 1, 0, 0, 0],
    }
    pose = [0.45, 0.0, TABLE_TOP + 0.01, 1, 0, 0, 0]
    one = box("one", (0.13, 0.07, 0.02), pose, pose, goal_symmetry="axis")
    (moved,) = build(task("domino_pile", objects=[one], obstacles=[post])).objects
    assert 1 <= len(moved.goal_turns) < 24
    for turn in moved.goal_turns:
        x, y, _ = moved.T_world_goal[:3, :3] @ turn[:3, 0]
        corner = np.abs([x * 0.0 + y * 0.055, -y * 0.0 + x * 0.055])
        assert corner[0] > 0.065 or corner[1] > 0.035


def test_no_symmetry_means_the_goal_as_given(build):
    goal = transform(rotation_z(0.3), [0.45, 0.0, TABLE_TOP + 0.03])
    one = box("one", (0.06, 0.06, 0.06), [0.45, 0.2, TABLE_TOP + 0.03, 1, 0, 0, 0], to_pose7(goal))
    (moved,) = build(task("domino_pile", objects=[one])).objects
    assert moved.goals == pytest.approx(goal[None])


def test_the_document_lists_tool_and_objects_with_all_their_data(build):
    scene = build(task("domino_pile"))
    bodies = stated_bodies(scene)
    assert {name: bodies[name].role for name in ("tool", "domino_1", "tool_rest_left", "table")} == {
        "tool": "tool", "domino_1": "object", "tool_rest_left": "frame", "table": "table",
    }  # fmt: skip
    assert bodies["tool"].shape.type == "mesh"
    assert len(bodies["tool"].shape.convex_parts) == 4


def test_a_tool_that_was_loaded_before_stands_as_one_that_is_read_from_its_file():
    cells = load_cells()
    body = read_task(task("domino_pile"))
    loaded = load_tool(body.tool)
    read, given = build_scene(body, cells), build_scene(body, cells, tools={body.tool: loaded})
    assert given.tool.body.solid is loaded.body.solid
    np.testing.assert_array_equal(given.tool.T_world_tool, read.tool.T_world_tool)
    assert (given.tool.name, given.tool.supports) == (read.tool.name, read.tool.supports)


def test_a_goal_is_turned_only_where_what_is_to_rest_on_it_still_does(build):
    size = (0.13, 0.07, 0.02)
    lower = box("lower", size, [0.36, 0.2, TABLE_TOP + 0.01, 1, 0, 0, 0], [0.45, 0, TABLE_TOP + 0.01, *QUARTER])
    upper = box("upper", size, [0.36, -0.25, TABLE_TOP + 0.01, *QUARTER], [0.45, 0.06, TABLE_TOP + 0.03, 1, 0, 0, 0])
    lower["goal_symmetry"] = "axis"
    alone, _ = build(task("domino_pile", objects=[lower, {**upper, "goal_pose": upper["pose"]}])).objects
    carrying, _ = build(task("domino_pile", objects=[lower, upper])).objects
    assert len(alone.goal_turns) == 24
    kept = [np.degrees(np.arctan2(turn[1, 0], turn[0, 0])) for turn in carrying.goal_turns]
    # The upper one's centre of mass is 60 mm from the lower one's middle, 5 mm inside its end: over the turned one it
    # is as long as 60 mm along its long sides' direction, turned, are within it.
    over = [angle for angle in range(-165, 181, 15) if 0.06 * abs(np.sin(np.radians(angle))) <= 0.035]
    assert sorted(round(angle) for angle in kept) == over
