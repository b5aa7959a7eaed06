"""Stopovers: on which faces an object is put down, and whether it stands there."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planners.regrasp.pile.stopover import Stopovers, steadiness_on
from planners.regrasp.statics.resting import resting_points
from planners.scene.moved_object import MovedObject
from planners.scene.solid import FlatFace
from planners.scene.tool_placements import StillBodies
from tests.regrasp.tool_tasks import TABLE, box, scene_of

SQUARE = np.array([[0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, -0.1, 0.0], [-0.1, 0.1, 0.0]])
BOTTOM = FlatFace(np.array([0.0, 0.0, -1.0]), SQUARE)


def stopovers_of(obj: dict) -> list[MovedObject]:
    scene = scene_of(obj)
    return list(Stopovers(StillBodies.of(scene.cell, scene.obstacles)).targets(scene.objects[0], ()))


def downward(target: MovedObject) -> tuple[float, ...]:
    """The direction in the body that looks down at a stopover."""
    return tuple(np.round(-target.T_world_goal[2, :3], 6) + 0.0)


@pytest.mark.parametrize("com", [[0.0, 0.0, 0.1], [0.06, -0.02, 0.3], [0.09, 0.09, 0.02]])
def test_a_body_tilted_by_less_than_its_steadiness_falls_back_and_by_more_it_topples(com: list[float]) -> None:
    steadiness = steadiness_on(BOTTOM, np.array(com))
    for tilt, falls_back in ((0.999 * steadiness, True), (1.001 * steadiness, False)):
        topples = []
        for tail, head in zip(SQUARE, np.roll(SQUARE, -1, axis=0), strict=True):
            edge = (head - tail) / np.linalg.norm(head - tail)
            outward = np.cross(edge, [0.0, 0.0, -1.0])
            outward *= np.sign(outward @ tail)
            turned = tail + Rotation.from_rotvec(tilt * np.cross([0.0, 0.0, 1.0], outward)).apply(np.array(com) - tail)
            topples.append((turned - tail) @ outward > 0.0)
        assert any(topples) is not falls_back


def test_a_centre_of_mass_beside_the_face_is_not_steady() -> None:
    assert steadiness_on(BOTTOM, np.array([0.12, 0.0, 0.1])) < 0.0


def test_a_box_makes_a_stopover_on_each_of_its_faces_as_it_stands_first() -> None:
    found = [downward(target) for target in stopovers_of(box("one", [0.35, 0.2], [0.35, -0.2]))]
    assert found[0] == (0.0, 0.0, -1.0)
    assert len(found) == len(set(found)) == 6


def test_a_plate_is_not_put_down_on_an_edge_it_would_topple_off() -> None:
    found = stopovers_of(box("sheet", [0.35, 0.2], [0.35, -0.2], (0.1, 0.08, 0.004)))
    assert {downward(target) for target in found} == {(0.0, 0.0, -1.0), (0.0, 0.0, 1.0)}


def test_a_cylinder_is_put_down_on_its_ends_only() -> None:
    round_one = {"shape": {"type": "cylinder", "radius": 0.04, "height": 0.1}, "goal_symmetry": "axis"}
    found = stopovers_of(box("can", [0.35, 0.2], [0.35, -0.2], (0.08, 0.08, 0.1), **round_one))
    assert {downward(target) for target in found} == {(0.0, 0.0, -1.0), (0.0, 0.0, 1.0)}


def test_an_object_bears_its_weight_wherever_it_makes_a_stopover() -> None:
    wedge = {"type": "prism", "outline": [[-0.05, -0.04], [0.05, -0.04], [0.05, 0.04]], "height": 0.06}
    place = box("wedge", [0.35, 0.2], [0.35, -0.2], (0.1, 0.08, 0.06), shape=wedge, com=[0.017, -0.013, 0.0])
    table = FlatFace(
        np.array([0.0, 0.0, 1.0]), np.array([[0, -1, TABLE], [2, -1, TABLE], [2, 1, TABLE], [0, 1, TABLE]])
    )
    found = stopovers_of(place)
    assert len(found) >= 4
    for target in found:
        body = target.body
        for T in target.goals:
            points = resting_points(body.solid.flat_pieces(), T, {"table": ([table], np.eye(4))})
            com = T[:3, :3] @ body.com + T[:3, 3]
            assert points.forces(1.0, com) is not None
            assert math.isclose(points.points[:, 2].mean(), TABLE, abs_tol=1e-6)
