"""The certificate's own word on whether what rests stands."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from planners.certify import CellReference, RobotSurfaces
from planners.certify.geometry.body_shape import BodyShape, box, mesh, prism
from planners.certify.geometry.level_contacts import LevelFaces, contact_points
from planners.certify.plan_view import BodyView
from planners.certify.tool.standing import least_shift
from planners.geometry import polygon
from planners.geometry.pose import Array, rotation_z, transform
from tests.support.documents import certified
from tests.support.tool_plans import Document, block, planned, reference_of_the_tool_cell

TOUCH = 5e-4
TABLE = 1.094
PEDESTAL = {
    "name": "pedestal",
    "shape": {"type": "box", "size": [0.1, 0.1, 0.04]},
    "pose": [0.55, -0.3, 1.114, 1, 0, 0, 0],
}
OUT, BEYOND = 0.045, 0.035
"""How far the beam's middle is from the pedestal's, 5 mm inside its edge, and the rider's middle from that edge [m]."""


def resting(name: str, x: float, bottom: float) -> Document:
    pose = [x, -0.3, bottom + 0.01, 1, 0, 0, 0]
    return block(name=name, pose=pose, goal_pose=pose)


@pytest.fixture(scope="module")
def honest() -> Document:
    """A block is moved, while a beam sticks out over a pedestal with a light rider on its overhang."""
    beam = resting("beam", 0.55 + OUT, TABLE + 0.04)
    rider = resting("rider", 0.60 + BEYOND, TABLE + 0.06) | {"mass": 0.01}
    return planned({"objects": [block(), beam, rider], "obstacles": [PEDESTAL]})


@pytest.fixture(scope="module")
def known() -> CellReference:
    return reference_of_the_tool_cell()


def weighed(document: Document, name: str, mass: float) -> Document:
    """The same document, in which a body has another mass, in the task as in the document."""
    document = copy.deepcopy(document)
    document["bodies"][name]["mass"] = mass
    for given in document["task"]["objects"]:
        if given["name"] == name:
            given["mass"] = mass
    return document


@pytest.mark.parametrize(("share", "stands"), [(0.97, True), (1.2, False)])
def test_a_rider_may_weigh_what_the_beam_balances(
    share: float, stands: bool, honest: Document, surfaces: RobotSurfaces, known: CellReference
) -> None:
    balanced = honest["bodies"]["beam"]["mass"] * (0.05 - OUT) / BEYOND
    failures = {
        check.name: check.where
        for check in certified(weighed(honest, "rider", share * balanced), surfaces, known).failures
    }
    assert failures == ({} if stands else {"standing": "the start: beam and rider would fall"})


@pytest.mark.slow
def test_what_is_put_down_must_not_take_others_down(surfaces: RobotSurfaces, known: CellReference) -> None:
    beam = resting("beam", 0.55 + OUT - 0.02, TABLE + 0.04)
    put = block(goal_pose=[0.60 + 0.02, -0.3, TABLE + 0.07, 1, 0, 0, 0])
    document = planned({"objects": [put, beam], "obstacles": [PEDESTAL]})
    assert certified(document, surfaces, known).passed
    # 25 mm of the lighter beam balance 20 mm of the block no more.
    lighter = weighed(document, "beam", 0.07)
    failures = {check.name: check.where for check in certified(lighter, surfaces, known).failures}
    assert set(failures) == {"standing"}
    assert "(detach), end" in failures["standing"]


def area(points: Array) -> float:
    return float(ConvexHull(points).volume) if len(points) > 2 else 0.0


def regular(sides: int, radius: float) -> Array:
    angles = 2.0 * np.pi * np.arange(sides) / sides
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize("seed", range(30))
def test_prisms_touch_where_their_outlines_overlap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = (regular(int(rng.integers(3, 9)), rng.uniform(0.03, 0.1)) for _ in range(2))
    low = transform(rotation_z(rng.uniform(-3, 3)), [*rng.uniform(-0.05, 0.05, 2), 0.02])
    high = transform(rotation_z(rng.uniform(-3, 3)), [*rng.uniform(-0.05, 0.05, 2), 0.06 + rng.uniform(-TOUCH, TOUCH)])
    found = contact_points(LevelFaces(prism(one, 0.04), high), LevelFaces(prism(other, 0.04), low), TOUCH)
    seen = [outline @ T[:2, :2].T + T[:2, 3] for outline, T in ((one, high), (other, low))]
    shared = polygon.overlap(*seen)
    assert area(found) == pytest.approx(area(shared), abs=1e-9)


def test_what_is_beside_or_above_does_not_touch() -> None:
    cube, here = box(np.array([0.1, 0.1, 0.04])), transform(None, [0.0, 0.0, 0.02])
    for place in ([0.1, 0.0, 0.02], [0.1, 0.0, 0.06], [0.0, 0.0, 0.061], [0.2, 0.0, 0.06]):
        there = LevelFaces(cube, transform(None, place))
        assert not len(contact_points(there, LevelFaces(cube, here), TOUCH))
    assert len(contact_points(LevelFaces(cube, transform(None, [0.0, 0.0, 0.06])), LevelFaces(cube, here), TOUCH))


def surface(made: trimesh.Trimesh) -> BodyShape:
    return mesh(np.array(made.vertices), np.array(made.faces), [np.array(made.convex_hull.vertices)])


def test_a_mesh_stands_on_its_faces_and_not_on_what_is_between_them() -> None:
    ring = surface(trimesh.creation.annulus(0.03, 0.05, 0.02, sections=32))
    pin = LevelFaces(box(np.array([0.04, 0.04, 0.02])), transform(None, [0.0, 0.0, 0.02]))
    assert not len(contact_points(pin, LevelFaces(ring, np.eye(4)), TOUCH))
    plate = LevelFaces(box(np.array([0.2, 0.2, 0.02])), transform(None, [0.0, 0.0, 0.02]))
    found = contact_points(plate, LevelFaces(ring, np.eye(4)), TOUCH)
    radii = np.linalg.norm(found, axis=1)
    assert set(np.round(radii, 6)) == {0.03, 0.05}


def test_a_body_on_points_stands_on_these() -> None:
    feet = np.array([[0.05, 0.0, 0.0], [-0.03, 0.04, 0.0], [-0.03, -0.04, 0.0]])
    stool = trimesh.convex.convex_hull(
        np.vstack([feet + np.array([0.0, 0.0, 0.02]), feet * 0.5 + np.array([0.0, 0.0, 0.05])])
    )
    legs = [
        trimesh.convex.convex_hull(
            np.vstack([foot[None], foot + 0.004 * np.eye(3) + [0, 0, 0.02], foot + np.array([0.0, 0.0, 0.024])])
        )
        for foot in feet
    ]
    vertices = np.vstack([stool.vertices, *(leg.vertices for leg in legs)])
    shape = BodyShape(vertices, tuple(part for one in (stool, *legs) for part in surface(one).parts))
    table = LevelFaces(box(np.array([1.0, 1.0, 0.02])), transform(None, [0.0, 0.0, -0.01]))
    found = contact_points(LevelFaces(shape, np.eye(4)), table, TOUCH)
    np.testing.assert_allclose(sorted(map(tuple, found)), sorted(map(tuple, feet[:, :2])))


@pytest.mark.parametrize("out", [-0.03, 0.0, 0.004, 0.02])
def test_a_box_over_an_edge_is_short_of_standing_by_what_its_centre_is_beyond(out: float) -> None:
    shape = box(np.array([0.1, 0.1, 0.02]))
    body = BodyView(
        "one", "object", shape, 0.3, np.array([0.01, 0.0, 0.0]), transform(None, [out - 0.01, 0.0, 0.01]), False
    )
    ground = LevelFaces(box(np.array([1.0, 1.0, 0.02])), transform(None, [-0.5, 0.0, -0.01]))
    points = contact_points(LevelFaces(shape, body.T_world_start), ground, TOUCH)
    shift, _ = least_shift([body], {"one": body.T_world_start}, {("one", "table"): points})
    assert shift == pytest.approx(max(out, 0.0), abs=1e-9)
