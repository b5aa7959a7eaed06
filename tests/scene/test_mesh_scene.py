"""Meshes in a scene: objects, obstacles and tools of any shape."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from planners.cell.cell import load_cells
from planners.contract.shapes import Mesh
from planners.contract.task_spec import read_task
from planners.errors import SceneError
from planners.geometry.pose import rotation_y, to_pose7, transform
from planners.geometry.solid_mesh import take_mesh
from planners.scene.clashes import BodiesOverlap
from planners.scene.scene import build_scene
from planners.scene.shape_source import ShapeSource
from planners.scene.solid import MeshSolid
from tests.geometry.mesh_shapes import angle, file_of

TASKS = Path(__file__).parents[2] / "assets/tasks"
TOP = 1.094
ANGLE = {"type": "mesh", "upload": "angle"}


@pytest.fixture(scope="module")
def build():
    cells = load_cells()
    ring = trimesh.creation.annulus(0.03, 0.04, 0.05, sections=32)
    made = {"angle": angle(), "ring": ring, "bracket": bracket()}
    meshes = {name: take_mesh(file_of(mesh, "stl"), "stl") for name, mesh in made.items()}
    return lambda body: build_scene(read_task(body), cells, uploads=meshes.get)


def bracket():
    """A square foot of 0.1 m round z, 20 mm thick, with a wall of 60 mm on its -x side."""
    wide = angle(0.1)
    wide.apply_transform(stand([-0.05, 0.05, 0.0]))
    return wide


def task(objects, **more):
    return {**json.loads((TASKS / "domino_pile.json").read_text()), "objects": objects, **more}


def stand(position):
    """The angle on its foot: its y axis up."""
    return transform(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), position)


def lying(shape, pose, goal, com=(0.03, 0.02, 0.025), **more):
    named = {"name": "one", "shape": shape, "mass": 0.1, "com": list(com)}
    return {**named, "pose": pose, "goal_pose": goal, **more}


def test_an_angle_may_stand_on_either_leg_and_lie(build):
    flat = [0.45, 0.1, TOP, 1, 0, 0, 0]
    upright = to_pose7(stand([0.45, -0.1, TOP]))
    (moved,) = build(task([lying(ANGLE, flat, upright)])).objects
    assert isinstance(moved.body.solid, MeshSolid)
    vertices, _ = moved.body.solid.surface()
    for T in (moved.body.T_world_body, moved.T_world_goal):
        assert (vertices @ T[2, :3] + T[2, 3]).min() == pytest.approx(TOP, abs=1e-9)
    assert len(moved.body.solid.convex_parts) == 2
    assert moved.body.shape.type == "mesh"


def test_an_angle_rests_on_its_hull_too(build):
    # From the end of the foot to the end of the leg there is no face of the angle, but of its hull.
    slope = np.arctan2(0.06, 0.08)
    normal = np.array([np.sin(slope), np.cos(slope), 0])
    across = np.array([-np.cos(slope), np.sin(slope), 0])
    R = np.vstack([across, np.cross(-normal, across), -normal])
    corner = transform(R) @ np.array([0.1, 0.02, 0, 1])
    pose = to_pose7(transform(R, [0.45, 0.0, TOP - corner[2]]))
    (moved,) = build(task([lying(ANGLE, pose, pose)])).objects
    assert moved.start_supports == ("table",)


def test_what_lies_in_the_corner_of_an_angle_does_not_overlap_it(build):
    shelf = {"name": "shelf", "shape": ANGLE, "pose": to_pose7(stand([0.45, 0.0, TOP]))}
    box = {"type": "box", "size": [0.04, 0.04, 0.03]}
    inside = lying(box, [0.505, -0.025, TOP + 0.035, 1, 0, 0, 0], [0.505, -0.025, TOP + 0.035, 1, 0, 0, 0], (0, 0, 0))
    (moved,) = build(task([inside], obstacles=[shelf])).objects
    assert moved.goal_supports == ("shelf",)
    into_the_leg = {**inside, "goal_pose": [0.485, -0.025, TOP + 0.035, 1, 0, 0, 0]}
    with pytest.raises(BodiesOverlap, match="one and shelf"):
        build(task([into_the_leg], obstacles=[shelf]))


def test_a_small_thing_does_not_rest_on_the_hole_of_a_ring(build):
    ring = {"name": "ring", "shape": {"type": "mesh", "upload": "ring"}, "pose": [0.45, 0, TOP + 0.025, 1, 0, 0, 0]}
    small, wide = {"type": "box", "size": [0.03] * 3}, {"type": "box", "size": [0.1, 0.1, 0.03]}
    pose = [0.45, 0, TOP + 0.065, 1, 0, 0, 0]
    with pytest.raises(SceneError, match="rests on nothing"):
        build(task([lying(small, pose, pose, (0, 0, 0))], obstacles=[ring]))
    (moved,) = build(task([lying(wide, pose, pose, (0, 0, 0))], obstacles=[ring])).objects
    assert moved.start_supports == ("ring",)
    # Above it, it is told to come down to where it rests: on all of the ring's pieces, on none of which alone it would.
    high = [0.45, 0, TOP + 0.165, 1, 0, 0, 0]
    with pytest.raises(SceneError, match=r"rests on nothing: .* 100 mm above the top of ring") as refused:
        build(task([lying(wide, high, pose, (0, 0, 0))], obstacles=[ring]))
    assert f"on ring it would rest at [0.45, 0.0, {TOP + 0.065:g}, 1.0, 0.0, 0.0, 0.0]" in str(refused.value)
    # Upright in the hole it stands on the table.
    inside = [0.45, 0, TOP + 0.015, 1, 0, 0, 0]
    (moved,) = build(task([lying(small, inside, inside, (0, 0, 0))], obstacles=[ring])).objects
    assert moved.start_supports == ("table",)


def test_the_shape_of_a_mesh_has_its_own_symmetry(build):
    flat = [0.45, 0.1, TOP, 1, 0, 0, 0]
    assert len(build(task([lying(ANGLE, flat, flat, goal_symmetry="shape")])).objects[0].goal_turns) == 1
    ring = {"type": "mesh", "upload": "ring"}
    pose = [0.45, 0.1, TOP + 0.025, 1, 0, 0, 0]
    (moved,) = build(task([lying(ring, pose, pose, (0, 0, 0), goal_symmetry="shape")])).objects
    assert len(moved.goal_turns) == 64


def test_a_tool_may_have_a_mesh_as_a_part(build):
    handle = {"shape": ANGLE, "pose": [-0.01, -0.01, 0.05, 1, 0, 0, 0]}
    column = {"shape": {"type": "cylinder", "radius": 0.0175, "height": 0.05}, "pose": [0, 0, 0.025, 1, 0, 0, 0]}
    tool = {"shapes": [column, handle], "mass": 0.2, "com": [0, 0, 0.05], "cup": {"radius": 0.0175, "max_force": 20}}
    pose = [0.45, 0.1, TOP + 0.01, 1, 0, 0, 0]
    domino = lying({"type": "box", "size": [0.13, 0.07, 0.02]}, pose, pose, (0, 0, 0))
    assert (
        len(build(task([domino], tool=tool, tool_pose=[0.6, -0.2, TOP, 1, 0, 0, 0])).tool.body.solid.convex_parts) == 3
    )


def test_a_mesh_in_two_scenes_is_one_solid_unless_its_size_is_another(build):
    flat = [0.45, 0.1, TOP, 1, 0, 0, 0]
    shapes = (ANGLE, ANGLE, ANGLE | {"scale": 0.9})
    one, again, smaller = (build(task([lying(shape, flat, flat)])).objects[0].body.solid for shape in shapes)
    assert one is again
    assert np.ptp(smaller.surface()[0], axis=0) == pytest.approx(0.9 * np.ptp(one.surface()[0], axis=0))


def test_a_solid_made_larger_by_its_drawing_says_by_how_much():
    _, solid = ShapeSource().find(Mesh(type="mesh", asset="can"), "")
    vertices, faces = solid.surface()
    (part,) = solid.convex_parts
    drawn = trimesh.Trimesh(part.vertices, process=False).convex_hull
    surface = trimesh.Trimesh(vertices, faces, process=False)
    points, _ = trimesh.sample.sample_surface(drawn, 400, seed=0)
    _, distances, _ = trimesh.proximity.closest_point_naive(surface, points)
    assert distances.max() <= solid.excess < 2e-3


def test_a_turned_mesh_is_depicted_where_it_is(build):
    T = transform(rotation_y(np.pi / 2), [0.45, 0.1, TOP + 0.1])
    (moved,) = build(task([lying(ANGLE, to_pose7(T), to_pose7(T))])).objects
    body = moved.body.collision_body_in_world()
    lowest = min(shape.vertices[:, 2].min() for shape in body.shapes)
    assert lowest == pytest.approx(TOP, abs=1e-9)


def test_a_goal_is_not_turned_into_what_is_to_rest_on_it(build):
    com, start = (-0.015, 0.0, 0.02), [0.4, 0.3, TOP, 1, 0, 0, 0]
    lower = lying({"type": "mesh", "upload": "bracket"}, start, [0.5, 0, TOP, 1, 0, 0, 0], com, goal_symmetry="axis")
    brick = {"type": "box", "size": [0.05, 0.03, 0.02]}
    upper = lying(brick, [0.4, -0.3, TOP + 0.01, 1, 0, 0, 0], [0.52, 0, TOP + 0.03, 1, 0, 0, 0], (0, 0, 0))
    moved, _ = build(task([lower, {**upper, "name": "upper"}])).objects
    assert moved.goal_turns.shape[0] > 1
    for turn in moved.goal_turns:
        # Corners of the brick, seen from the turned foot, are beyond the wall.
        corners = np.array([[0.02 + x, y] for x in (-0.025, 0.025) for y in (-0.015, 0.015)]) @ turn[:2, :2]
        assert corners[:, 0].min() > -0.03
    quarters = [round(np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))) % 90 == 0 for turn in moved.goal_turns]
    assert sum(quarters) == 3
