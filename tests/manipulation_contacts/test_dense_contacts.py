"""The dense contact state graph by its laws: what touches stays and touches, and nothing goes below the support."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from planners.errors import LiftwrightError
from planners.geometry.polygon import area, centroid, rectangle
from planners.geometry.polyhedron import ConvexPrism
from planners.geometry.pose import inverse, rotation_z, transform
from planners.manipulation.contacts.contact_states import NO_CONTACT
from planners.manipulation.contacts.dense_contact_states import (
    ContactSampling,
    DenseContactStateGraph,
    RestingPlate,
)

SUPPORT = 1.094


def hull_prism(seed: int) -> ConvexPrism:
    """A random convex plate, its frame somewhere beside its middle."""
    points = np.random.default_rng(seed).normal(scale=0.2, size=(7, 2))
    return ConvexPrism.from_outline(points[ConvexHull(points).vertices], 0.03)


def regular(n: int) -> ConvexPrism:
    return ConvexPrism.from_outline([[0.2 * np.cos(a), 0.2 * np.sin(a)] for a in 2 * np.pi / n * np.arange(n)], 0.05)


PLATES = {
    "acrylic": (ConvexPrism.from_outline(rectangle(0.3, 0.3), 0.04), 0.0),
    "plywood": (ConvexPrism.from_outline(rectangle(0.4, 0.5), 0.044), math.radians(20)),
    "triangle": (ConvexPrism.from_outline([[0, 0], [0.4, 0.05], [0.1, 0.3]], 0.02), -2.5),
    "hexagon": (regular(6), 1.0),
    "random 1": (hull_prism(1), 0.3),
    "random 2": (hull_prism(2), 3.0),
}


def pose_at_rest(yaw: float, shape: ConvexPrism) -> np.ndarray:
    return transform(rotation_z(yaw), [0.3, -0.1, SUPPORT + 0.5 * shape.height])


def dense(shape: ConvexPrism, yaw: float, sampling: ContactSampling | None = None) -> DenseContactStateGraph:
    com = np.array([*centroid(shape.outline), 0.0]) + np.array([0.01, -0.02, 0.005])
    return DenseContactStateGraph.build(shape, com, pose_at_rest(yaw, shape), sampling)


@pytest.fixture(scope="module", params=list(PLATES))
def graph(request) -> DenseContactStateGraph:
    return dense(*PLATES[request.param])


@pytest.fixture(scope="module")
def acrylic() -> DenseContactStateGraph:
    return dense(*PLATES["acrylic"])


def corner_heights(graph: DenseContactStateGraph, T: np.ndarray) -> np.ndarray:
    """(m, n) heights of the bottom corners above the support at poses (m, 4, 4)."""
    corners = graph.plate.shape.bottom_vertices
    return T[:, 2, :3] @ corners.T + T[:, 2, 3:] - SUPPORT


def mirrored_keys(graph: DenseContactStateGraph, mirror: np.ndarray) -> set[tuple[float, ...]]:
    """Poses relative to the pose at rest, seen in a mirror of the plate's frame at rest."""
    at_rest = inverse(graph.plate.T_world_plate)
    return {tuple(np.round(mirror @ at_rest @ p.T_world_plate @ mirror, 9).ravel() + 0.0) for p in graph.poses}


@pytest.mark.parametrize("name", ["acrylic", "plywood"])
def test_a_rectangle_has_the_papers_151_poses(name):
    assert len(dense(*PLATES[name]).poses) == 151


@pytest.mark.parametrize("side", [0.05, 0.08, 0.1, 0.15, 0.2, 0.25])
def test_a_plate_of_any_size_gets_off_the_support(side):
    graph = dense(ConvexPrism.from_outline(rectangle(side, side), 0.02), 0.3)
    in_contact = np.array([pose.contact.element != "none" for pose in graph.poses])
    assert any(in_contact[a] != in_contact[b] for a, b in graph.edges)


def test_every_contact_state_is_sampled_as_often_as_the_settings_say(graph):
    n = len(graph.plate.shape.outline)
    kinds = [pose.contact.element for pose in graph.poses]
    assert kinds == ["face"] + ["edge"] * 10 * n + ["vertex"] * 15 * n + ["none"] * 50
    assert graph.poses[graph.flat].contact.element == "face"
    assert graph.poses[graph.flat].T_world_plate == pytest.approx(graph.plate.T_world_plate, abs=0)
    assert [kinds[k] for k in graph.lifted] == ["none"] * 50


def test_each_pose_is_the_rest_pose_tilted_about_a_horizontal_axis(graph):
    for pose in graph.poses:
        expected = Rotation.from_rotvec([*pose.tilt, 0.0]).as_matrix() @ graph.plate.T_world_plate[:3, :3]
        assert pose.T_world_plate[:3, :3] == pytest.approx(expected, abs=1e-12)


def test_exactly_the_corners_of_the_contact_state_touch(graph):
    corners = graph.plate.shape.bottom_vertices
    for pose in graph.poses:
        heights = corner_heights(graph, pose.T_world_plate[None])[0]
        touching = corners[np.abs(heights) < 1e-9]
        assert sorted(map(tuple, touching)) == sorted(map(tuple, pose.contact_points))
        assert heights.min() == pytest.approx(pose.clearance, abs=1e-9)
        assert pose.restraint == {"face": 3, "edge": 2, "vertex": 1, "none": 0}[pose.contact.element]


def test_touching_corners_are_where_they_are_at_rest(graph):
    at_rest = graph.plate.T_world_plate
    for pose in graph.poses:
        here = pose.contact_points @ pose.T_world_plate[:3, :3].T + pose.T_world_plate[:3, 3]
        there = pose.contact_points @ at_rest[:3, :3].T + at_rest[:3, 3]
        assert here == pytest.approx(there, abs=1e-9)


def test_lifted_poses_keep_the_centre_of_mass_above_its_place_at_rest(graph):
    at_rest = graph.plate.com_world(graph.plate.T_world_plate)
    clearances = {graph.sampling.goal_height, graph.sampling.goal_height + graph.sampling.lifted_step}
    for k in graph.lifted:
        com = graph.plate.com_world(graph.poses[k].T_world_plate)
        assert com[:2] == pytest.approx(at_rest[:2], abs=1e-9)
        assert graph.poses[k].clearance in clearances


def test_no_pose_is_sampled_twice(graph):
    poses = np.array([pose.T_world_plate[:3].ravel() for pose in graph.poses])
    gaps = np.linalg.norm(poses[:, None] - poses[None], axis=2) + np.eye(len(poses))
    assert gaps.min() > 1e-3


def test_every_motion_keeps_its_contact_and_stays_above_the_support(graph):
    rng = np.random.default_rng(0)
    corners = graph.plate.shape.bottom_vertices
    for i, j in graph.edges:
        motion = graph.motion_between(int(i), int(j))
        s = rng.uniform(size=6)
        T = motion.poses(s)
        heights = corner_heights(graph, T)
        assert heights.min() > -1e-9
        if motion.contact == NO_CONTACT:
            expected = (1 - s) * motion.start.clearance + s * motion.end.clearance
            assert heights.min(axis=1) == pytest.approx(expected, abs=1e-9)
        else:
            touching = np.array([any(np.array_equal(c, p) for p in motion.contact_points) for c in corners])
            assert np.abs(heights[:, touching]).max() < 1e-9
            assert np.all(heights[:, ~touching] > 1e-9)


def test_every_motion_ends_at_the_poses_it_joins(graph):
    for i, j in graph.edges[::7]:
        motion = graph.motion_between(int(i), int(j))
        assert motion.pose(0.0) == pytest.approx(graph.poses[i].T_world_plate, abs=1e-12)
        assert motion.pose(1.0) == pytest.approx(graph.poses[j].T_world_plate, abs=1e-12)


def test_a_motion_back_passes_the_same_poses(graph):
    s = np.linspace(0, 1, 5)
    for i, j in graph.edges[::7]:
        forth, back = graph.motion_between(int(i), int(j)), graph.motion_between(int(j), int(i))
        assert forth.poses(s) == pytest.approx(back.poses(1 - s), abs=1e-12)
        assert forth.contact == back.contact


def test_edges_are_all_pairs_of_related_contacts_below_both_thresholds(graph):
    poses = graph.poses
    com = np.array([graph.plate.com_world(pose.T_world_plate) for pose in poses])
    orientation = Rotation.from_matrix([pose.T_world_plate[:3, :3] for pose in poses])
    threshold = 0.15 * math.sqrt(area(graph.plate.shape.outline))
    expected = []
    for i in range(len(poses)):
        turn = (orientation[i].inv() * orientation).magnitude()
        for j in range(i + 1, len(poses)):
            near = np.linalg.norm(com[i] - com[j]) < threshold and turn[j] < math.radians(17)
            if near and touches_share(poses[i], poses[j]):
                expected.append((i, j))
    assert [tuple(edge) for edge in graph.edges] == expected


def touches_share(one, other) -> bool:
    """Whether the corners that touch in one pose are some of those of the other."""
    a, b = (set(map(tuple, pose.contact_points)) for pose in (one, other))
    return a <= b or b <= a


def test_neighbours_are_the_edges_from_both_ends(graph):
    assert len(graph.neighbours) == len(graph.poses)
    pairs = {(i, int(j)) for i, near in enumerate(graph.neighbours) for j in near}
    assert pairs == {(int(i), int(j)) for i, j in graph.edges} | {(int(j), int(i)) for i, j in graph.edges}
    assert all(np.all(np.diff(near) > 0) for near in graph.neighbours)


def test_every_pose_can_be_reached_from_the_flat_one(graph):
    reached, front = {graph.flat}, [graph.flat]
    while front:
        fresh = set(graph.neighbours[front.pop()].tolist()) - reached
        reached |= fresh
        front.extend(fresh)
    assert len(reached) == len(graph.poses)


def test_poses_on_two_different_edges_are_not_joined_by_a_straight_motion(acrylic):
    poses = acrylic.poses
    edges = [k for k, pose in enumerate(poses) if pose.contact.element == "edge"]
    with pytest.raises(LiftwrightError, match="edge 0"):
        acrylic.motion_between(edges[0], edges[-1])


def test_another_vertex_becomes_lowest_only_at_the_breaks(graph):
    free = [e for e in graph.edges if graph.motion_between(int(e[0]), int(e[1])).contact == NO_CONTACT]
    broken = 0
    for i, j in free[::3]:
        motion = graph.motion_between(int(i), int(j))
        broken += len(motion.breaks)
        for start, end in zip([0.0, *motion.breaks], [*motion.breaks, 1.0], strict=True):
            width = end - start
            heights = corner_heights(graph, motion.poses(np.linspace(start + 1e-3 * width, end - 1e-3 * width, 20)))
            # One vertex is lowest throughout; along the ray of an edge two are, and level all are.
            assert (heights - heights.min(axis=1)[:, None]).max(axis=0).min() < 1e-9
    assert broken > 0


def test_the_length_of_a_motion_is_what_finer_steps_measure_and_no_less_than_the_direct_way(graph):
    for i, j in graph.edges[::29]:
        motion = graph.motion_between(int(i), int(j))
        T = motion.poses(np.linspace(0, 1, 4001))
        com = graph.plate.com_world(T)
        orientation = Rotation.from_matrix(T[:, :3, :3])
        turn = (orientation[:-1].inv() * orientation[1:]).magnitude().sum()
        way = float(np.linalg.norm(np.diff(com, axis=0), axis=1).sum())
        assert motion.length.rotation == pytest.approx(turn, rel=1e-3, abs=1e-6)
        assert motion.length.com_travel == pytest.approx(way, rel=2e-3, abs=1e-6)
        assert motion.length.com_travel > float(np.linalg.norm(com[-1] - com[0])) - 1e-12


def test_the_travel_of_an_edge_is_the_way_of_its_farthest_corner(acrylic):
    vertices = acrylic.plate.shape.polyhedron.vertices
    for k in range(0, len(acrylic.edges), 50):
        ends = [acrylic.poses[end].T_world_plate for end in acrylic.edges[k]]
        places = [vertices @ T[:3, :3].T + T[:3, 3] for T in ends]
        assert acrylic.travel(k) == pytest.approx(np.linalg.norm(places[0] - places[1], axis=1).max())


@pytest.mark.parametrize("name", list(PLATES))
def test_turning_the_plate_at_rest_turns_every_pose_and_keeps_the_edges(name):
    shape, _ = PLATES[name]
    plain, turned = dense(shape, 0.0), dense(shape, 0.7)
    T_turn = turned.plate.T_world_plate @ inverse(plain.plate.T_world_plate)
    for a, b in zip(plain.poses, turned.poses, strict=True):
        assert b.T_world_plate == pytest.approx(T_turn @ a.T_world_plate, abs=1e-12)
    assert np.array_equal(plain.edges, turned.edges)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_poses_of_a_symmetric_plate_are_symmetric(axis):
    shape = PLATES["plywood"][0]
    graph = DenseContactStateGraph.build(shape, [0, 0, 0], pose_at_rest(0.4, shape))
    mirror = np.eye(4)
    mirror[axis, axis] = -1.0
    assert mirrored_keys(graph, np.eye(4)) == mirrored_keys(graph, mirror)


@pytest.mark.parametrize(("tilt", "azimuth"), [(2, 1), (1, 2), (2, 2), (3, 2)])
def test_a_denser_sampling_contains_the_coarser_one(tilt, azimuth):
    shape, yaw = PLATES["plywood"]
    coarse = dense(shape, yaw)
    fine = dense(shape, yaw, ContactSampling(tilt_density=tilt, azimuth_density=azimuth))
    edge, vertex = 4 * (9 * tilt + 1), 4 * (4 * tilt + 1) * (4 * azimuth - 1)
    lifted = 2 * (1 + (2 * tilt + 1) * 8 * azimuth)
    assert len(fine.poses) == 1 + edge + vertex + lifted
    keys = {tuple(np.round(pose.T_world_plate, 9).ravel() + 0.0) for pose in fine.poses}
    assert all(tuple(np.round(pose.T_world_plate, 9).ravel() + 0.0) in keys for pose in coarse.poses)


@pytest.mark.parametrize(
    "wrong",
    [
        {"edge_tilts": (0.0, 0.5, 3)},
        {"vertex_tilts": (0.5, 0.4, 3)},
        {"lifted_tilts": (0.1, 0.4, 0)},
        {"tilt_density": 0},
        {"goal_height": 0.0},
        {"rotation_threshold": -1.0},
    ],
)
def test_samplings_that_mean_nothing_are_refused(wrong):
    with pytest.raises(LiftwrightError):
        ContactSampling(**wrong)


def test_a_plate_that_is_not_flat_is_refused():
    tilted = transform(Rotation.from_euler("zx", [0.5, 0.001]).as_matrix(), [0.3, 0.1, 1.1145])
    with pytest.raises(LiftwrightError):
        RestingPlate(PLATES["acrylic"][0], np.zeros(3), tilted)
