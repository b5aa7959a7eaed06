"""The scene of a plate lift: what stands where, and that overlaps at the start are those another library finds."""

import copy
import json
import math
import re
from collections import Counter
from contextlib import nullcontext
from pathlib import Path

import fcl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial import ConvexHull

from planners.cell.cell import load_cells
from planners.contract.task_spec import read_task
from planners.errors import SceneError
from planners.geometry.convex import CollisionBody, ConvexShape
from planners.geometry.pose import frame_from_z, from_pose7, rotation_angle
from planners.planning import stated_bodies
from planners.scene.clashes import BodiesOverlap, BodyInCell, CellAtStart, depth, gap, placed_body
from planners.scene.scene import build_scene

ALL_TASKS = sorted((Path(__file__).parents[2] / "assets/tasks").glob("*.json"))
TASKS = [path for path in ALL_TASKS if json.loads(path.read_text())["kind"] == "plate_lift"]
AB1 = json.loads((Path(__file__).parents[2] / "assets/tasks/ab1.json").read_text())
AB3 = json.loads((Path(__file__).parents[2] / "assets/tasks/ab3.json").read_text())
DOMINO_PILE = json.loads((Path(__file__).parents[2] / "assets/tasks/domino_pile.json").read_text())
TABLE_TOP = 1.094


@pytest.fixture(scope="module")
def cells():
    return load_cells()


@pytest.fixture(scope="module")
def build(cells):
    return lambda body: build_scene(read_task(body), cells)


def obstacle(name, size, position):
    return {"name": name, "shape": {"type": "box", "size": list(size)}, "pose": [*position, 1, 0, 0, 0]}


@pytest.mark.parametrize("path", TASKS, ids=lambda path: path.stem)
def test_every_plate_lift_file_has_a_scene_with_its_plate_at_rest(path, build):
    task = json.loads(path.read_text())
    scene = build(task)
    bottom = scene.T_world_plate @ np.array([0, 0, scene.plate.bottom, 1])
    assert bottom[2] == pytest.approx(scene.support_top, abs=1e-12)
    assert scene.support_name == ("support" if "support" in task else "table")
    table = scene.cell.table_top
    board = task["support"]["shape"]["size"][2] if "support" in task else 0.0
    assert scene.support_top == pytest.approx(table + board)


def test_a_plate_on_the_table_beside_a_board_rests_on_the_table(build):
    body = {**AB3, "plate_pose": [0.3, 0.6, 1.114, 1, 0, 0, 0]}
    scene = build(body)
    assert (scene.support_name, scene.support_top) == ("table", TABLE_TOP)
    assert scene.support is not None


def test_a_plate_a_little_off_its_support_is_settled_onto_it(build):
    tilt = math.radians(0.05) / 2
    body = {**AB1, "plate_pose": [0.3, 0, 1.114 + 0.0005, math.cos(tilt), math.sin(tilt), 0, 0]}
    scene = build(body)
    assert scene.T_world_plate == pytest.approx(from_pose7([0.3, 0, 1.114, 1, 0, 0, 0]), abs=1e-12)


def test_a_hexagonal_plate_is_as_welcome_as_a_box(build):
    outline = [[0.18 * math.cos(k * math.pi / 3), 0.18 * math.sin(k * math.pi / 3)] for k in range(6)]
    body = {**AB1, "plate": {"shape": {"type": "prism", "outline": outline, "height": 0.04}, "mass": 3}}
    scene = build(body)
    assert scene.plate.outline == pytest.approx(np.array(outline))
    assert (scene.plate.top, scene.plate.bottom) == (0.02, -0.02)


@given(yaw=st.floats(-3.1, 3.1), x=st.floats(-0.1, 0.1), y=st.floats(-0.1, 0.1))
@settings(max_examples=20, deadline=None)
def test_the_cups_frame_looks_into_the_plate_and_the_cable_hangs_plumb_above_it(cells, yaw, x, y):
    pose = [0.4, 0, 1.114, math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]
    task = read_task({**AB1, "plate_pose": pose, "cup": {**AB1["cup"], "position": [x, y]}})
    scene = build_scene(task, cells)
    cup, R = scene.cup, scene.cup.T_plate_cup[:3, :3]
    assert cup.T_plate_cup[:3, 3] == pytest.approx([x, y, 0.02])
    assert R[:, 2] == pytest.approx([0, 0, -1])
    assert R[:, 0] == pytest.approx([1, 0, 0])
    assert np.cross(R[:, 2], R[:, 0]) == pytest.approx(R[:, 1])
    pad = (scene.T_world_plate @ cup.T_plate_cup)[:3, 3]
    assert cup.body.T_world_body[:3, 3] - pad == pytest.approx([0, 0, 0.02])
    assert cup.cable.T_world_body[:3, 3] - pad == pytest.approx([0, 0, 0.04 + 0.55])
    assert rotation_angle(cup.cable.T_world_body[:3, :3], np.eye(3)) == 0
    anchor = scene.T_world_plate @ np.append(cup.cable_anchor, 1)
    assert cup.cable.T_world_body[:3, 3] - anchor[:3] == pytest.approx([0, 0, 0.55])


def test_the_cables_capsule_contains_its_cylinder(build):
    cable = build(AB1).cup.cable_collision_body()
    (axis,) = cable.shapes
    assert sorted(axis.vertices[:, 2]) == pytest.approx([0, 1.1])
    assert axis.radius == 0.010


def test_arms_start_at_home_unless_told_otherwise(build, cells):
    cell = cells["dual_ur3e_lift"]
    assert (build(AB1).start_positions == cell.home).all()
    positions = (cell.home + 0.01).tolist()
    assert build({**AB1, "start_positions": positions}).start_positions.tolist() == positions


def test_obstacles_may_overlap_one_another(build):
    pair = [obstacle("a", [0.1] * 3, [0.7, 0.6, 1.144]), obstacle("b", [0.1] * 3, [0.72, 0.62, 1.144])]
    assert [body.name for body in build({**AB1, "obstacles": pair}).obstacles] == ["a", "b"]


def test_the_document_lists_every_body_once_and_as_the_contract_says(build):
    scene = build({**AB3, "obstacles": [obstacle("a", [0.1] * 3, [0.7, 0.6, 1.144])]})
    bodies = stated_bodies(scene)
    assert {*bodies} >= {"table", "plate", "support", "cup", "cable", "a"}
    assert {name: bodies[name].role for name in ("table", "plate", "support", "cup", "cable", "a")} == {
        "table": "table", "plate": "plate", "support": "support", "cup": "cup", "cable": "cable", "a": "obstacle",
    }  # fmt: skip
    assert {name for name, body in bodies.items() if not body.static} == {"plate", "cup", "cable"}
    assert bodies["plate"].mass == 4.0


def as_fcl(shape):
    """Return an fcl object of a shape in the world: a sphere, a capsule or a hull."""
    center = shape.vertices.mean(axis=0)
    if len(shape.vertices) == 1:
        return fcl.CollisionObject(fcl.Sphere(shape.radius), fcl.Transform(center))
    if len(shape.vertices) == 2:
        along = shape.vertices[1] - shape.vertices[0]
        R = frame_from_z(along, [0.36, 0.48, 0.8])
        return fcl.CollisionObject(fcl.Capsule(shape.radius, np.linalg.norm(along)), fcl.Transform(R, center))
    assert shape.radius == 0
    hull = ConvexHull(shape.vertices)
    triangles = [
        simplex if equation[:3] @ np.cross(*(shape.vertices[simplex[1:]] - shape.vertices[simplex[0]])) > 0
        else simplex[::-1]
        for simplex, equation in zip(hull.simplices, hull.equations, strict=True)
    ]  # fmt: skip
    faces = np.array([[3, *triangle] for triangle in triangles]).ravel()
    return fcl.CollisionObject(fcl.Convex(shape.vertices - center, len(triangles), faces), fcl.Transform(center))


def test_a_block_overlaps_at_the_start_exactly_when_fcl_says_so(build):
    scene = build(AB1)
    arms = CellAtStart.of(scene.cell, scene.start_positions, scene.start_widths).arms
    placed = [body.collision_body_in_world() for body in scene.bodies()]
    others = [as_fcl(shape) for body in [*arms, *placed] for shape in body.shapes]
    rng = np.random.default_rng(0)
    verdicts = Counter()
    for _ in range(200):
        size, position = rng.uniform(0.02, 0.15, 3), rng.uniform([-0.2, -0.7, 1.08], [0.6, 0.7, 2.0])
        box = fcl.CollisionObject(fcl.Box(*size), fcl.Transform(position))
        refused = None
        if any(fcl.collide(box, other, fcl.CollisionRequest(), fcl.CollisionResult()) for other in others):
            refused = BodiesOverlap
        if max(depth_of_boxes(size, position, part.size, part.center) for part in scene.cell.boxes) > 1e-3:
            refused = BodyInCell
        verdicts[refused] += 1
        with pytest.raises(refused) if refused else nullcontext():
            build({**AB1, "obstacles": [obstacle("block", size, position)]})
    assert min(verdicts[BodiesOverlap], verdicts[BodyInCell], verdicts[None]) > 10


def depth_of_boxes(size, center, other_size, other_center):
    """How deep two boxes along the world's axes are in one another: the least of their overlaps; negative if none."""
    return float((0.5 * (size + other_size) - np.abs(center - other_center)).min())


@pytest.mark.parametrize("task", [AB1, DOMINO_PILE], ids=["lift", "suction tool"])
@pytest.mark.parametrize("deep", [-0.0001, 0.0, 0.0009, 0.0011, 0.02])
@pytest.mark.parametrize(
    ("part", "center", "out"),
    [("table", [0.7, 0.6, 1.094], [0, 0, 0.05]), ("platform_column", [-0.05, 0.0, 1.4], [-0.05, 0, 0])],
)
def test_an_obstacle_may_touch_a_part_of_the_cell_and_reach_a_millimetre_into_it(build, task, deep, part, center, out):
    """Beyond that it is pointed at, with the part's name and the millimetres."""
    out = np.array(out)
    position = center + out * (1.0 - deep / np.linalg.norm(out))
    body = {**task, "obstacles": [obstacle("block", [0.1] * 3, position.tolist())]}
    if deep <= 1e-3:
        assert build(body).obstacles[0].name == "block"
        return
    with pytest.raises(BodyInCell) as caught:
        build(body)
    assert caught.value.pointers == ("/obstacles/0/pose",)
    assert f"block is {1e3 * deep:.4g} mm deep in {part}" in str(caught.value)


MOVED = re.compile(r"moved ([0-9.]+) mm towards the world's ([+-])([xyz]), (\w+) is clear of (\w+)$")


def test_what_overlaps_is_told_how_deep_and_a_move_that_parts_it(build):
    """As deep as another library finds boxes in one another; it finds them apart once one is moved as told, not sooner.

    Blocks stand on the table, and a little in a plate that lies there; both are turned.
    """
    rng = np.random.default_rng(7)
    sides, place = np.array(AB1["plate"]["shape"]["size"]), np.array(AB1["plate_pose"][:3])
    axes = Counter()
    for _ in range(20):
        size, halves = rng.uniform(0.04, 0.2, 3), rng.uniform(-0.5, 0.5, 2)
        center = place + rng.choice([-1, 1], 3) * rng.uniform(0.5, 1.0, 3) * 0.5 * (sides + size)
        center[2] = TABLE_TOP + 0.5 * size[2]
        lying, pose = ([*at, math.cos(h), 0, 0, math.sin(h)] for at, h in zip((place, center), halves, strict=True))
        block = {"name": "block", "shape": {"type": "box", "size": size.tolist()}, "pose": pose}
        boxes = {
            "plate": fcl.CollisionObject(fcl.Box(*sides), fcl.Transform(from_pose7(lying)[:3, :3], place)),
            "block": fcl.CollisionObject(fcl.Box(*size), fcl.Transform(from_pose7(pose)[:3, :3], center)),
        }
        met = fcl.CollisionResult()
        if not fcl.collide(*boxes.values(), fcl.CollisionRequest(num_max_contacts=64, enable_contact=True), met):
            continue
        with pytest.raises(BodiesOverlap, match="plate and block overlap by") as refused:
            build({**AB1, "plate_pose": lying, "obstacles": [block]})
        (deep,) = re.findall(r"overlap by ([0-9.e-]+) mm", refused.value.detail)
        assert float(deep) == pytest.approx(1e3 * max(each.penetration_depth for each in met.contacts), rel=1e-3)
        far, sign, axis, name, other = MOVED.search(refused.value.detail).groups()
        axes[axis] += 1
        assert {name, other} == boxes.keys()
        assert float(far) >= float(deep)
        towards, start = float(f"{sign}1e-3") * np.eye(3)["xyz".index(axis)], boxes[name].getTranslation()
        for way, apart in ((float(far), True), (float(far) - 0.15, False)):
            boxes[name].setTranslation(start + way * towards)
            touching = fcl.collide(*boxes.values(), fcl.CollisionRequest(), fcl.CollisionResult())
            assert bool(touching) != apart
    assert len(axes) == 3


def test_a_support_may_touch_the_column_and_not_reach_into_it(build):
    """The column ends at x = 0.05 m."""
    for deep in (-1e-4, 0.0, 0.9e-3, 1.1e-3, 0.03):
        x = 0.05 - deep + 0.3
        support = {**AB3["support"], "shape": {"type": "box", "size": [0.6, 0.5, 0.044]}}
        support["pose"] = [x, *AB3["support"]["pose"][1:]]
        body = {**AB3, "support": support, "plate_pose": [x, *AB3["plate_pose"][1:]]}
        if deep <= 1e-3:
            assert build(body).support.name == "support"
            continue
        with pytest.raises(BodyInCell, match=f"support is {1e3 * deep:.4g} mm deep in platform_column") as caught:
            build(body)
        assert caught.value.pointers == ("/support/pose",)


def test_the_depth_of_shapes_is_the_shortest_way_that_parts_them():
    """Parted by a little more than their depth along some of many directions, and by none with much less."""
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    seen = 0
    while seen < 40:
        sizes = rng.integers(1, 9, 2)
        shapes = [ConvexShape(rng.normal(size=(n, 3)) * 0.05, float(rng.uniform(0, 0.02))) for n in sizes]
        a, b = (placed_body(CollisionBody("body", "cell", "world", (shape,)), np.eye(4), None) for shape in shapes)
        deep = depth(a, b)
        assert (deep > 0.0) == (gap(a, b) < 0.0)
        if deep <= 0.0:
            continue
        seen += 1
        p, q = (shape.vertices for shape in shapes)
        radii = shapes[0].radius + shapes[1].radius
        ways = (directions @ p.T).max(axis=1) - (directions @ q.T).min(axis=1) + radii
        assert deep <= ways.min() + 1e-6
        assert deep >= 0.9 * ways.min() - 2e-3


WORTH_TRYING = [
    *("/plate/mass", "/plate/com/0", "/plate/shape/size/0", "/plate/shape/size/2", "/plate_pose/0", "/plate_pose/2"),
    *("/cup/position/0", "/cup/radius", "/support/pose/2", "/support/shape/size/1"),
]


NUMBERS = st.floats() | st.floats(0, 1.3) | st.floats(1.1, 1.2)


@settings(max_examples=150, deadline=None)
@given(changes=st.dictionaries(st.sampled_from(WORTH_TRYING), NUMBERS, max_size=4))
def test_a_task_with_any_numbers_has_a_scene_or_is_refused(cells, changes):
    body = copy.deepcopy(AB3)
    for pointer, value in changes.items():
        *path, key = pointer.split("/")[1:]
        container = body
        for step in path:
            container = container.setdefault(step, [0, 0, 0])
        container[int(key) if isinstance(container, list) else key] = value
    try:
        scene = build_scene(read_task(body), cells)
    except (ValidationError, SceneError):
        return
    assert scene.T_world_plate[2, 3] + scene.plate.bottom == pytest.approx(scene.support_top)
