"""Centres of mass that a task leaves out are those of its shapes, and the accepted task states them."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from app.task_intake import accept_task
from planners.cell.cell import load_cells
from planners.contract.shapes import Box, Cylinder, Prism
from planners.contract.task_spec import read_task, write_task
from planners.geometry.pose import from_pose7, rotation_x, to_pose7, transform
from planners.geometry.solid_mesh import take_mesh
from planners.planning import stated_bodies
from planners.scene.scene import build_scene, with_centres
from planners.scene.solid import solid_of
from planners.scene.suction_tool import known_tools, load_tool
from tests.geometry.mesh_shapes import angle, file_of

TASKS = Path(__file__).parents[2] / "assets/tasks"
TOP = 1.094
WEDGE = {"type": "prism", "outline": [[0, 0], [0.3, 0], [0.25, 0.2], [0, 0.3]], "height": 0.03}
FLAT = [0.35, 0.1, TOP, 1, 0, 0, 0]


@pytest.fixture(scope="module")
def cells():
    return load_cells()


@pytest.fixture(scope="module")
def accept(cells):
    meshes = {"angle": take_mesh(file_of(angle(), "stl"), "stl")}
    return lambda body: write_task(accept_task(body, cells, meshes.get))


def task(name, **changes):
    return {**json.loads((TASKS / f"{name}.json").read_text()), **changes}


def moved(shape, pose, **more):
    return task(
        "domino_pile", objects=[{"name": "one", "shape": shape, "mass": 0.1, "pose": pose, "goal_pose": pose, **more}]
    )


def drawn(shape):
    """The same solid, by another hand."""
    if shape["type"] == "box":
        return trimesh.creation.box(shape["size"])
    n = len(shape["outline"])
    rings = [np.c_[shape["outline"], np.full(n, z)] for z in (-shape["height"] / 2, shape["height"] / 2)]
    return trimesh.Trimesh(np.vstack(rings)).convex_hull


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_that_of_a_mesh_is_the_centroid_of_its_solid(accept, scale):
    T = transform(rotation_x(np.pi / 2), [0.45, 0.1, TOP])
    one = moved({"type": "mesh", "upload": "angle", "scale": scale}, to_pose7(T))
    (given,) = accept(one)["objects"]
    # A hair beside the true centroid is 1 nm; the origin is 45 mm off.
    np.testing.assert_allclose(given["com"], scale * angle().center_mass, atol=1e-9)


def test_that_of_a_prism_is_the_centroid_of_its_outline(accept):
    expected = drawn(WEDGE).center_mass
    (given,) = accept(moved(WEDGE, [0.35, 0.1, TOP + 0.015, 1, 0, 0, 0]))["objects"]
    np.testing.assert_allclose(given["com"], expected, atol=1e-9)
    lift = {"kind": "plate_lift", "cup": {"position": [0.15, 0.12], "radius": 0.0175, "max_force": 20}}
    lift |= {"plate": {"shape": WEDGE, "mass": 3}, "plate_pose": [0.3, 0, TOP + 0.015, 1, 0, 0, 0]}
    np.testing.assert_allclose(accept(lift)["plate"]["com"], expected, atol=1e-9)


def test_that_of_a_box_or_cylinder_is_its_origin_exactly():
    for shape in (Box(type="box", size=(0.13, 0.07, 0.02)), Cylinder(type="cylinder", radius=0.033, height=0.1222)):
        assert solid_of(shape).centroid.tolist() == [0.0, 0.0, 0.0]
    square = Prism(type="prism", outline=((0.0, 0.0), (0.2, 0.0), (0.2, 0.2), (0.0, 0.2)), height=0.03)
    assert solid_of(square).centroid.tolist() == [0.1, 0.1, 0.0]


def test_that_of_a_tool_is_the_centre_of_all_its_parts(accept):
    column = {"shape": {"type": "box", "size": [0.02, 0.02, 0.1]}, "pose": [0, 0, 0.05, 1, 0, 0, 0]}
    handle = {"shape": WEDGE, "pose": to_pose7(transform(rotation_x(np.pi / 2), [0.01, 0, 0.1]))}
    cup = {"radius": 0.0175, "max_force": 20}
    tool = {"shapes": [column, handle], "mass": 0.2, "cup": cup}
    lying = to_pose7(transform(rotation_x(-np.pi / 2), [0.5, -0.2, TOP + 0.015]))
    domino = moved({"type": "box", "size": [0.13, 0.07, 0.02]}, [0.35, 0.2, TOP + 0.01, 1, 0, 0, 0])
    parts = [(drawn(part["shape"]), from_pose7(part["pose"])) for part in tool["shapes"]]
    weighted = sum(mesh.volume * (T @ [*mesh.center_mass, 1.0])[:3] for mesh, T in parts)
    expected = weighted / sum(mesh.volume for mesh, _ in parts)
    assert accept({**domino, "tool": tool, "tool_pose": lying})["tool"]["com"] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("name", known_tools())
def test_a_shipped_tool_is_of_one_material_as_its_file_says(name):
    tool = load_tool(name)
    # The file rounds to a tenth of a millimetre, and a plate of markers may be of another one.
    np.testing.assert_allclose(tool.body.solid.centroid, tool.com, atol=1e-3)


def test_a_stated_one_is_kept(accept):
    stated = [0.05, 0.01, 0.02]
    assert accept(moved({"type": "mesh", "upload": "angle"}, FLAT, com=stated))["objects"][0]["com"] == stated


def test_a_document_states_what_was_planned_with(cells):
    given = read_task(moved(WEDGE, [0.35, 0.1, TOP + 0.015, 1, 0, 0, 0]))
    scene = build_scene(given, cells)
    stated = stated_bodies(scene)["one"].com
    assert with_centres(given, scene).objects[0].com == tuple(stated) != (0.0, 0.0, 0.0)


def test_what_was_accepted_is_accepted_as_it_is(accept):
    once = accept(moved({"type": "mesh", "upload": "angle"}, FLAT))
    assert accept(once) == once
