"""Sequences of the regrasp graph against networkx on the same graph, written out node by node."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from planners.regrasp.graph.regrasp_graph import (
    Handover,
    LayeredRegraspGraph,
    Pick,
    RegraspGraphError,
    RoundLayers,
    Sequence,
    Transfer,
)

GRASPS = 4
GOALS = 2
MOST = 2
HANDOVER_WEIGHT = 1e6


def random_layers(rng: np.random.Generator, ends: int) -> RoundLayers:
    def costs(*shape: int) -> np.ndarray:
        return np.where(rng.random(shape) < 0.4, rng.random(shape), np.inf)

    handovers = (rng.random((GRASPS, GRASPS)) < 0.25, rng.random((GRASPS, GRASPS)) < 0.25)
    return RoundLayers(costs(ends, 2 * GRASPS), costs(2 * GRASPS), costs(ends, 2 * GRASPS), handovers)


def random_graph(seed: int) -> tuple[LayeredRegraspGraph, nx.DiGraph]:
    rng = np.random.default_rng(seed)
    start = rng.random(2 * GRASPS) < 0.4
    rounds = (random_layers(rng, 1), random_layers(rng, GOALS))
    return LayeredRegraspGraph(start, rounds, MOST), written_out(start, rounds)


def written_out(start: np.ndarray, rounds: tuple[RoundLayers, RoundLayers]) -> nx.DiGraph:
    """Make every grasp after every number of handovers a node of its own."""
    graph = nx.DiGraph()
    graph.add_nodes_from(["begin", "end"])
    graph.add_edges_from(("begin", (0, 0, int(node)), {"weight": 0.0}) for node in np.flatnonzero(start))
    for part, layers in enumerate(rounds):
        for handovers in range(MOST + 1):
            costs = (layers.arriving if handovers else layers.direct).min(axis=0)
            for node in np.flatnonzero(np.isfinite(costs)):
                target = "end" if part else (1, 0, int(node))
                graph.add_edge((part, handovers, int(node)), target, weight=float(costs[node]))
        for giver, receiver in changes_of_hand(layers):
            for number in range(MOST):
                cost = HANDOVER_WEIGHT + (layers.departing[giver] if number == 0 else 0.0)
                if np.isfinite(cost):
                    graph.add_edge((part, number, giver), (part, number + 1, receiver), weight=cost)
    return graph


def changes_of_hand(layers: RoundLayers) -> list[tuple[int, int]]:
    left_to_right, right_to_left = (np.argwhere(matrix) for matrix in layers.handovers)
    there = [(int(g), GRASPS + int(r)) for g, r in left_to_right]
    return there + [(GRASPS + int(g), int(r)) for g, r in right_to_left]


def oracle(graph: nx.DiGraph) -> float | None:
    try:
        return float(nx.dijkstra_path_length(graph, "begin", "end"))
    except nx.NetworkXNoPath:
        return None


def weight(sequence: Sequence | None) -> float | None:
    return None if sequence is None else sequence.cost + HANDOVER_WEIGHT * sequence.handovers


@pytest.mark.parametrize("seed", range(40))
def test_the_best_sequence_has_the_fewest_handovers_and_then_the_least_cost(seed: int) -> None:
    graph, explicit = random_graph(seed)
    expected = oracle(explicit)
    found = weight(graph.best())
    assert (found is None) == (expected is None)
    assert found == pytest.approx(expected)


@pytest.mark.parametrize("seed", range(12))
def test_asked_for_a_number_of_handovers_it_gives_the_cheapest_path_with_just_that_many(seed: int) -> None:
    graph, explicit = random_graph(seed)
    best: dict[int, float] = {}
    for path in nx.all_simple_paths(explicit, "begin", "end"):
        total = nx.path_weight(explicit, path, "weight")
        count = int(total // HANDOVER_WEIGHT)
        best[count] = min(best.get(count, np.inf), total)
    for count in range(2 * MOST + 1):
        assert weight(graph.best(count)) == pytest.approx(best.get(count))


@pytest.mark.parametrize("seed", range(20))
def test_deleting_the_first_edge_of_every_sequence_found_empties_the_graph_in_order(seed: int) -> None:
    """Sequences come in order of handovers and cost, none uses a deleted edge, and at the end none is left."""
    rng = np.random.default_rng(1000 + seed)
    graph, _ = random_graph(seed)
    deleted: set[object] = set()
    weights: list[float] = []
    while (sequence := graph.best()) is not None:
        assert not deleted & set(sequence.edges)
        weights.append(sequence.cost + HANDOVER_WEIGHT * sequence.handovers)
        edge = sequence.edges[int(rng.integers(len(sequence.edges)))]
        deleted.add(edge)
        graph.delete(edge)
    assert weights == pytest.approx(sorted(weights))


@pytest.mark.parametrize("seed", range(20))
def test_a_sequence_is_a_chain_of_grasps_that_changes_arms_at_handovers_only(seed: int) -> None:
    graph, _ = random_graph(seed)
    sequence = graph.best()
    if sequence is None:
        return
    begin, *others = sequence.edges
    assert isinstance(begin, Pick)
    node = begin.node
    for edge in others:
        if isinstance(edge, Handover):
            assert edge.giver == node
            assert edge.giver // GRASPS != edge.receiver // GRASPS
            node = edge.receiver
        else:
            assert edge == Transfer(edge.round, node, edge.after_handover, edge.end)
    assert [edge.round for edge in sequence.edges if isinstance(edge, Transfer)] == [0, 1]
    assert sequence.last == node


def test_layers_of_different_sizes_are_refused() -> None:
    rng = np.random.default_rng(0)
    layers = (random_layers(rng, 1), random_layers(rng, 1))
    with pytest.raises(RegraspGraphError):
        LayeredRegraspGraph(np.ones(2 * GRASPS + 2, dtype=bool), layers, MOST)
