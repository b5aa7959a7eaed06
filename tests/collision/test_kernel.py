"""Verdicts of the compiled kernel against coal, and laws of placements, pairs and margins."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from planners.collision.kernel import first_collision, make_scratch, place_frames, set_frame
from planners.collision.model import Attached, CollisionModel, CollisionModelError, Fixed, Riding, Upright
from planners.geometry.convex import CollisionBody, box
from planners.geometry.pose import rotation_from_vector, transform
from tests.collision.coal_scene import CoalScene, world_frames
from tests.collision.synthetic_cell import (
    ARMS,
    BOXES,
    HOME,
    build_model,
    convex_hull,
    excluded_pairs,
    held,
    resting,
    sphere,
)
from tests.support.samples import sample

TOLERANCE = 1e-6
"""Coal and the kernel may differ about distances this close to the margin [m]."""


@pytest.fixture(scope="module")
def model():
    return build_model()


def configurations(rng, n, spread):
    return HOME + rng.uniform(-spread, spread, size=(n, 12))


def disagreements(model, placements, Q, margin):
    """Return (missed, invented, reported wrongly) over the configurations."""
    query = model.scene(placements, margin=margin)
    oracle = CoalScene(model, placements)
    pairs = query.kernel.pairs[:, :2]
    missed = invented = 0
    for q, found in zip(Q, query.first_collision(Q), strict=True):
        # The first pair is reported, so those before it are claimed to be free.
        claimed = len(pairs) if found < 0 else found
        distances = oracle.distances(q, pairs[: claimed + 1], margin)
        missed += int(np.any(distances[:claimed] <= margin - TOLERANCE))
        invented += int(found >= 0 and distances[found] > margin + TOLERANCE)
    return missed, invented


@pytest.mark.parametrize(
    ("placements", "margin", "spread", "seed"),
    [(resting, 0.0, 0.4, 0), (resting, 0.003, 0.8, 1), (held, 0.003, 0.6, 2), (held, 0.0, 3.0, 3)],
)
def test_the_kernel_misses_no_collision_and_invents_none(model, placements, margin, spread, seed):
    Q = configurations(np.random.default_rng(seed), sample(600, 3000), spread)
    assert disagreements(model, placements(), Q, margin) == (0, 0)


def test_the_scene_has_both_verdicts_in_plenty(model):
    """Guards the test above: agreement on nothing but free (or nothing but colliding) would mean little."""
    Q = configurations(np.random.default_rng(0), 3000, 0.4)
    free = model.scene(resting()).first_collision(Q) < 0
    assert 0.2 < free.mean() < 0.95


def test_frames_stand_where_matrix_products_put_them(model):
    rng = np.random.default_rng(4)
    placements = {
        "plate": Attached("left", transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))),
        "cup": Riding("plate", transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))),
        "cable": Upright("cup", rng.normal(size=3)),
    }
    query = model.scene(placements)
    for q in configurations(rng, 20, 3.0):
        scratch = make_scratch(query.kernel)
        place_frames(query.kernel, q, scratch.frames)
        for name, T in world_frames(q, placements).items():
            assert scratch.frames[query.frame_index(name)] == pytest.approx(T, abs=1e-12)


def test_a_model_whose_bodies_have_moved_is_one_that_is_built_of_them(model):
    rng = np.random.default_rng(11)
    moved = [
        replace(body, shapes=tuple(shape.placed(transform(position=rng.normal(0.0, 0.05, 3))) for shape in body.shapes))
        for body in model.bodies
    ]
    built = CollisionModel.build(ARMS, moved, excluded_pairs(moved))
    Q = configurations(rng, 300, 0.4)
    verdicts = [each.scene(resting()).first_collision(Q) for each in (built, model.with_bodies(moved), model)]
    assert np.array_equal(verdicts[0], verdicts[1])
    assert not np.array_equal(verdicts[0], verdicts[2])


def test_other_bodies_need_a_model_of_their_own(model):
    with pytest.raises(CollisionModelError, match="more than the places"):
        model.with_bodies([*model.bodies[1:], model.bodies[0]])


def test_riding_on_an_attached_plate_is_attached_with_the_product(model):
    rng = np.random.default_rng(5)
    T_flange_plate, T_plate_cup = transform(position=[0, 0, 0.36]), transform(position=[0.05, 0.02, 0.035])
    Q = configurations(rng, 1000, 0.8)
    base = {"plate": Attached("right", T_flange_plate), "cable": None}
    riding = model.scene({**base, "cup": Riding("plate", T_plate_cup)})
    attached = model.scene({**base, "cup": Attached("right", T_flange_plate @ T_plate_cup)})
    assert np.array_equal(riding.first_collision(Q), attached.first_collision(Q))


@njit(nogil=True)
def _collisions_at_poses(kernel, frame, poses, q):
    scratch = make_scratch(kernel)
    found = np.empty(len(poses), np.int32)
    for i in range(len(poses)):
        set_frame(kernel, frame, poses[i])
        found[i] = first_collision(kernel, q, scratch)
    return found


@pytest.mark.slow
def test_overwriting_a_frame_in_compiled_code_is_a_new_scene(model):
    rng = np.random.default_rng(6)
    poses = np.array(
        [
            transform(rotation_from_vector(0.3 * rng.normal(size=3)), rng.uniform([0.1, -0.5, 1.1], [0.7, 0.5, 1.5]))
            for _ in range(60)
        ]
    )
    query = model.scene(resting())
    found = _collisions_at_poses(query.kernel_copy(), query.frame_index("plate"), poses, HOME)
    fresh = [model.scene({**resting(), "plate": Fixed(T)}).first_collision(HOME)[0] for T in poses]
    assert found.tolist() == fresh
    assert len(set(fresh)) > 1
    assert query.first_collision(HOME)[0] == model.scene(resting()).first_collision(HOME)[0]


def test_overwriting_a_frame_that_is_not_movable_is_refused(model):
    query = model.scene(resting())
    with pytest.raises(ValueError, match="not a frame placed"):
        set_frame(query.kernel_copy(), query.frame_index("left/3"), np.eye(4))


def test_verdicts_depend_on_neither_order_nor_neighbours_nor_threads(model):
    Q = configurations(np.random.default_rng(7), 2000, 0.6)
    query = model.scene(held(), margin=0.003)
    together = query.first_collision(Q)
    assert np.array_equal(query.first_collision(Q[::-1])[::-1], together)
    assert np.array_equal(np.concatenate([query.first_collision(q) for q in Q]), together)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(query.first_collision, [Q] * 8):
            assert np.array_equal(found, together)


def test_a_body_of_many_shapes_is_the_union_of_them():
    rng = np.random.default_rng(8)
    parts = [convex_hull(0.05 * rng.normal(size=(12, 3)) + 0.1 * rng.normal(size=3)) for _ in range(5)]
    probe = CollisionBody("probe", "probe", "probe", (sphere([0, 0, 0], 0.02),))
    whole = CollisionModel.build(ARMS, [probe, CollisionBody("whole", "cell", "world", tuple(parts))])
    split = CollisionModel.build(
        ARMS, [probe, *(CollisionBody(f"part_{k}", "cell", "world", (part,)) for k, part in enumerate(parts))]
    )
    for _ in range(300):
        placement = {"probe": Fixed(transform(position=rng.uniform(-0.3, 0.3, 3)))}
        one, many = (m.scene(placement).first_collision(HOME)[0] for m in (whole, split))
        assert (one >= 0) == (many >= 0)
        if one >= 0:
            assert whole.scene(placement).pair_names(one) == ("probe", "whole")


def test_the_margin_is_the_distance_kept():
    model = two_boxes()
    for gap in (-0.001, 0.0, 0.002, 0.0029, 0.0031, 0.02):
        placement = {"moved": Fixed(transform(position=[1.0 + gap, 0.2, 0.1]))}
        for margin in (0.0, 0.003):
            free = model.scene(placement, margin=margin).first_collision(HOME)[0] < 0
            assert free == (gap > margin)


def test_a_negative_margin_allows_that_much_overlap():
    model = two_boxes()
    for depth, free in ((-0.001, True), (0.0, True), (0.0009, True), (0.0011, False), (0.1, False)):
        placement = {"moved": Fixed(transform(position=[0.3, 0.2, 1.0 - depth]))}
        query = model.scene(placement, margin=0.003, margins={("still", "moved"): -0.001})
        assert (query.first_collision(HOME)[0] < 0) == free


def two_boxes():
    return CollisionModel.build(
        ARMS,
        [
            CollisionBody("still", "cell", "world", (box([1, 1, 1]),)),
            CollisionBody("moved", "moved", "moved", (box([1, 1, 1]),)),
        ],
    )


def test_touching_is_colliding():
    query = two_boxes().scene({"moved": Fixed(transform(position=[1.0, 0.0, 0.0]))})
    assert query.pair_names(query.first_collision(HOME)[0]) == ("still", "moved")


def test_allowed_and_excluded_and_unchosen_pairs_are_never_reported(model):
    Q = configurations(np.random.default_rng(9), 2000, 1.0)
    allowed = [("right_pad_0", "plate"), ("plate", "right_pad_1"), ("table", "left_stick")]
    query = model.scene(resting(), allowed=allowed, only=lambda a, b: "left" in (a.group, b.group))
    groups = {body.name: body.group for body in model.bodies}
    reported = {query.pair_names(k) for k in query.first_collision(Q) if k >= 0}
    assert reported
    for a, b in reported:
        assert "left" in (groups[a], groups[b])
        assert (a, b) not in allowed
        assert (b, a) not in allowed


def test_a_choice_may_be_made_once_and_used_often(model):
    Q = configurations(np.random.default_rng(10), 500, 0.8)

    def only(a, b):
        return a.group != b.group

    by_mask = model.scene(resting(), only=model.pair_mask(only))
    assert np.array_equal(by_mask.first_collision(Q), model.scene(resting(), only=only).first_collision(Q))


@pytest.mark.parametrize("absent", ["plate", "cup", "cable"])
def test_frames_keep_their_places_whichever_are_absent(model, absent):
    """Frames are numbered with those that are absent; work space that only counted the others was too short."""
    placements = {name: None if name == absent else Fixed(np.eye(4)) for name in ("plate", "cup", "cable")}
    query = model.scene(placements, margin=0.003)
    scratch = make_scratch(query.kernel)
    assert len(scratch.frames) == len(model.frames)
    Q = configurations(np.random.default_rng(6), 500, 0.8)
    bodies = [body for body in model.bodies if body.frame != absent]
    names = {body.name for body in bodies}
    excluded = {pair for pair in excluded_pairs(bodies) if names >= set(pair)}
    without = CollisionModel.build(ARMS, bodies, excluded).scene(
        {name: Fixed(np.eye(4)) for name in placements if name != absent}, margin=0.003
    )
    touching = [query.first_collision(Q) >= 0, without.first_collision(Q) >= 0]
    assert 0 < touching[0].sum() < len(Q)
    np.testing.assert_array_equal(*touching)


def test_absent_frames_collide_with_nothing(model):
    Q = configurations(np.random.default_rng(11), 2000, 1.0)
    query = model.scene({"plate": None, "cup": None, "cable": None})
    reported = {name for k in query.first_collision(Q) if k >= 0 for name in query.pair_names(k)}
    assert reported
    assert not reported & {"plate", "cup", "cable"}


@pytest.mark.parametrize(
    ("placements", "words"),
    [
        ({"plate": None}, "movable frames are plate, cup, cable"),
        ({**resting(), "saucer": None}, "saucer"),
        ({**resting(), "plate": Riding("cup", np.eye(4))}, "circle"),
        ({**resting(), "plate": Riding("plate", np.eye(4))}, "circle"),
        ({**resting(), "plate": None}, "follows 'plate', which is absent"),
        ({**resting(), "plate": Riding("saucer", np.eye(4))}, "no frame 'saucer'"),
        ({**resting(), "plate": Attached("third", np.eye(4))}, "no frame 'third/6'"),
    ],
)
def test_placements_that_cannot_be_are_refused(model, placements, words):
    with pytest.raises(CollisionModelError, match=words):
        model.scene(placements)


def test_unknown_names_are_refused(model):
    with pytest.raises(CollisionModelError, match="no body 'saucer'"):
        model.scene(resting(), allowed=[("saucer", "plate")])
    with pytest.raises(CollisionModelError, match="no body 'saucer'"):
        CollisionModel.build(ARMS, model.bodies, [("saucer", "plate")])
    with pytest.raises(CollisionModelError, match="two bodies are named 'table'"):
        CollisionModel.build(ARMS, [*model.bodies, *(b for b in model.bodies if b.name == "table")])


def test_bodies_of_one_frame_and_of_the_world_are_never_paired(model):
    frames = {body.name: body.frame for body in model.bodies}
    assert all(frames[a] != frames[b] for a, b in model.pair_names)
    assert not any(a in BOXES and b in BOXES for a, b in model.pair_names)
