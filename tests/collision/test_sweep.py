"""Edges and paths: what is called free is free at every configuration in between."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from planners.collision.kernel import make_scratch, place_center, place_frames
from planners.collision.model import Attached, CollisionModel, Fixed, Riding, Upright
from planners.collision.sweep import bound_travel
from planners.geometry.convex import CollisionBody, box, capsule
from planners.geometry.pose import frame_from_z, transform
from tests.collision.coal_scene import world_frames
from tests.collision.synthetic_cell import ARMS, HOME, build_model, held, resting, sphere

STEP = 0.002
"""Of the dense sampling [rad]."""


@pytest.fixture(scope="module")
def model():
    return build_model()


def dense(q_from, q_to, step=STEP):
    n = int(np.ceil(np.abs(q_to - q_from).max() / step)) + 1
    return q_from + np.linspace(0.0, 1.0, n)[:, None] * (q_to - q_from)


def hanging():
    """Left holds the plate upside down in the air, the cable stands on it."""
    return {
        "plate": Attached("left", transform(position=[0.0, 0.1, 0.36])),
        "cup": Riding("plate", transform(position=[0.03, 0.02, 0.035])),
        "cable": Upright("cup", np.array([0.0, 0.0, 0.02])),
    }


def edges(rng, query, n, length):
    """Return edges from free configurations, some of one arm only, some of one joint."""
    starts = HOME + rng.uniform(-0.6, 0.6, size=(20 * n, 12))
    starts = starts[query.first_collision(starts) < 0][:n]
    steps = rng.normal(size=starts.shape)
    steps[::3, :6] = 0.0
    steps[1::9] *= np.eye(12)[rng.integers(0, 12, size=len(steps[1::9]))]
    return starts, starts + length * steps / np.linalg.norm(steps, axis=1)[:, None]


@pytest.mark.parametrize("placements", [resting, held, hanging])
@pytest.mark.parametrize(("margin", "length"), [(0.0, 0.3), (0.003, 0.3), (0.003, 2.0), (0.02, 0.8)])
def test_a_free_edge_contains_no_sampled_collision(model, placements, margin, length):
    query, touching = model.scene(placements(), margin=margin), model.scene(placements())
    starts, ends = edges(np.random.default_rng(1), query, 120, length)
    assert len(starts) > 40
    verdicts = [query.edge(a, b).free for a, b in zip(starts, ends, strict=True)]
    assert 0 < sum(verdicts) < len(verdicts)
    for a, b, free in zip(starts, ends, verdicts, strict=True):
        if free:
            assert np.all(touching.first_collision(dense(a, b)) == -1)
            assert np.all(query.first_collision(np.array([a, b])) == -1)


@pytest.mark.parametrize("margin", [0.0, 0.003])
def test_an_edge_that_keeps_clear_everywhere_is_free(model, margin):
    """The sweep is not timid: dense samples that keep half a millimetre more than the margin suffice."""
    query = model.scene(held(), margin=margin)
    roomy = model.scene(held(), margin=margin + 0.0005)
    starts, ends = edges(np.random.default_rng(2), roomy, 150, 0.5)
    kept = 0
    for a, b in zip(starts, ends, strict=True):
        if np.all(roomy.first_collision(dense(a, b, 0.0005)) == -1):
            kept += 1
            assert query.edge(a, b).free
    assert kept > 20


@pytest.mark.parametrize("seed", range(30))
def test_a_thin_wall_between_two_samples_is_seen(seed):
    """A wall of a micrometre, anywhere between the ends of a fist's way, cannot be passed."""
    rng = np.random.default_rng(seed)
    fist = CollisionBody("fist", "right", "right/6", (sphere(FIST, 0.001),))
    wall = CollisionBody("wall", "obstacle", "wall", (box([1e-6, 8.0, 8.0]),))
    model = CollisionModel.build(ARMS, [fist, wall])
    q_from, q_to = rng.uniform(-2, 2, size=(2, 12))
    start, end = (world_frames(q, {})["right/6"][:3] @ FIST_POINT for q in (q_from, q_to))
    normal = (end - start) / np.linalg.norm(end - start)
    for share in rng.uniform(0.05, 0.95, 30):
        T_world_wall = transform(frame_from_z(normal, [0.3, 0.5, 0.8])[:, [2, 0, 1]], start + share * (end - start))
        query = model.scene({"wall": Fixed(T_world_wall)})
        assert np.all(query.first_collision(np.array([q_from, q_to])) == -1)
        result = query.edge(q_from, q_to)
        assert query.pair_names(result.pair) == ("fist", "wall")
        assert 0.0 < result.fraction < 1.0


FIST = (0.05, 0.0, 0.3)
FIST_POINT = np.append(FIST, 1.0)


@pytest.mark.parametrize("placements", [resting, held, hanging])
def test_no_two_points_move_farther_against_each_other_than_their_bounds_add_up_to(model, placements):
    """From the middle of an interval on, the distance of two shapes' vertices changes by no more than that."""
    query = model.scene(placements())
    rng = np.random.default_rng(7)
    tightest = np.inf
    for _ in range(12):
        q, steps = rng.uniform(-2, 2, 12), rng.uniform(0, 0.4, 12) * rng.integers(0, 2, 12)
        bounds = travel_bounds(query.kernel, q, steps)
        before = placed_vertices(query, q, placements())
        after = placed_vertices(query, q + steps * rng.choice([-1.0, 1.0], 12), placements())
        for (a, b), bound in zip(query.kernel.pairs[:, :2], bounds, strict=True):
            change = np.abs(cdist(before[a], before[b]) - cdist(after[a], after[b])).max()
            assert change <= bound + 1e-12
            if change > 1e-3:
                tightest = min(tightest, bound / change)
    assert tightest < 1.5


def travel_bounds(kernel, q, steps):
    """Return the bound of each pair's relative motion."""
    scratch = make_scratch(kernel)
    place_frames(kernel, q, scratch.frames)
    frames, centers, travel = scratch.frames, scratch.centers, scratch.travel
    for shape in kernel.shapes:
        place_center(kernel.spheres, kernel.shape_frame, frames, shape, centers)
        bound_travel(kernel.drivers, kernel.spheres, kernel.shape_frame, shape, steps, frames, centers, travel)
    a, b, column_a, column_b = kernel.pairs.T
    return travel[a, column_a] + travel[b, column_b]


def placed_vertices(query, q, placements):
    """Return the vertices of every shape in the world, by matrix products."""
    frames = world_frames(q, placements)
    shapes = [(frames[body.frame], shape) for body in query.model.bodies for shape in body.shapes]
    return [shape.vertices @ T[:3, :3].T + T[:3, 3] for T, shape in shapes]


@pytest.mark.slow
def test_a_free_edge_sinks_no_deeper_than_a_negative_margin_allows():
    """A block on the flange grazes a wall; free edges stay within the millimetre, and some do use it."""
    block = CollisionBody("block", "right", "right/6", (box([0.1, 0.1, 0.1]).placed(transform(position=[0, 0, 0.1])),))
    wall = CollisionBody("wall", "obstacle", "wall", (box([0.2, 8.0, 8.0]),))
    model = CollisionModel.build(ARMS, [block, wall])
    elsewhere = {"wall": Fixed(transform(position=[100.0, 0, 0]))}
    far_off = model.scene(elsewhere)
    rng = np.random.default_rng(8)
    grazing = 0
    for _ in range(200):
        q_from = HOME + rng.uniform(-0.6, 0.6, 12)
        q_to = q_from + rng.normal(scale=0.002, size=12)
        farthest = placed_vertices(far_off, q_from, elsewhere)[0][:, 0].max()
        wall_pose = {"wall": Fixed(transform(position=[farthest + 0.1 + rng.uniform(-0.003, 0.001), 0, 0]))}
        query = model.scene(wall_pose, margins={("block", "wall"): -0.001})
        if query.edge(q_from, q_to).free:
            for q in dense(q_from, q_to, 0.0002):
                deepest = placed_vertices(query, q, wall_pose)[0][:, 0].max()
                assert deepest <= wall_pose["wall"].T_world_body[0, 3] - 0.1 + 0.001 + 1e-9
                grazing += deepest > wall_pose["wall"].T_world_body[0, 3] - 0.1
    assert grazing > 100


def test_an_edge_is_free_in_both_directions_or_in_none(model):
    query = model.scene(held(), margin=0.003)
    starts, ends = edges(np.random.default_rng(3), query, 100, 0.5)
    for a, b in zip(starts, ends, strict=True):
        assert query.edge(a, b).free == query.edge(b, a).free


def test_an_edge_of_no_length_is_its_configuration(model):
    query = model.scene(held(), margin=0.003)
    Q = HOME + np.random.default_rng(4).uniform(-0.6, 0.6, size=(100, 12))
    for q, found in zip(Q, query.first_collision(Q), strict=True):
        assert query.edge(q, q).pair == found


def test_what_an_edge_reports_collides_there(model):
    """With room to spare between margin and contact, the pair reported is within the margin where it is noticed."""
    query = model.scene(resting(), margin=0.003)
    starts, ends = edges(np.random.default_rng(5), query, 150, 1.0)
    for a, b in zip(starts, ends, strict=True):
        result = query.edge(a, b)
        if not result.free:
            names = query.pair_names(result.pair)
            alone = model.scene(resting(), margin=0.003, only=lambda x, y, names=names: {x.name, y.name} == set(names))
            assert alone.first_collision(a + result.fraction * (b - a))[0] >= 0


def test_a_path_is_free_when_all_its_edges_are(model):
    query = model.scene(held(), margin=0.003)
    rng = np.random.default_rng(6)
    verdicts = []
    for _ in range(60):
        Q = HOME + np.cumsum(rng.normal(scale=0.04, size=(6, 12)), axis=0)
        free = all(query.edge(a, b).free for a, b in itertools.pairwise(Q))
        result = query.path(Q)
        assert result.free == free
        if not free:
            assert 0.0 <= result.fraction <= 5.0
        verdicts.append(free)
    assert 0 < sum(verdicts) < len(verdicts)


def test_a_path_of_one_configuration_is_that_configuration(model):
    query = model.scene(held())
    assert query.path(HOME[None]).pair == query.first_collision(HOME)[0]


def test_bodies_that_do_not_move_against_each_other_are_not_swept():
    """A rod in the hand touches nothing of its own arm, however far the arm turns as a whole."""
    rod = CollisionBody("rod", "right", "rod", (capsule([0, 0, 0], [0, 0, 0.2], 0.01),))
    post = CollisionBody("post", "right", "right/6", (box([0.02, 0.02, 0.02]),))
    model = CollisionModel.build(ARMS, [rod, post])
    query = model.scene({"rod": Attached("right", transform(position=[0, 0, 0.0201]))}, margin=0.0)
    q_to = HOME.copy()
    q_to[6:] += 3.0
    assert query.edge(HOME, q_to).free
