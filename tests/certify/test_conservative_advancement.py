"""Collision over the continuous motion, against dense sampling of the same curves."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from planners.certify import CertifySettings, RobotSurfaces
from planners.certify.collision import CollisionCheck, PairMotion
from planners.certify.document_view import read_document
from planners.certify.lift_pairs import LiftTouchRule
from planners.certify.motion import SegmentMotion, motions_of
from planners.certify.pairs import pairs_of
from planners.certify.solids import Solid, solids_of
from planners.geometry.pose import Transform, to_pose7, transform
from planners.scene.cell import Cell

Document = dict[str, Any]
Distance = Callable[[Solid, Transform, Solid, Transform], float]
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


@pytest.mark.parametrize("seed", range(12))
def test_verdicts_are_those_of_dense_sampling(
    seed: int, honest_document: Document, surfaces: RobotSurfaces, true_distance: Distance
) -> None:
    """An obstacle at random near the hands: proven free is free at 60 moments of every step, and a hit is a hit."""
    rng = np.random.default_rng(seed)
    document = swinging(honest_document, rng, 0.05)
    obstacle_near(document, np.array([0.26, 0.2, 1.45]) + rng.normal(size=3) * 0.12, float(rng.uniform(0.01, 0.05)))
    plan = read_document(document)
    solids = [s for s in solids_of(plan, surfaces) if s.name == "post" or s.arm == "left"]
    (free, _) = CollisionCheck(plan, solids, partial(LiftTouchRule, plan), CertifySettings()).run(motions_of(plan))
    (motion,) = motions_of(plan)
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


def placed(motion: SegmentMotion, a: Solid, b: Solid, k: int, u: float) -> tuple[Solid, Transform, Solid, Transform]:
    return a, motion.pose(a.frame, k, u), b, motion.pose(b.frame, k, u)


@pytest.mark.parametrize("segment", [TRANSIT, GRIP, PUSH, TILT, LIFT])
def test_no_distance_changes_faster_than_its_bound(
    segment: int, honest_document: Document, surfaces: RobotSurfaces, true_distance: Distance
) -> None:
    """|d(t) - d(sample)| stays below what the pair is said to move, for all pairs, in the honest plan's segments."""
    rng = np.random.default_rng(segment)
    plan = read_document(honest_document)
    motion, solids = motions_of(plan)[segment], solids_of(plan, surfaces)
    static = frozenset(name for name, body in plan.bodies.items() if body.static)
    pairs = pairs_of(solids, static)
    for index in rng.choice(len(pairs), size=120, replace=False):
        a, b = (solids[i] for i in pairs[index])
        for touching in (False, True):
            pair = PairMotion(motion, a, b, touching)
            k = int(rng.integers(motion.samples - 1))
            start, end = sorted(rng.uniform(size=2))
            bound = pair.within(k, start, end)
            d = [true_distance(*placed(motion, a, b, k, u)) for u in (start, (start + end) / 2, end)]
            if min(d) > 0:
                assert abs(d[2] - d[0]) <= bound + 1e-6
                assert d[1] >= (d[0] + d[2] - bound) / 2 - 1e-6
            whole = pair.between(k, k + 1)
            assert bound <= whole * 1.5 + 1e-9


def test_pairs_that_are_left_out_are_the_cells(cell: Cell, honest_document: Document, surfaces: RobotSurfaces) -> None:
    """Two rules found apart; ours leaves out no more than the cell's, and every pair more is of two things at rest."""
    plan = read_document(honest_document)
    static = frozenset(name for name, body in plan.bodies.items() if body.static)
    known = {body.name for body in cell.collision_bodies()}
    solids = [s for s in solids_of(plan, surfaces) if s.name in known]
    assert {s.name for s in solids} == known
    everything = {tuple(sorted((a.name, b.name))) for a in solids for b in solids if a.name < b.name}
    ours = everything - {tuple(sorted((solids[i].name, solids[j].name))) for i, j in pairs_of(solids, static)}
    at_rest = {body.name for body in cell.bodies} | {"left_base", "right_base"}
    assert ours <= cell.excluded_pairs
    assert all(set(pair) <= at_rest for pair in cell.excluded_pairs - ours)
