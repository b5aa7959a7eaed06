"""Failures against their definitions, before and after holds are told apart by posture."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from planners.manipulation.graph.failures import (
    BlockedMotion,
    EdgeFailure,
    Failures,
    LoneTransitFailure,
    MotionFailure,
    PairFailure,
    TransitFailure,
)
from planners.manipulation.graph.manipulation_graph import HandHold, TransitionCost, build_graph
from tests.manipulation.test_graph import POSES, meaning

GRIPS, PUSHES = (HandHold(0, 7), HandHold(1, 7)), (HandHold(0, 7), HandHold(1, 7))
SPLIT = tuple(HandHold(hold.index, 1 << bit) for hold in GRIPS for bit in range(3))


class NoBalance:
    """Balance that never ruled anything out."""

    def impossible_holds(self, motion: int) -> np.ndarray:
        return np.zeros((3, 3), bool)


class LamePair(NoBalance):
    """Grip 1 with push 0 does not bear the plate on any motion."""

    def impossible_holds(self, motion: int) -> np.ndarray:
        impossible = super().impossible_holds(motion)
        impossible[2, 1] = True
        return impossible


def built(grips=GRIPS, pushes=PUSHES):
    everywhere = np.full((len(POSES.poses), 2), 7, np.uint64)
    return build_graph(POSES, grips, pushes, everywhere, everywhere, TransitionCost())


def within(hold, other) -> bool:
    return hold is not None and hold.index == other.index and hold.postures & ~other.postures == 0


def dies(failure, graph, edge) -> bool:
    """What a failure says of an edge, in words of nodes."""
    a, b = (meaning(graph, n) for n in graph.edge_nodes[edge])
    motion = int(graph.edge_motion[edge])
    match failure:
        case BlockedMotion(motion=m):
            return motion == m
        case MotionFailure(motion=m, hand=hand, index=index, survivors=survivors, alone=alone):
            mine, other = (a[1], a[2]) if hand == "grip" else (a[2], a[1])
            lame = mine is not None and mine.index == index and not mine.postures & survivors
            return motion == m and lame and (other is None or not alone)
        case TransitFailure(pose=pose, hand=hand, index=index, survivors=survivors):
            changing = {node[1] if hand == "grip" else node[2] for node in (a, b)}
            hold = next((h for h in changing if h is not None), None)
            comes = motion < 0 and len(changing) == 2
            return comes and a[0] == pose and hold is not None and hold.index == index and not hold.postures & survivors
        case PairFailure(grip=grip, push=push, motion=m, pose=pose, changing=changing):
            both = next((n for n in (a, b) if n[1] is not None and n[2] is not None), None)
            if both is None or not (within(both[1], grip) and within(both[2], push)):
                return False
            if m is not None:
                return motion == m
            place = 1 if changing == "grip" else 2
            return motion < 0 and a[0] == pose and a[place] != b[place]
        case _:
            raise AssertionError(failure)


FAILURES = [
    BlockedMotion(3),
    MotionFailure(2, "grip", 0, 0, alone=False),
    MotionFailure(2, "grip", 0, 2, alone=False),
    MotionFailure(5, "push", 1, 0, alone=True),
    TransitFailure(0, "push", 0, 0),
    TransitFailure(4, "grip", 1, 5),
    PairFailure(GRIPS[0], PUSHES[1], motion=4),
    PairFailure(GRIPS[1], PUSHES[0], pose=2, changing="grip"),
    PairFailure(GRIPS[1], PUSHES[0], pose=2, changing="push"),
]


@pytest.mark.parametrize("failure", FAILURES, ids=lambda f: type(f).__name__)
@pytest.mark.parametrize("grips", [GRIPS, SPLIT], ids=["whole", "split"])
def test_a_failure_kills_the_edges_it_speaks_of_and_no_others(failure, grips):
    failures, whole = Failures(NoBalance()), built()
    killed = failures.add(failure, whole)
    assert killed == whole.knowledge.edge_dead.sum() + len(whole.lost_starts)
    graph = built(grips)
    failures.apply(graph)
    expected = [dies(failure, graph, edge) for edge in range(graph.graph.edge_count)]
    assert graph.knowledge.edge_dead.tolist() == expected


def test_told_twice_a_failure_kills_nothing_more():
    failures, graph = Failures(NoBalance()), built()
    assert failures.add(FAILURES[0], graph) > 0
    assert failures.add(FAILURES[0], graph) == 0


@pytest.mark.parametrize("number", [0, 7, 100, 200, -1])
def test_an_edge_given_up_stays_given_up_in_all_parts_of_its_holds(number):
    failures, whole = Failures(NoBalance()), built()
    edge = range(whole.graph.edge_count)[number]
    ends = [meaning(whole, n) for n in whole.edge_nodes[edge]]
    assert failures.add(EdgeFailure.of(whole, edge), whole) == 1
    assert np.flatnonzero(whole.knowledge.edge_dead).tolist() == [edge]
    graph = built(SPLIT)
    failures.apply(graph)

    def part_of(node, of) -> bool:
        return node[0] == of[0] and all(
            (mine is None) == (other is None) and (mine is None or within(mine, other))
            for mine, other in zip(node[1:], of[1:], strict=True)
        )

    for part in range(graph.graph.edge_count):
        a, b = (meaning(graph, n) for n in graph.edge_nodes[part])
        same = any(part_of(a, x) and part_of(b, y) for x, y in itertools.permutations(ends))
        assert graph.knowledge.edge_dead[part] == same


@pytest.mark.parametrize("grips", [GRIPS, SPLIT], ids=["whole", "split"])
@pytest.mark.parametrize(
    ("failure", "lost"),
    [
        (TransitFailure(0, "grip", 0, 0), lambda grip, push: grip is not None and grip.index == 0),
        (TransitFailure(0, "push", 1, 0), lambda grip, push: push is not None and push.index == 1),
        (TransitFailure(3, "grip", 0, 0), lambda grip, push: False),
        (LoneTransitFailure(GRIPS[1], "grip"), lambda grip, push: grip is not None and grip.index == 1),
    ],
)
def test_a_hand_that_cannot_come_to_the_plate_at_rest_starts_no_plan(failure, lost, grips):
    failures = Failures(NoBalance())
    failures.add(failure, built())
    graph = built(grips)
    failures.apply(graph)
    assert graph.lost_starts == {n for n in graph.starts if lost(*graph.hold_of(n))}


def test_what_does_not_bear_the_plate_on_a_motion_stays_dead_after_a_split():
    failures, whole = Failures(LamePair()), built()
    assert failures.add_unbalanced(6, whole) == 1
    graph = built(SPLIT)
    failures.apply(graph)
    for edge in range(graph.graph.edge_count):
        _, grip, push = meaning(graph, graph.edge_nodes[edge, 0])
        lame = grip is not None and push is not None and (grip.index, push.index) == (1, 0)
        assert graph.knowledge.edge_dead[edge] == (graph.edge_motion[edge] == 6 and lame)
