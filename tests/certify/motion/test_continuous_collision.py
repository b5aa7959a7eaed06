"""Collision over the continuous motion, against dense sampling of the same curves."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from planners.cell.cell import Cell
from planners.certify import CertifySettings, RobotSurfaces
from planners.certify.lift.touch import lift_touch_rule
from planners.certify.motion.collision import CollisionCheck, PairMotion, pairs_of
from planners.certify.motion.segment_motion import SegmentMotion, motions_of
from planners.certify.motion.solids import ConvexSolid, solids_of
from planners.certify.plan_view import read_plan
from planners.geometry.pose import Transform, rotation_from_vector, to_pose7, transform
from tests.support.documents import sent
from tests.support.samples import among

Document = dict[str, Any]
Distance = Callable[[ConvexSolid, Transform, ConvexSolid, Transform], float]
TRANSIT, GRIP, PUSH, TILT, LIFT = 0, 2, 3, 4, 5


def swinging(document: Document, rng: np.random.Generator, step: float) -> Document:
    """The transit alone, with both arms swinging through random samples."""
    document = copy.deepcopy(document)
    segment = document["segments"][TRANSIT]
    n, start = 12, np.array(segment["positions"][0])
    segment["movers"] = ["left", "right"]
    segment["time"] = (np.arange(n) * step).tolist()
    walk = start + np.cumsum(rng.normal(size=(n, 12)) * 0.06, axis=0)
    segment["positions"] = walk.tolist()
    segment["velocities"] = (np.gradient(walk, step, axis=0) + rng.normal(size=(n, 12)) * 0.3).tolist()
    segment["accelerations"] = np.zeros((n, 12)).tolist()
    segment["gripper_width"] = {"right": [0.085] * n}
    document["segments"] = [segment]
    return document


def obstacle_near(document: Document, position: np.ndarray, size: float) -> None:
    shape = {"type": "box", "size": [size, size, size]}
    document["bodies"]["post"] |= {"shape": shape, "pose": to_pose7(transform(None, position))}


@pytest.mark.parametrize("seed", among(range(12), range(2)))
def test_verdicts_are_those_of_dense_sampling(
    seed: int, honest_document: Document, surfaces: RobotSurfaces, true_distance: Distance
) -> None:
    """An obstacle at random near the hands: proven free is free at 60 moments of every step, and a hit is a hit."""
    rng = np.random.default_rng(seed)
    document = swinging(honest_document, rng, 0.05)
    obstacle_near(document, np.array([0.26, 0.2, 1.45]) + rng.normal(size=3) * 0.12, float(rng.uniform(0.01, 0.05)))
    plan = read_plan(sent(document))
    solids = [s for s in solids_of(plan, surfaces) if s.name == "post" or s.arm == "left"]
    motions = motions_of(plan, surfaces)
    (free, _) = CollisionCheck(plan, solids, partial(lift_touch_rule, plan), CertifySettings()).run(motions)
    (motion,) = motions
    static = frozenset({"post"})
    smallest = np.inf
    for i, j in pairs_of(solids, static):
        for k in range(motion.samples - 1):
            for u in np.linspace(0.0, 1.0, 61):
                smallest = min(smallest, true_distance(*placed(motion, solids[i], solids[j], k, float(u))))
    if abs(smallest) > 1e-4:
        assert free.passed == (smallest > 0)
    if free.passed and free.margin is not None:
        assert free.margin >= 0.97 * smallest - 1e-4


def placed(
    motion: SegmentMotion, a: ConvexSolid, b: ConvexSolid, k: int, u: float
) -> tuple[ConvexSolid, Transform, ConvexSolid, Transform]:
    return a, motion.pose(a.frame, k, u), b, motion.pose(b.frame, k, u)


def gap_along(
    direction: np.ndarray, pair: PairMotion, relative: bool, motion: SegmentMotion, k: int, u: float
) -> float:
    """How far apart the pair's corners are along a direction of the world, or of the first solid's frame."""
    T_a, T_b = (motion.pose(solid.frame, k, u) for solid in (pair.a, pair.b))
    along = T_a[:3, :3] @ direction if relative else direction
    a, b = (solid.points @ T[:3, :3].T + T[:3, 3] for solid, T in ((pair.a, T_a), (pair.b, T_b)))
    return float((b @ along).min() - (a @ along).max()) - pair.a.radius - pair.b.radius


def random_pairs(document: Document, surfaces: RobotSurfaces, rng: np.random.Generator, segment: int, count: int):
    plan = read_plan(sent(document))
    motion, solids = motions_of(plan, surfaces)[segment], solids_of(plan, surfaces)
    static = frozenset(name for name, body in plan.bodies.items() if body.static)
    pairs = pairs_of(solids, static)
    for index in rng.choice(len(pairs), size=count, replace=False):
        yield motion, *(solids[i] for i in pairs[index])


@pytest.mark.parametrize("segment", among([TRANSIT, GRIP, PUSH, TILT, LIFT], [GRIP, TILT]))
@pytest.mark.parametrize("fast", [False, True])
def test_no_gap_along_a_direction_falls_below_what_is_said_to_be_kept(
    segment: int, fast: bool, honest_document: Document, surfaces: RobotSurfaces, true_distance: Distance
) -> None:
    """Densely sampled, for pairs, steps, parts of them and directions at random; arms swing wildly in the fast ones."""
    rng = np.random.default_rng(segment)
    document = swinging(honest_document, rng, 0.05) if fast else honest_document
    for motion, a, b in random_pairs(document, surfaces, rng, 0 if fast else segment, 60):
        anchors = motion.anchor(a.frame), motion.anchor(b.frame)
        one_arm = anchors[0] is not None and anchors[1] is not None and anchors[0][0] == anchors[1][0]
        for touching in (False, True):
            pair = PairMotion(motion, a, b, touching)
            k = int(rng.integers(motion.samples - 1))
            start, end = sorted(rng.uniform(size=2))
            gap, direction = pair.separation(k, start)
            assert gap == pytest.approx(gap_along(direction, pair, one_arm or touching, motion, k, start), abs=1e-9)
            if rng.uniform() < 0.5:
                direction = rng.normal(size=3)
                direction /= np.linalg.norm(direction)
            along = partial(gap_along, direction, pair, one_arm or touching, motion, k)
            kept = pair.kept_within(direction, k, start, end)
            assert min(along(u) for u in np.linspace(start, end, 9)) >= kept - 1e-9
            assert true_distance(*placed(motion, pair.a, pair.b, k, (start + end) / 2)) >= kept - 2e-6
            gaps = pair.gaps(direction, k, k + 1)
            assert gaps == pytest.approx([along(0.0), along(1.0 - 1e-12)], abs=1e-7)
            (kept,) = pair.kept(gaps, k)
            assert min(along(u) for u in np.linspace(0.0, 1.0 - 1e-12, 15)) >= kept - 1e-9


@pytest.mark.parametrize("segment", among([TRANSIT, GRIP, PUSH, TILT, LIFT], [GRIP, TILT]))
def test_no_distance_changes_faster_than_its_bound(
    segment: int, honest_document: Document, surfaces: RobotSurfaces, true_distance: Distance
) -> None:
    """|d(t) - d(sample)| stays below what the pair is said to move, for all pairs, in the honest plan's segments."""
    rng = np.random.default_rng(segment)
    for motion, a, b in random_pairs(honest_document, surfaces, rng, segment, 120):
        for touching in (False, True):
            pair = PairMotion(motion, a, b, touching)
            k = int(rng.integers(motion.samples - 1))
            start, end = sorted(rng.uniform(size=2))
            bound = pair.within(k, start, end)
            d = [true_distance(*placed(motion, a, b, k, u)) for u in (start, (start + end) / 2, end)]
            if min(d) > 0:
                assert abs(d[2] - d[0]) <= bound + 1e-6
                assert d[1] >= (d[0] + d[2] - bound) / 2 - 1e-6


def repeated(document: Document, times: int) -> Document:
    """The transit, there and back, many times."""
    there = document["segments"][TRANSIT]
    back = copy.deepcopy(there)
    back["time"] = (there["time"][-1] - np.array(there["time"])[::-1]).tolist()
    back["positions"] = there["positions"][::-1]
    back["velocities"] = (-np.array(there["velocities"]))[::-1].tolist()
    return document | {"segments": [there, back] * times}


def test_a_long_plan_is_proven_as_a_short_one_is(honest_document: Document, surfaces: RobotSurfaces) -> None:
    """Every pair has distances by the step: what others took, or came before, takes none away."""
    for times in (1, 40):
        plan = read_plan(sent(repeated(honest_document, times)))
        settings = CertifySettings(distances_per_step=1)
        checks = CollisionCheck(plan, solids_of(plan, surfaces), partial(lift_touch_rule, plan), settings)
        assert all(check.passed for check in checks.run(motions_of(plan, surfaces)))


def test_what_takes_too_many_distances_is_said_not_to_be_proven(
    honest_document: Document, surfaces: RobotSurfaces
) -> None:
    plan = read_plan(sent(repeated(honest_document, 1)))
    settings = CertifySettings(distances_per_step=0)
    checks = CollisionCheck(plan, solids_of(plan, surfaces), partial(lift_touch_rule, plan), settings)
    (free, _) = checks.run(motions_of(plan, surfaces))
    assert not free.passed
    assert "not proven" in free.where


@pytest.mark.parametrize("gap", [1e-3, 1e-5, 1e-6])
def test_two_bodies_that_slide_past_one_another_are_proven_however_near(
    gap: float, honest_document: Document, surfaces: RobotSurfaces
) -> None:
    """A block slides along a wall by half a metre, a gap beside it; on a straight way one direction proves it all."""
    document = copy.deepcopy(honest_document)
    segment = document["segments"][TRANSIT]
    document["segments"] = [segment]
    n = len(segment["time"])
    block = {"type": "box", "size": [0.05, 0.05, 0.05]}
    # Turned, so that boxes along the world's axes meet.
    T = transform(rotation_from_vector(np.array([0.1, 0.2, 0.5])), [0.3, 0.4, 3.0])
    document["bodies"]["post"] |= {"shape": block, "pose": to_pose7(T), "static": False}
    document["bodies"]["wall"] = document["bodies"]["post"] | {
        "shape": {"type": "box", "size": [1.0, 0.05, 0.3]},
        "pose": to_pose7(T @ transform(None, [0.25, 0.05 + gap, 0.0])),
        "static": True,
    }
    ways = np.linspace(0.0, 0.5, n)
    segment["body_poses"] = {"post": [to_pose7(T @ transform(None, [way, 0.0, 0.0])) for way in ways]}
    plan = read_plan(sent(document))
    solids = [solid for solid in solids_of(plan, surfaces) if solid.name in ("post", "wall")]
    settings = CertifySettings(distances_per_step=1)
    (free, _) = CollisionCheck(plan, solids, partial(lift_touch_rule, plan), settings).run(motions_of(plan, surfaces))
    assert free.passed
    assert free.margin == pytest.approx(gap, abs=1e-9)


def test_pairs_that_are_left_out_are_the_cells(cell: Cell, honest_document: Document, surfaces: RobotSurfaces) -> None:
    """Two rules found apart; ours leaves out no more than the cell's, and every pair more is of two things at rest."""
    plan = read_plan(sent(honest_document))
    static = frozenset(name for name, body in plan.bodies.items() if body.static)
    known = {body.name for body in cell.collision_bodies()}
    solids = [s for s in solids_of(plan, surfaces) if s.name in known]
    assert {s.name for s in solids} == known
    everything = {tuple(sorted((a.name, b.name))) for a in solids for b in solids if a.name < b.name}
    ours = everything - {tuple(sorted((solids[i].name, solids[j].name))) for i, j in pairs_of(solids, static)}
    at_rest = {body.name for body in cell.bodies} | {"left_base", "right_base"}
    assert ours <= cell.excluded_pairs
    assert all(set(pair) <= at_rest for pair in cell.excluded_pairs - ours)
