"""The merged graph against its definitions, written out over sets."""

from __future__ import annotations

import itertools
import math

import networkx as nx
import numpy as np
import pytest

from planners.geometry.polyhedron import ConvexPrism
from planners.geometry.pose import transform
from planners.graph.search import ALIVE, DEAD, RESOLUTION, UNKNOWN
from planners.manipulation.contacts.dense_contact_states import ContactSampling, DenseContactStateGraph
from planners.manipulation.graph.manipulation_graph import EdgeKind, HandHold, TransitionCost, build_graph, edge_count

SAMPLING = ContactSampling(
    edge_tilts=(math.radians(6), math.radians(18), 2),
    vertex_tilts=(math.radians(6), math.radians(18), 2),
    vertex_azimuths=1,
    lifted_tilts=(math.radians(10), math.radians(20), 2),
    lifted_azimuths=2,
)
POSES = DenseContactStateGraph.build(
    ConvexPrism.from_outline([[-0.1, -0.1], [0.15, -0.05], [0.0, 0.12]], 0.03),
    [0.0, 0.0, 0.0],
    transform(None, [0.3, 0.0, 1.1]),
    SAMPLING,
)
COSTS = TransitionCost(k=1.3, omega=0.8)
NO_HAND = None


class SetGraph:
    """Nodes as (pose, grip, push), edges as pairs of nodes; by the definitions of paper B, V-A."""

    def __init__(self, grips, pushes, grip_postures, push_postures) -> None:
        def there(hold, table, pose):
            return hold is NO_HAND or bool(int(table[pose, hold.index]) & hold.postures)

        holds = [(g, p) for g in (NO_HAND, *grips) for p in (NO_HAND, *pushes) if g or p]
        self.nodes = {
            (pose, g, p)
            for pose in range(len(POSES.poses))
            for g, p in holds
            if there(g, grip_postures, pose) and there(p, push_postures, pose)
        }
        joined = {(int(i), int(j)) for i, j in POSES.edges}
        self.transfers = {
            frozenset((a, b)) for a, b in itertools.combinations(self.nodes, 2)
            if a[1:] == b[1:] and ((a[0], b[0]) in joined or (b[0], a[0]) in joined)
        }  # fmt: skip
        self.transits = {
            frozenset((a, b)) for a, b in itertools.combinations(self.nodes, 2)
            if a[0] == b[0] and (subset(a, b) or subset(b, a))
        }  # fmt: skip


def subset(a, b) -> bool:
    return a != b and a[1] in (NO_HAND, b[1]) and a[2] in (NO_HAND, b[2])


@pytest.fixture(params=range(6), scope="module")
def case(request):
    rng = np.random.default_rng(request.param)
    shape = (len(POSES.poses), 3)
    tables = [rng.integers(0, 8, shape).astype(np.uint64) * (rng.random(shape) < 0.5) for _ in range(2)]
    # Holds of which some were split into postures.
    grips = (HandHold(0, 7), HandHold(2, 1), HandHold(2, 4))
    pushes = (HandHold(1, 7), HandHold(0, 2), HandHold(0, 1))
    built = build_graph(POSES, grips, pushes, tables[0], tables[1], COSTS)
    return built, SetGraph(grips, pushes, *tables)


def meaning(built, node):
    return (int(built.node_pose[node]), *built.hold_of(int(node)))


def test_a_node_is_a_pose_with_a_hold_whose_hands_both_reach_it(case):
    built, expected = case
    nodes = [meaning(built, n) for n in range(built.graph.node_count)]
    assert len(set(nodes)) == len(nodes)
    assert set(nodes) == expected.nodes


@pytest.mark.parametrize("kind", EdgeKind)
def test_edges_are_those_of_the_definitions(case, kind):
    built, expected = case
    edges = [
        frozenset(meaning(built, n) for n in built.edge_nodes[e])
        for e in range(len(built.edge_nodes))
        if built.kind(e) is kind
    ]
    assert len(set(edges)) == len(edges)
    assert set(edges) == (expected.transits if kind is EdgeKind.TRANSIT else expected.transfers)


def test_what_is_ruled_out_is_left_out_with_its_edges_and_nothing_else(case):
    whole, _ = case
    rng = np.random.default_rng(5)
    tables = [rng.integers(0, 8, (len(POSES.poses), 3)).astype(np.uint64) for _ in range(2)]
    ruled_out = rng.random((len(POSES.poses), 4, 4)) < 0.4
    holds = whole.grips, whole.pushes
    full, left = (build_graph(POSES, *holds, *tables, COSTS, out) for out in (None, ruled_out))

    def out(node):
        pose, grip, push = node
        return ruled_out[pose, 0 if grip is None else grip.index + 1, 0 if push is None else push.index + 1]

    def edges(built):
        return [frozenset(meaning(built, n) for n in nodes) for nodes in built.edge_nodes]

    kept = {meaning(full, n) for n in range(full.graph.node_count) if not out(meaning(full, n))}
    assert [meaning(left, n) for n in range(left.graph.node_count)] == [
        meaning(full, n) for n in range(full.graph.node_count) if meaning(full, n) in kept
    ]
    assert sorted(map(hash, edges(left))) == sorted(hash(edge) for edge in edges(full) if edge <= kept)
    assert edge_count(POSES, holds, tuple(tables), ruled_out) == len(left.edge_nodes)
    assert edge_count(POSES, holds, tuple(tables)) == len(full.edge_nodes)


def test_arcs_cost_by_the_kind_of_their_edge(case):
    built, _ = case
    graph = built.graph
    for tail in range(graph.node_count):
        for arc in range(graph.row_start[tail], graph.row_start[tail + 1]):
            edge, head = graph.edge[arc], int(graph.head[arc])
            assert {tail, head} == set(built.edge_nodes[edge])
            assert graph.loaded[arc] == (built.kind(edge) is EdgeKind.TRANSIT)
            a, b = (POSES.poses[built.node_pose[n]] for n in (tail, head))
            if built.kind(edge) is EdgeKind.TRANSIT:
                expected = 0.0
            elif a.contact == b.contact:
                expected = 1.3
            else:
                expected = 0.8 * math.exp(b.restraint - a.restraint)
            assert graph.cost[arc] * RESOLUTION == pytest.approx(expected, abs=RESOLUTION)


def test_a_transfer_knows_its_motion(case):
    built, _ = case
    for edge, motion in enumerate(built.edge_motion):
        if built.kind(edge) is EdgeKind.TRANSIT:
            assert motion == -1
        else:
            ends = {int(built.node_pose[n]) for n in built.edge_nodes[edge]}
            assert ends == {int(i) for i in POSES.edges[motion]}


def test_edges_are_found_by_motion_and_by_the_hand_that_comes_or_goes_at_a_pose(case):
    """Oracle: a look at every edge."""
    built, _ = case
    transit = built.edge_motion < 0
    for motion in range(len(POSES.edges)):
        assert built.transfers(motion).tolist() == np.flatnonzero(built.edge_motion == motion).tolist()
    for pose, (hand, mine) in itertools.product(
        range(len(POSES.poses)), [("grip", built.node_grip), ("push", built.node_push)]
    ):
        there = built.node_pose[built.edge_nodes] == pose
        changes = mine[built.edge_nodes[:, 0]] != mine[built.edge_nodes[:, 1]]
        found = built.transits(pose, hand)
        assert found.tolist() == np.flatnonzero(transit & there.all(axis=1) & changes).tolist()
        both = (built.node_grip > 0) & (built.node_push > 0)
        assert both[built.edge_nodes[found, 1]].all()


def test_plans_start_flat_with_one_hand_and_end_in_the_air_with_both(case):
    built, expected = case
    flat = {node for node in expected.nodes if node[0] == POSES.flat and (node[1] is None or node[2] is None)}
    assert {meaning(built, n) for n in built.starts} == flat
    corners = POSES.plate.shape.polyhedron.vertices
    lowest = [float(np.min(corners @ pose.T_world_plate[2, :3]) + pose.T_world_plate[2, 3]) for pose in POSES.poses]
    high = lowest[POSES.flat] + SAMPLING.goal_height - 1e-9
    lifted = {node for node in expected.nodes if lowest[node[0]] >= high and None not in node}
    assert {node[0] for node in lifted} < set(POSES.lifted), "poses off the environment, of which some are too low"
    assert {meaning(built, n) for n in np.flatnonzero(built.goal)} == lifted


def test_reachable_are_the_nodes_connected_to_a_start_that_is_left(case):
    """Oracle: networkx."""
    built, _ = case
    rng = np.random.default_rng(12)
    status, dead = built.knowledge.status, built.knowledge.edge_dead
    status[:], dead[:] = rng.choice([UNKNOWN, ALIVE, DEAD], len(status)), rng.random(len(dead)) < 0.5
    built.lost_starts.update(built.starts[::2])
    left = nx.Graph()
    left.add_nodes_from(np.flatnonzero(status != DEAD).tolist())
    left.add_edges_from(e for e in built.edge_nodes[~dead].tolist() if set(e) <= set(left.nodes))
    starts = [n for n in built.starts[1::2] if n in left]
    expected = set().union(*(nx.node_connected_component(left, n) for n in starts))
    assert set(built.reachable().tolist()) == expected
    status[:], dead[:] = UNKNOWN, False
    built.lost_starts.clear()


@pytest.mark.parametrize("goals", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_a_graph_learns_what_is_known_of_nodes_with_the_same_holds_and_of_no_others(seed, goals):
    rng = np.random.default_rng(seed)
    tables = [rng.integers(0, 8, (len(POSES.poses), 3)).astype(np.uint64) for _ in range(2)]
    grips, pushes = (HandHold(0, 7), HandHold(2, 7), HandHold(1, 7)), (HandHold(1, 7), HandHold(0, 7))
    before = build_graph(POSES, grips, pushes, *tables, COSTS)
    before.knowledge.status[:] = rng.choice([UNKNOWN, ALIVE, DEAD], len(before.node_pose))
    before.knowledge.load[:] = rng.integers(0, 1000, len(before.node_pose))
    before.goal[:] &= rng.random(len(before.node_pose)) < 0.5
    split = (HandHold(0, 7), HandHold(1, 7), HandHold(2, 1), HandHold(2, 6))
    after = build_graph(POSES, split, pushes, *tables, COSTS)
    whole_goal = after.goal.copy()
    after.learn_from(before, goals=goals)
    known = {
        (int(before.node_pose[n]), *before.hold_of(n)): (
            *(int(m[n]) for m in before.knowledge[:2]),
            bool(before.goal[n]),
        )
        for n in range(len(before.node_pose))
    }
    for node in range(len(after.node_pose)):
        status, load, goal = known.get(
            (int(after.node_pose[node]), *after.hold_of(node)), (UNKNOWN, 0, bool(whole_goal[node]))
        )
        if not goals:
            goal = bool(whole_goal[node])
            status = UNKNOWN if goal and status == ALIVE else status
        assert (after.knowledge.status[node], after.knowledge.load[node], after.goal[node]) == (status, load, goal)
    assert len(after.node_pose) > len(known) // 2
