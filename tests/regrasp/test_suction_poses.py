"""Suction poses, with trimesh's ray casts as the authority on whether a pad seals."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from trimesh.ray.ray_triangle import ray_triangle_id

from planners.geometry.pose import inverse, rotation_from_vector, rotation_x, rotation_z, transform
from planners.regrasp.suction.suction_hold import cup_wrenches, suction_margin, weight
from planners.regrasp.suction.suction_poses import (
    SuctionFault,
    SuctionLoad,
    SuctionPoses,
    SuctionSettings,
    is_closed_and_outward,
    suction_poses,
)
from tests.support.samples import among


@dataclass(frozen=True)
class Lip:
    radius: float = 0.0175
    max_force: float = 20.0
    mu: float = 0.5
    kappa: float = 4.5


LIP, SETTINGS = Lip(), SuctionSettings()
DOWN = np.array([0.0, 0.0, -9.81])


def arrays(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def can() -> trimesh.Trimesh:
    """A drink can: its rim is narrower than its mantle, and its lid is sunk."""
    profile = [
        [0, 0],
        [0.026, 0],
        [0.033, 0.008],
        [0.033, 0.112],
        [0.027, 0.1222],
        [0.026, 0.1222],
        [0.025, 0.118],
        [0, 0.118],
    ]
    return trimesh.creation.revolve(np.array(profile), sections=64)


def bracket() -> trimesh.Trimesh:
    """Two boxes drawn one through the other, as an L."""
    foot = trimesh.creation.box([0.16, 0.06, 0.02])
    wall = trimesh.creation.box([0.02, 0.06, 0.12])
    wall.apply_translation([-0.07, 0.0, 0.05])
    return trimesh.util.concatenate([foot, wall])


def shallow_dome(radius: float) -> trimesh.Trimesh:
    """A cap of a ball on a flat base."""
    angles = np.linspace(0.0, 0.08 / radius, 24)
    profile = np.column_stack([radius * np.sin(angles), radius * (np.cos(angles) - math.cos(angles[-1])) + 0.01])
    return trimesh.creation.revolve(np.vstack([[[0, 0], [profile[-1, 0], 0]], profile[::-1]]), sections=64)


MESHES = {
    "domino": trimesh.creation.box([0.13, 0.07, 0.02]),
    "tissue box": trimesh.creation.box([0.24, 0.115, 0.06]),
    "can": can(),
    "bracket": bracket(),
    "ring": trimesh.creation.annulus(0.02, 0.09, 0.03, sections=64),
    "dome": shallow_dome(0.5),
    "tall box": trimesh.creation.box([0.06, 0.06, 0.15]),
}


def poses_of(
    mesh: trimesh.Trimesh, lip: Lip = LIP, mass: float = 0.1, choice: SuctionSettings = SETTINGS, **load: np.ndarray
) -> SuctionPoses:
    com = load.get("com", np.array(mesh.center_mass))
    start = load.get("T_world_start", np.eye(4))
    return suction_poses(arrays(mesh), SuctionLoad(mass, com, start, DOWN, load.get("T_world_goals")), lip, choice)


class AllTriangles:
    """Stands for a search tree in trimesh's ray casts: every triangle is a candidate of every ray."""

    def __init__(self, triangles: np.ndarray) -> None:
        self.bounds = np.concatenate([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])
        self._all = list(range(len(triangles)))

    def intersection(self, bounds: np.ndarray) -> list[int]:
        return self._all


def first_heights(mesh: trimesh.Trimesh, T_object_tool: np.ndarray, radius: float, above: float) -> np.ndarray:
    """Return the heights over the pad's plane at which rays from above, all over the pad, first hit the mesh."""
    radii, turns = np.meshgrid(radius * np.array([0.02, 0.4, 0.75, 0.999]), np.linspace(0, 2 * math.pi, 13)[:-1] + 0.1)
    rim = np.stack([radii * np.cos(turns), radii * np.sin(turns), np.full(radii.shape, above)], axis=-1).reshape(-1, 3)
    origins = rim @ T_object_tool[:3, :3].T + T_object_tool[:3, 3]
    down = np.tile(-T_object_tool[:3, 2], (len(origins), 1))
    middles = mesh.triangles_center - T_object_tool[:3, 3]
    reaches = np.linalg.norm(mesh.triangles - mesh.triangles_center[:, None], axis=2).max(axis=1)
    near = mesh.triangles[np.linalg.norm(middles @ T_object_tool[:3, :2], axis=1) <= radius + reaches]
    _, rays, places = ray_triangle_id(near, origins, down, tree=AllTriangles(near), multiple_hits=True)
    heights = np.full(len(origins), -np.inf)
    np.maximum.at(heights, rays, (places - T_object_tool[:3, 3]) @ T_object_tool[:3, 2])
    return heights


@pytest.mark.parametrize("name", MESHES)
def test_under_every_pad_the_whole_surface_is_within_the_flatness(name):
    mesh = MESHES[name]
    places = poses_of(mesh).poses[:: SETTINGS.rolls]
    assert places
    for pose in places:
        heights = first_heights(mesh, pose.T_object_tool, LIP.radius + SETTINGS.rim, 0.9 * SETTINGS.stand_off)
        assert np.abs(heights).max() <= SETTINGS.flatness + 1e-6


@pytest.mark.parametrize("name", ["domino", "can", "bracket", "ring"])
def test_wherever_a_pad_seals_and_holds_there_is_a_pose_nearby(name):
    mesh = MESHES[name]
    points = np.array([pose.T_object_tool[:3, 3] for pose in poses_of(mesh).poses])
    rng = np.random.default_rng(0)
    found, triangles = trimesh.sample.sample_surface(mesh, 300, seed=3)
    for point, normal in zip(found, mesh.face_normals[triangles], strict=True):
        if normal[2] < 0.99:
            continue
        T = transform(trimesh.geometry.align_vectors([0, 0, 1], normal)[:3, :3] @ rotation_z(rng.uniform(0, 6)), point)
        wrench = cup_wrenches(weight(0.1, DOWN), np.eye(4), np.array(mesh.center_mass), T)
        # A millimetre of slack, and nothing of the object inside or above the place.
        heights = first_heights(mesh, T, LIP.radius + SETTINGS.rim + 1e-3, 1.0)
        if np.abs(heights).max() < 1e-6 and suction_margin(wrench, LIP) > 0.05:
            away = np.linalg.norm(points - point, axis=1).min()
            assert away <= SETTINGS.cluster + 2 * SETTINGS.spacing


@pytest.mark.parametrize("name", MESHES)
def test_poses_are_right_handed_frames_on_the_surface_with_evenly_spread_rolls(name):
    found = poses_of(MESHES[name])
    for first in range(0, len(found.poses), SETTINGS.rolls):
        group = found.poses[first : first + SETTINGS.rolls]
        # Round and round, one way or the other, from either sense of the facet's longest side.
        assert group[0].roll in (0, SETTINGS.rolls // 2)
        steps = {(after.roll - before.roll) % SETTINGS.rolls for before, after in itertools.pairwise(group)}
        assert steps in ({1}, {SETTINGS.rolls - 1})
        for pose in group:
            turn = rotation_z(2 * math.pi * (pose.roll - group[0].roll) / SETTINGS.rolls)
            assert pose.T_object_tool[:3, :3] == pytest.approx(group[0].T_object_tool[:3, :3] @ turn, abs=1e-9)
            assert pose.T_object_tool[:3, 3] == pytest.approx(group[0].T_object_tool[:3, 3])
            assert np.linalg.det(pose.T_object_tool[:3, :3]) == pytest.approx(1.0)
        facet = found.facets[group[0].facet]
        assert group[0].T_object_tool[:3, 2] @ facet.T_body_facet[:3, 2] > math.cos(SETTINGS.facets.largest_angle)


@pytest.mark.parametrize("name", MESHES)
def test_margins_are_those_of_the_suction_cones_and_never_negative(name):
    mesh = MESHES[name]
    for pose in poses_of(mesh).poses:
        wrench = cup_wrenches(weight(0.1, DOWN), np.eye(4), np.array(mesh.center_mass), pose.T_object_tool)
        assert pose.margin == pytest.approx(float(suction_margin(wrench, LIP)), abs=1e-9)
        assert pose.margin >= 0.0


@pytest.mark.parametrize("name", ["domino", "tissue box", "can", "tall box"])
def test_the_middle_of_the_top_comes_first(name):
    mesh = MESHES[name]
    first = poses_of(mesh).poses[0]
    assert first.central
    assert first.T_object_tool[:3, 2] == pytest.approx([0, 0, 1])
    assert first.T_object_tool[:2, 3] == pytest.approx(mesh.center_mass[:2], abs=1e-6)


def test_which_facet_is_on_top_is_a_matter_of_the_start_pose():
    mesh = MESHES["tissue box"]
    on_its_side = transform(rotation_x(math.pi / 2))
    first = poses_of(mesh, T_world_start=on_its_side).poses[0]
    assert on_its_side[:3, :3] @ first.T_object_tool[:3, 2] == pytest.approx([0, 0, 1], abs=1e-9)


@pytest.mark.parametrize("name", MESHES)
def test_after_the_first_place_margins_fall_but_for_the_step_within_which_they_are_equal(name):
    margins = np.array([pose.margin for pose in poses_of(MESHES[name]).poses[SETTINGS.rolls :: SETTINGS.rolls]])
    assert np.all(np.diff(margins) <= SETTINGS.margin_step + 1e-9)


@pytest.mark.parametrize("name", MESHES)
def test_places_on_one_facet_are_a_cluster_apart(name):
    found = poses_of(MESHES[name]).poses[:: SETTINGS.rolls]
    for facet in {pose.facet for pose in found}:
        points = np.array([pose.T_object_tool[:3, 3] for pose in found if pose.facet == facet])
        gaps = np.linalg.norm(points[:, None] - points[None], axis=2) + np.eye(len(points))
        assert gaps.min() >= SETTINGS.cluster - 1e-8


@pytest.mark.parametrize("name", among(MESHES, [*MESHES][:2]))
@given(turn=st.tuples(*[st.floats(-3, 3)] * 3), shift=st.tuples(*[st.floats(-1, 1)] * 3))
@settings(max_examples=4, deadline=None)
def test_poses_move_with_the_mesh(name, turn, shift):
    mesh = MESHES[name]
    T = transform(rotation_from_vector(np.array(turn)), np.array(shift))
    vertices, faces = arrays(mesh)
    moved = trimesh.Trimesh(vertices @ T[:3, :3].T + T[:3, 3], faces, process=False)
    com = np.array(mesh.center_mass)
    expected = poses_of(mesh, com=com).poses
    found = poses_of(moved, com=T[:3, :3] @ com + T[:3, 3], T_world_start=inverse(T)).poses
    assert len(found) == len(expected)
    for pose, other in zip(expected, found, strict=True):
        assert inverse(T) @ other.T_object_tool == pytest.approx(pose.T_object_tool, abs=1e-6)


@pytest.mark.parametrize("name", ["domino", "tissue box", "tall box"])
def test_dividing_triangles_changes_no_place(name):
    def places(mesh: trimesh.Trimesh) -> set[tuple[float, ...]]:
        return {tuple(np.round(pose.T_object_tool[:3, 3], 5) + 0.0) for pose in poses_of(mesh).poses}

    assert places(MESHES[name].subdivide().subdivide()) == places(MESHES[name])


def test_the_mantle_of_a_can_is_too_curved():
    found = poses_of(MESHES["can"], Lip(radius=0.0065), mass=0.01)
    assert all(abs(pose.T_object_tool[2, 2]) > 0.99 for pose in found.poses)
    assert SuctionFault.CURVED in {candidate.reason for candidate in found.candidates}


@pytest.mark.parametrize(("radius", "seals"), [(0.2, False), (0.4, True)])
def test_a_dome_seals_where_its_height_under_the_pad_is_within_the_flatness(radius, seals):
    sagitta = radius - math.sqrt(radius**2 - LIP.radius**2)
    assert (sagitta < SETTINGS.flatness) == seals
    mesh = shallow_dome(radius)
    on_dome = [pose for pose in poses_of(mesh).poses if pose.T_object_tool[2, 2] > 0.0]
    assert bool(on_dome) == seals


def test_a_pad_stays_clear_of_a_wall_drawn_through_the_foot():
    found = poses_of(MESHES["bracket"])
    for pose in found.poses:
        x, _, z = pose.T_object_tool[:3, 3]
        if pose.T_object_tool[2, 2] > 0.99 and z < 0.02:
            assert x - LIP.radius >= -0.06
    assert any("Another part" in reason for reason in found.rejections.counts())


def test_no_pad_lies_between_two_bodies_that_touch():
    low, high = trimesh.creation.box([0.2, 0.2, 0.02]), trimesh.creation.box([0.1, 0.1, 0.1])
    high.apply_translation([0.0, 0.0, 0.06])
    for pose in poses_of(trimesh.util.concatenate([low, high]), com=np.zeros(3)).poses:
        x, y, z = pose.T_object_tool[:3, 3]
        assert not (abs(z - 0.01) < 1e-6 and max(abs(x), abs(y)) < 0.05)


def test_a_weight_at_the_limit_is_held_in_the_middle_and_a_little_more_is_not():
    mesh, heaviest = MESHES["domino"], LIP.max_force / 9.81
    held = poses_of(mesh, mass=0.999 * heaviest)
    assert {tuple(np.round(pose.T_object_tool[:3, 3], 6)) for pose in held.poses} == {(0.0, 0.0, 0.01)}
    lost = poses_of(mesh, mass=1.001 * heaviest)
    assert lost.poses == ()
    assert "suction: " + SuctionFault.WEAK in lost.rejections.counts()


def test_one_of_the_goals_must_be_held():
    mesh, mass = MESHES["tissue box"], 0.6
    upright, on_its_side = np.eye(4), transform(rotation_x(math.pi / 2))
    at_start = poses_of(mesh, mass=mass).poses
    to_both = poses_of(mesh, mass=mass, T_world_goals=np.array([on_its_side, upright])).poses
    to_side = poses_of(mesh, mass=mass, T_world_goals=np.array([on_its_side])).poses
    assert [pose.margin for pose in to_both] == pytest.approx([pose.margin for pose in at_start])
    assert len(to_side) < len(at_start)


def test_candidates_are_the_places_and_an_even_choice_of_those_rejected():
    found = poses_of(MESHES["tissue box"])
    kept = np.array([c.point for c in found.candidates if c.reason is None])
    assert kept == pytest.approx(np.array([pose.T_object_tool[:3, 3] for pose in found.poses[:: SETTINGS.rolls]]))
    reasons = {candidate.reason for candidate in found.candidates}
    counted = {count.removeprefix("suction: ") for count in found.rejections.counts()}
    assert {str(reason) for reason in reasons if reason} == counted
    assert len(found.candidates) < sum(found.rejections.counts().values()) / 4


def test_the_nearest_miss_of_the_border_is_reported():
    strip = trimesh.creation.box([0.2, 0.036, 0.036])
    found = poses_of(strip)
    assert found.poses == ()
    (rejection,) = [r for r, _ in found.rejections.most_common(5) if r.reason == SuctionFault.BORDER]
    assert rejection.needed == pytest.approx(LIP.radius + SETTINGS.rim)
    assert rejection.available == pytest.approx(0.018)


def test_what_the_cup_cannot_bear_is_told_in_its_unit_at_the_best_place():
    """The best place of a slab whose mass hangs aside is where its lever about the pad is shortest."""
    slab, mass, com = trimesh.creation.box([0.2, 0.2, 0.01]), 0.6, np.array([0.3, 0.0, 0.0])
    found = poses_of(slab, mass=mass, com=com)
    assert found.poses == ()
    weak = [rejection for rejection, _ in found.rejections.most_common() if rejection.reason == SuctionFault.WEAK]
    (rejection,) = weak
    assert rejection.unit == "Nm"
    assert rejection.available == pytest.approx(np.pi * LIP.radius * LIP.kappa / np.sqrt(2.0))
    lever = rejection.needed / (mass * 9.81)
    assert 0.3 - 0.1 < lever < 0.3 - 0.1 + LIP.radius + SETTINGS.rim + SETTINGS.spacing


@pytest.mark.parametrize("spare", [1e-3, 3e-4])
def test_a_leg_that_is_hardly_wider_than_the_pad_has_a_place(spare):
    """An L of two legs: its centroid is on neither, so no line of a grid about it follows a leg."""
    width, length = 2 * (LIP.radius + SETTINGS.rim) + spare, 0.2

    def drawn_l(width: float) -> trimesh.Trimesh:
        outline = [[0, 0], [length, 0], [length, width], [width, width], [width, 0.7 * length], [0, 0.7 * length]]
        low, high = (np.column_stack([outline, np.full(6, z)]) for z in (0.0, 0.03))
        caps = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
        walls = [f for k in range(6) for j in [(k + 1) % 6] for f in ((k, j, j + 6), (k, j + 6, k + 6))]
        return trimesh.Trimesh(np.vstack([low, high]), np.vstack([caps + 6, caps[:, ::-1], walls]), process=False)

    def on_top(mesh: trimesh.Trimesh) -> bool:
        return any(pose.T_object_tool[2, 2] > 0.99 for pose in poses_of(mesh).poses)

    corner = width * (math.sqrt(2.0) - 1.0)
    assert on_top(drawn_l(width))
    assert not on_top(drawn_l((LIP.radius + SETTINGS.rim) * 2.0 - corner))


@pytest.mark.parametrize("lip", [Lip(radius=0.006), Lip(radius=0.012), Lip(radius=0.03, max_force=60.0, kappa=13.5)])
@pytest.mark.parametrize("name", ["can", "bracket", "tissue box"])
def test_pads_of_any_size_keep_their_distance_from_the_border(name, lip):
    mesh = MESHES[name]
    for pose in poses_of(mesh, lip).poses[:: SETTINGS.rolls]:
        reach = max(lip.radius + SETTINGS.rim, SETTINGS.border)
        heights = first_heights(mesh, pose.T_object_tool, reach, 0.9 * SETTINGS.stand_off)
        # What touches the pad is within the flatness; between rim and border nothing falls away.
        assert np.abs(heights).max() <= SETTINGS.flatness + reach * math.sin(SETTINGS.facets.largest_angle)


def broken_meshes() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    vertices, faces = arrays(MESHES["tissue box"])
    bad = vertices.copy()
    bad[3, 1] = np.nan
    return {
        "open": (vertices, faces[1:]),
        "inside out": (vertices, faces[:, ::-1]),
        "one triangle turned": (vertices, np.vstack([faces[:1, ::-1], faces[1:]])),
        "not a number": (bad, faces),
        "no triangles": (vertices, np.empty((0, 3), dtype=np.int64)),
        "no such vertex": (vertices[:-1], faces),
        "flat": (vertices * [1, 1, 0], faces),
        "a point": (vertices * 0.0, faces),
        "a sheet": (vertices[:3], np.array([[0, 1, 2], [0, 2, 1]])),
    }


@pytest.mark.parametrize("fault", broken_meshes())
def test_broken_surfaces_have_no_poses_and_a_reason(fault):
    surface = broken_meshes()[fault]
    found = suction_poses(surface, SuctionLoad(0.1, np.zeros(3), np.eye(4), DOWN), LIP)
    assert found.poses == ()
    assert found.rejections.counts() == {"suction: " + SuctionFault.NOT_CLOSED: 1}


def test_an_object_smaller_than_the_pad_has_no_poses_and_a_reason():
    found = poses_of(trimesh.creation.icosphere(subdivisions=3, radius=0.03))
    assert found.poses == ()
    assert found.rejections.counts() == {"suction: " + SuctionFault.NO_FACET: 1}


@pytest.mark.parametrize("sides", [(0.03, 0.03, 0.03), (0.012, 0.02, 0.028), (0.06, 0.002, 0.015)])
def test_of_an_object_smaller_than_the_pad_the_largest_disc_that_a_face_has_room_for_is_told(sides):
    found = poses_of(trimesh.creation.box(sides))
    ((rejection, _),) = found.rejections.most_common()
    assert rejection.reason == SuctionFault.NO_FACET
    assert rejection.unit == "m"
    # A box's largest face has its two longest sides.
    assert rejection.available == pytest.approx(sorted(sides)[1])
    assert rejection.needed == pytest.approx(2.0 * (LIP.radius + SETTINGS.rim))


@pytest.mark.parametrize("name", MESHES)
def test_trimesh_agrees_on_what_is_closed(name):
    assert is_closed_and_outward(*arrays(MESHES[name])) == MESHES[name].is_volume
