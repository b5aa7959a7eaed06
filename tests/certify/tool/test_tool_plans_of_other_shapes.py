"""The certificate of plans with meshes, with tools of the task's own, and with goals that a symmetry allows."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from planners.certify import CellReference, Certificate, RobotSurfaces
from planners.geometry.pose import from_pose7, rotation_x, rotation_z, to_pose7, transform
from planners.geometry.solid_mesh import take_mesh
from planners.plan.plan import Plan
from tests.support.documents import certified
from tests.support.pierced_plate import pierced_plate
from tests.support.samples import sample
from tests.support.tool_plans import QUARTER, Document, block, planned, reference_of_the_tool_cell

OUTLINE = np.array([[0, 0], [0.12, 0], [0.12, 0.05], [0.05, 0.05], [0.05, 0.10], [0, 0.10]])
"""Of an L [m]."""
HEIGHT = 0.03
TOOL: dict[str, Any] = {
    "shapes": [
        {"shape": {"type": "cylinder", "radius": 0.0165, "height": 0.04}, "pose": [0, 0, 0.02, 1, 0, 0, 0]},
        {"shape": {"type": "box", "size": [0.016, 0.02, 0.19]}, "pose": [0, 0, 0.135, 1, 0, 0, 0]},
    ],
    "mass": 0.25, "com": [0, 0, 0.11], "cup": {"radius": 0.0165, "max_force": 15, "mu": 0.4, "kappa": 0.004},
}  # fmt: skip

HALVES: list[dict[str, Any]] = [
    {"shape": {"type": "box", "size": [0.008, 0.02, 0.19]}, "pose": [side * 0.004, 0, 0.135, 1, 0, 0, 0]}
    for side in (-1, 1)
]
"""Of that tool's shaft, cut square to where hands close on it."""


def bracket_file() -> bytes:
    """The L as an OBJ file, its origin at mid-height."""
    n = len(OUTLINE)
    lines = [f"v {x} {y} {z}" for z in (-HEIGHT / 2, HEIGHT / 2) for x, y in OUTLINE]
    cap = [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)]
    faces = [(a, c, b) for a, b, c in cap] + [(a + n, b + n, c + n) for a, b, c in cap]
    faces += [face for i in range(n) for j in [(i + 1) % n] for face in ((i, j, n + j), (i, n + j, n + i))]
    lines += ["f " + " ".join(str(k + 1) for k in face) for face in faces]
    return "\n".join(lines).encode()


@pytest.fixture(scope="module")
def known() -> CellReference:
    return reference_of_the_tool_cell()


@pytest.fixture(scope="module")
def of_a_mesh() -> Document:
    """An uploaded bracket is moved; its com is in the thicker leg."""
    bracket = {
        "shape": {"type": "mesh", "upload": "bracket"}, "mass": 0.12, "com": [0.045, 0.035, 0],
        "pose": [0.3, 0.3, 1.094 + HEIGHT / 2, *QUARTER], "goal_pose": [0.4, 0.15, 1.094 + HEIGHT / 2, *QUARTER],
    }  # fmt: skip
    return planned({"objects": [block(**bracket)]}, {"bracket": take_mesh(bracket_file(), "obj")})


@pytest.fixture(scope="module")
def of_a_shipped_mesh() -> Document:
    """A can is moved."""
    can = {
        "shape": {"type": "mesh", "asset": "can"}, "goal_symmetry": "axis",
        "pose": [0.3, 0.3, 1.1551, *QUARTER], "goal_pose": [0.4, 0.15, 1.1551, *QUARTER],
    }  # fmt: skip
    return planned({"objects": [block(**can)]})


@pytest.fixture(scope="module")
def of_a_custom_tool() -> Document:
    """A block is moved with a tool that the task describes."""
    return planned({"objects": [block()], "tool": TOOL})


def failures(certificate: Certificate) -> dict[str, str]:
    return {check.name: check.where for check in certificate.failures}


def test_a_plan_for_a_mesh_passes(of_a_mesh: Document, surfaces: RobotSurfaces, known: CellReference) -> None:
    Plan.model_validate(of_a_mesh)
    assert of_a_mesh["bodies"]["block"]["shape"]["type"] == "mesh"
    assert failures(certified(of_a_mesh, surfaces, known)) == {}


@pytest.mark.parametrize("scale", [0.001, 0.999, 25.4])
def test_a_mesh_of_another_size_than_the_shipped_one_that_is_named_fails(
    scale: float, of_a_shipped_mesh: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    """The shape in the document is the planner's own; the certificate reads the file, too."""
    document = copy.deepcopy(of_a_shipped_mesh)
    assert failures(certified(document, surfaces, known)) == {}
    document["task"]["objects"][0]["shape"]["scale"] = scale
    assert failures(certified(document, surfaces, known)) == {"task_bodies": "body block: shape"}


def test_a_shipped_mesh_that_lost_a_triangle_fails(
    of_a_shipped_mesh: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    """All corners are where they are in the file."""
    document = copy.deepcopy(of_a_shipped_mesh)
    document["bodies"]["block"]["shape"]["faces"].pop()
    assert failures(certified(document, surfaces, known))["task_bodies"] == "body block: shape"


def test_a_mesh_with_a_dent_under_the_cup_fails(
    of_a_mesh: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    document = copy.deepcopy(of_a_mesh)
    shape = document["bodies"]["block"]["shape"]
    vertices = np.array(shape["vertices"])
    # One corner of the top face goes down by 15 mm: the triangles about it slope away.
    corner = int(np.argmin(np.linalg.norm(vertices - [0, 0, HEIGHT / 2], axis=1)))
    vertices[corner, 2] -= 0.015
    shape["vertices"] = vertices.tolist()
    found = failures(certified(document, surfaces, known))
    assert {"contact_points", "contact_normals"} & set(found)
    assert any("block" in where for where in found.values())


def test_a_mesh_that_sticks_out_of_its_convex_parts_fails(
    of_a_mesh: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    document = copy.deepcopy(of_a_mesh)
    shape = document["bodies"]["block"]["shape"]
    assert len(shape["convex_parts"]) > 1
    shape["convex_parts"].pop()
    assert "body block: convex parts" in failures(certified(document, surfaces, known))["task_bodies"]


def test_a_mesh_whose_parts_leave_its_middle_out_fails(
    of_a_custom_tool: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    """Corners and middles of its triangles are all in a part."""
    document = copy.deepcopy(of_a_custom_tool)
    size = np.array([0.13, 0.07, 0.02])
    corners = size / 2 * [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    halves = [np.where(corners[:, :1] * side > 0, corners, corners * [-0.3, 1, 1]) for side in (-1, 1)]
    shape: dict[str, Any] = {"type": "mesh", "vertices": corners.tolist(), "faces": faces}
    document["bodies"]["block"]["shape"] = shape | {"convex_parts": [corners.tolist()]}
    whole = failures(certified(document, surfaces, known))
    assert "convex parts" not in whole.get("task_bodies", "")
    document["bodies"]["block"]["shape"] = shape | {"convex_parts": [half.tolist() for half in halves]}
    assert "body block: convex parts" in failures(certified(document, surfaces, known))["task_bodies"]


@pytest.mark.parametrize(("begin", "seals"), [(0.0102, False), (-0.0072, False), (0.019, True)])
def test_an_object_with_a_hole_under_the_lip_fails_wherever_the_hole_is(
    begin: float, seals: bool, of_a_custom_tool: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    """Square holes of 6 mm; no point of the lip's rim is over one of them, nor of the circle half as far out."""
    document = copy.deepcopy(of_a_custom_tool)
    segment = next(s for s in document["segments"] if s["kind"] == "attach")
    cup = next(c for c in segment["contacts"] if c["kind"] == "suction" and c["body"] == "block")
    body = document["bodies"]["block"]
    middle = np.linalg.inv(from_pose7(body["pose"])) @ [*cup["point"], 1.0]
    low = np.add(middle[:2], [-0.003, begin])
    vertices, faces = pierced_plate(np.array(body["shape"]["size"]), low, low + 0.006)
    body["shape"] = {
        "type": "mesh", "vertices": vertices.tolist(), "faces": faces.tolist(), "convex_parts": [vertices.tolist()],
    }  # fmt: skip
    found = failures(certified(document, surfaces, known))
    assert ("contact_points" in found) == (not seals)
    if not seals:
        assert "the lip on block: nothing seals there" in found["contact_points"]


def test_a_mesh_that_is_inside_out_has_no_certificate(
    of_a_mesh: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    document = copy.deepcopy(of_a_mesh)
    shape = document["bodies"]["block"]["shape"]
    shape["faces"] = [face[::-1] for face in shape["faces"]]
    assert set(failures(certified(document, surfaces, known))) == {"structure"}


def test_a_plan_with_a_custom_tool_passes(
    of_a_custom_tool: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    Plan.model_validate(of_a_custom_tool)
    assert failures(certified(of_a_custom_tool, surfaces, known)) == {}


@pytest.mark.slow
def test_a_plan_with_a_shaft_in_two_halves_passes(surfaces: RobotSurfaces, known: CellReference) -> None:
    """Hands close on both halves at once, which are thick together only."""
    document = planned({"objects": [block()], "tool": TOOL | {"shapes": [TOOL["shapes"][0], *HALVES]}})
    grips = [s["hold"]["grip"] for s in document["segments"] if s["hold"] and s["hold"]["grip"]]
    assert any(abs(grip["width"] - 0.016) < 1e-6 for grip in grips)
    assert failures(certified(document, surfaces, known)) == {}


OTHER_MEMBERS = [
    (("mass",), 0.2, "task_bodies"),
    (("com",), [0, 0, 0.1], "task_bodies"),
    (("shapes", 1, "shape", "size"), [0.016, 0.02, 0.15], "task_bodies"),
    (("shapes", 0, "shape", "radius"), 0.015, "task_bodies"),
    (("cup", "max_force"), 14.0, "contact_parameters"),
    (("cup", "mu"), 0.5, "contact_parameters"),
    (("cup", "radius"), 0.012, "contact_parameters"),
]


@pytest.mark.parametrize(("member", "value", "fails"), sample(OTHER_MEMBERS[::3], OTHER_MEMBERS))
def test_a_custom_tool_is_the_one_that_the_task_describes(
    member: tuple[Any, ...], value: Any, fails: str, of_a_custom_tool: Document, surfaces: RobotSurfaces,
    known: CellReference,
) -> None:  # fmt: skip
    document = copy.deepcopy(of_a_custom_tool)
    described = document["task"]["tool"]
    for step in member[:-1]:
        described = described[step]
    described[member[-1]] = value
    assert fails in failures(certified(document, surfaces, known))


HALF, QUARTER_TURN = transform(rotation_z(np.pi)), transform(rotation_z(np.pi / 2))
FLIP = transform(rotation_x(np.pi))


TURNS = [
    ("none", HALF, False),
    ("shape", HALF, True),
    ("shape", FLIP, True),
    ("shape", HALF @ FLIP, True),
    ("shape", QUARTER_TURN, False),
    ("shape", transform(rotation_z(np.radians(0.6))), False),
    ("axis", HALF, True),
    ("axis", QUARTER_TURN, True),
    ("axis", transform(rotation_z(0.3)), True),
    ("axis", FLIP, False),
]


@pytest.mark.parametrize(("symmetry", "turn", "reached"), sample(TURNS[::3], TURNS))
def test_a_goal_is_reached_up_to_the_declared_symmetry_and_no_further(
    symmetry: str, turn: np.ndarray, reached: bool, of_a_custom_tool: Document, surfaces: RobotSurfaces,
    known: CellReference,
) -> None:  # fmt: skip
    document = copy.deepcopy(of_a_custom_tool)
    (goal,) = document["task"]["objects"]
    goal["goal_symmetry"] = symmetry
    goal["goal_pose"] = to_pose7(from_pose7(goal["goal_pose"]) @ turn)
    found = failures(certified(document, surfaces, known))
    assert found == {} if reached else set(found) == {"goal_angles"}


@pytest.mark.slow
def test_a_round_object_is_at_its_goal_however_it_is_turned(surfaces: RobotSurfaces, known: CellReference) -> None:
    can = {"shape": {"type": "cylinder", "radius": 0.04, "height": 0.02}}
    document = planned({"objects": [block(**can)]})
    (goal,) = document["task"]["objects"]
    assert goal["goal_symmetry"] == "axis"
    T_world_end = [s["body_poses"]["block"][-1] for s in document["segments"] if "block" in s["body_poses"]][-1]
    assert failures(certified(document, surfaces, known)) == {}
    goal["goal_symmetry"] = "none"
    goal["goal_pose"] = to_pose7(from_pose7(T_world_end) @ transform(rotation_z(0.1)))
    assert set(failures(certified(document, surfaces, known))) == {"goal_angles"}
