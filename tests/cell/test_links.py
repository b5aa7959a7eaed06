"""Links: where their meshes are, and that few vertices leave nothing of them uncovered."""

from __future__ import annotations

import itertools

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial import ConvexHull

from planners.cell.arm import load_robot
from planners.cell.asset_shelf import shipped_shelf
from planners.cell.cell import load_cell
from planners.geometry.convex import ConvexShape, HullSettings, enclosing_hull
from planners.geometry.surface import hull_with_faces
from planners.kinematics.arm_kind import ArmKind, arm_kind
from planners.kinematics.forward import link_frames
from tests.cell.cell_probe import ARM_URDF, cell_frames, mesh_origins, moved, obj_vertices, outside
from tests.collision.coal_scene import coal_geometry
from tests.kinematics.arm_oracle import published_urdf

URDF_LINKS = {
    "base": ("base_link_inertia", "base"),
    "shoulder": ("shoulder_link", "shoulder"),
    "upper_arm": ("upper_arm_link", "upperarm"),
    "forearm": ("forearm_link", "forearm"),
    "wrist_1": ("wrist_1_link", "wrist1"),
    "wrist_2": ("wrist_2_link", "wrist2"),
    "wrist_3": ("wrist_3_link", "wrist3"),
}

ROBOTS = shipped_shelf().names("robots")


def placed_links(robot, q):
    """Return the convex pieces of each link in the frame of the base, at the joint positions q (6,) [rad]."""
    frames = np.empty((7, 4, 4))
    link_frames(robot.dh, np.eye(4), q, frames)
    return [
        [coal_geometry(ConvexShape(moved(T, piece)))[0] for piece in link.pieces]
        for T, link in zip(frames, robot.links, strict=True)
    ]


def distance(a, b):
    return coal.distance(a, coal.Transform3s(), b, coal.Transform3s(), coal.DistanceRequest(), coal.DistanceResult())


@pytest.fixture(scope="module")
def ur3e():
    return load_robot("ur3e", shipped_shelf())


def test_links_are_where_the_published_urdf_puts_their_meshes(ur3e):
    """Whole meshes are compared by how far they extend in many directions."""
    cell = load_cell("dual_ur3e_lift")
    rng = np.random.default_rng(0)
    model = pin.buildModelFromXML(published_urdf(ARM_URDF))
    data, origins = model.createData(), mesh_origins(ARM_URDF)
    directions = rng.normal(size=(3, 40))
    for q in rng.uniform(-np.pi, np.pi, (20, 6)):
        pin.framesForwardKinematics(model, data, q)
        T_base_urdf = data.oMf[model.getFrameId("base")].inverse()
        frames = cell_frames(cell, np.concatenate([q, q]))
        T_base_world = np.linalg.inv(cell.arms["left"].T_world_base)
        for i, link in enumerate(ur3e.links):
            urdf_link, mesh = URDF_LINKS[link.name]
            T_base_link = (T_base_urdf * data.oMf[model.getFrameId(urdf_link)]).homogeneous
            vertices = obj_vertices(f"arms/ur3e/collision/{mesh}.obj")
            published = moved(T_base_link @ origins[urdf_link], vertices)
            ours = moved(T_base_world @ frames[f"left/{i}"], link.points)
            np.testing.assert_allclose((ours @ directions).max(axis=0), (published @ directions).max(axis=0), atol=1e-8)


@pytest.mark.slow
def test_links_cover_the_visual_meshes_but_for_the_cable_and_a_millimetre(ur3e):
    """The hulls of airo-models are its visual meshes' own, up to their rounding."""
    for link in ur3e.links:
        mesh = URDF_LINKS[link.name][1]
        visual = obj_vertices(f"arms/ur3e/visual/{mesh}.obj")
        hull = obj_vertices(f"arms/ur3e/collision/{mesh}.obj")
        assert outside(visual, of=hull).max() < 1e-3


def test_the_cable_that_hangs_from_the_base_is_not_part_of_it(ur3e):
    assert ur3e.links[0].points[:, 2].min() > -1e-5


def test_a_link_of_few_vertices_contains_the_mesh_and_not_much_more(ur3e):
    for link in ur3e.links:
        (shape,) = link.shapes
        assert len(shape.vertices) <= 60
        assert shape.radius == 0.0
        assert outside(link.points, of=shape.vertices).max() < 1e-12
        wrist = link.name.startswith("wrist")
        assert outside(shape.vertices, of=link.points).max() < (1.6e-3 if wrist else 3.3e-3)


def test_unsimplified_hulls_are_closed_surfaces_around_all_points_with_faces_outward(ur3e):
    for link in ur3e.links:
        vertices, faces = hull_with_faces(link.points)
        assert {tuple(v) for v in vertices} == {tuple(p) for p in link.points}
        edges = [tuple(face[[i, (i + 1) % 3]]) for face in faces for i in range(3)]
        assert len(set(edges)) == len(edges)
        assert {edge[::-1] for edge in edges} == set(edges)
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
        assert volume == pytest.approx(ConvexHull(link.points).volume)


@pytest.mark.parametrize("vertices", [20, 40])
def test_a_simplified_hull_contains_any_cloud_of_points(vertices):
    rng = np.random.default_rng(vertices)
    for _ in range(10):
        points = rng.normal(size=(300, 3)) * rng.uniform(0.01, 1.0, 3)
        points /= np.linalg.norm(points, axis=1, keepdims=True) ** rng.uniform(0.0, 1.0)
        points = points[ConvexHull(points).vertices]
        simple = enclosing_hull(points, HullSettings(most_vertices=vertices))
        assert len(simple) <= max(vertices, 14)
        assert outside(points, of=simple).max() < 1e-9


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_links_centre_of_mass_lies_well_within_it(robot):
    """In another frame, or with another sign, it would not: links are longer than they are thick."""
    made = load_robot(robot, shipped_shelf())
    for link, (_, *com) in zip(made.links[1:], made.masses, strict=True):
        assert outside(np.array([com]), of=link.points)[0] < -5e-4, link.name


@pytest.mark.parametrize("robot", ROBOTS)
def test_neighbouring_links_hang_together_in_any_posture(robot):
    """A link in the frame of another joint, or with another sign, would leave a gap."""
    made = load_robot(robot, shipped_shelf())
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (10, 6)):
        placed = placed_links(made, q)
        for before, after in itertools.pairwise(placed):
            assert min(distance(a, b) for a in before for b in after) < 2e-3
    assert made.links[0].points[:, 2].min() > -1e-3


@pytest.mark.parametrize("robot", ROBOTS)
def test_an_arm_at_rest_is_clear_of_itself(robot):
    """Stretched out with the wrist turned down, as arms are shipped: no link touches one two joints away."""
    made = load_robot(robot, shipped_shelf())
    spherical = arm_kind(made.dh) is ArmKind.SPHERICAL_WRIST
    posture = [0.0, -20.0, 20.0, 0.0, 90.0, 0.0] if spherical else [0.0, -60.0, 60.0, -90.0, -90.0, 0.0]
    placed = placed_links(made, np.radians(posture))
    for (i, before), (j, after) in itertools.combinations(enumerate(placed), 2):
        if j > i + 1:
            assert min(distance(a, b) for a in before for b in after) > 2e-3, (i, j)


def test_the_ur3_has_its_own_table_and_the_links_of_the_ur3e(ur3e):
    ur3 = load_robot("ur3", shipped_shelf())
    assert ur3.dh[3, 2] == 0.11235
    assert not np.array_equal(ur3.dh, ur3e.dh)
    for ours, stand_in in zip(ur3.links, ur3e.links, strict=True):
        np.testing.assert_array_equal(ours.points, stand_in.points)
