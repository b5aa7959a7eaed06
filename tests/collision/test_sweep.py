"""Edges and paths: what is called free is free at every configuration in between."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_cell import HOME, build_model, held, resting

from planners.collision.model import CollisionModel
from planners.collision.placement import Attached, Fixed, Riding, Upright
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import transform
from planners.geometry.shapes import box, capsule, sphere
from synthetic_cell import ARMS

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


def test_a_thin_wall_between_two_samples_is_seen():
    """A wall of a tenth of a millimetre stands in the way of a fist on the flange."""
    fist = CollisionBody("fist", "right", "right/6", (sphere([0, 0, 0.1], 0.005),))
    wall = CollisionBody("wall", "obstacle", "wall", (box([1e-4, 4.0, 4.0]),))
    model = CollisionModel.build(ARMS, [fist, wall])
    q_from, q_to = HOME.copy(), HOME.copy()
    q_to[6] += 2.5
    free_query = model.scene({"wall": None})
    assert free_query.edge(q_from, q_to).free
    xs = [fist_position(q)[0] for q in (q_from, q_to)]
    query = model.scene({"wall": Fixed(transform(position=[0.5 * sum(xs), 0, 1.5]))})
    assert abs(xs[0] - xs[1]) > 0.1
    assert np.all(query.first_collision(np.array([q_from, q_to])) == -1)
    result = query.edge(q_from, q_to)
    assert not result.free
    assert query.pair_names(result.pair) == ("fist", "wall")
    assert 0.0 < result.fraction < 1.0


def fist_position(q):
    from coal_scene import world_frames

    return world_frames(q, {})["right/6"][:3] @ [0, 0, 0.1, 1]


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
        free = all(query.edge(a, b).free for a, b in zip(Q[:-1], Q[1:], strict=True))
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
