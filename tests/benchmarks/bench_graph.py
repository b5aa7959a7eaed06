"""Tables III and IV of paper B: the whole graph, examined node by node, and searched for all starts and goals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter

import numpy as np

from planners.graph.search import ALIVE, UNKNOWN, GraphPath, cheapest_path
from planners.manipulation.dense_contacts import DenseContactStateGraph
from planners.manipulation.examiner import NodeExaminer, hands_of
from planners.manipulation.graph import build_graph
from planners.manipulation.hold_balance import HandPair
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.reach import PairReach
from tests.benchmarks.tasks import SOLVABLE, Note, planner_of, timed


@dataclass(frozen=True)
class GraphFigures:
    """Table III for one task; seconds."""

    name: str
    grips: int
    pushes: int
    dcsg_nodes: int
    dcsg_edges: int
    dcsg_seconds: float
    reach_seconds: float
    """RV1: which hand reaches which pose free of collision, and which pairs of hands keep the arms apart."""
    holds: int
    """All holds: grips, pushes and pairs."""
    balance_seconds: tuple[float, ...]
    """RV2, of each hold of which a node had to be examined."""
    merge_seconds: float
    candidates: int
    """Nodes that each hand reaches by itself."""
    examined: int
    """Of these, the nodes that no proof had ruled out before their turn."""
    nodes: int
    """Nodes that can be held."""
    edges: int
    """Edges between them."""


@dataclass(frozen=True)
class PathFigures:
    """A path through the graph."""

    length: int
    """Nodes."""
    contact_changes: int
    largest_force: float
    """Largest contact normal of a hand [N]."""


@dataclass(frozen=True)
class SearchFigures:
    """Table IV for one task and objective; seconds."""

    name: str
    minimise: str
    starts: int
    goals: int
    search_seconds: float
    """The cheapest path of every start, all nodes being known."""
    first: PathFigures | None
    """The path the paper would return: its edges are not checked between their ends."""
    checked: PathFigures | None
    """The path whose motion is planned and checked."""
    sequences: int
    """Paths tried until then."""
    checked_seconds: float
    """Searches, checks and motion together."""


class TimedPairReach:
    """Both hands' reach; adds up the seconds spent on keeping the arms apart."""

    def __init__(self, pair: PairReach) -> None:
        self.first, self.second, self._pair = pair.first, pair.second, pair
        self.seconds = 0.0

    def compatible(
        self, T_world_plates: np.ndarray, holds: tuple[int, int], postures: tuple[int, int]
    ) -> tuple[int, int] | None:
        found, seconds = timed(lambda: self._pair.compatible(T_world_plates, holds, postures))
        self.seconds += seconds
        return found


def measure(note: Note, names: Sequence[str] = SOLVABLE) -> tuple[list[GraphFigures], list[SearchFigures]]:
    """Build and search the whole graph of each task, for either objective."""
    graphs, searches = [], []
    for name in names:
        for minimise in ("cost", "force"):
            note(f"whole graph of {name}, least {minimise}")
            planner = planner_of(name, minimise=minimise)
            planner.build()
            pair_seconds, by_hold = _examine(planner)
            if minimise == "cost":
                graphs.append(_graph_figures(name, planner, pair_seconds, by_hold))
            searches.append(_search_figures(name, planner))
    return graphs, searches


def _examine(planner: PlateLiftPlanner) -> tuple[float, Counter[HandPair]]:
    """Examine all nodes; return the seconds spent on pairs of arms, and on the balance of each hold."""
    graph, pair = planner.graph, TimedPairReach(planner.pair)
    planner.examiner = NodeExaminer(
        graph, planner.balance, pair, planner.grip_postures, planner.push_postures, planner.rejections,
        planner.settings.minimise,
    )  # fmt: skip
    by_hold: Counter[HandPair] = Counter()
    for node in range(graph.graph.node_count):
        if graph.knowledge.status[node] == UNKNOWN:
            before, begun = pair.seconds, perf_counter()
            planner.examiner(node)
            by_hold[hands_of(*graph.hold_of(node))] += perf_counter() - begun - (pair.seconds - before)
    return pair.seconds, by_hold


def _graph_figures(
    name: str, planner: PlateLiftPlanner, pair_seconds: float, by_hold: Counter[HandPair]
) -> GraphFigures:
    graph, scene, settings = planner.graph, planner.scene, planner.settings
    plates = np.array([pose.T_world_plate for pose in planner.poses.poses])
    _, dcsg_seconds = timed(
        lambda: DenseContactStateGraph.build(planner.prism, scene.plate.com, scene.T_world_plate, settings.sampling)
    )
    reach = sum(timed(lambda hand=hand: hand.postures(plates))[1] for hand in _hands(planner))
    _, merge_seconds = timed(
        lambda: build_graph(
            planner.poses, graph.grips, graph.pushes, planner.grip_postures, planner.push_postures, settings.costs
        )
    )
    alive = graph.knowledge.status == ALIVE
    grips, pushes = len(planner.grips), len(planner.pushes)
    return GraphFigures(
        name, grips, pushes, len(planner.poses.poses), len(planner.poses.edges), dcsg_seconds, reach + pair_seconds,
        grips + pushes + grips * pushes, tuple(by_hold.values()), merge_seconds, graph.graph.node_count,
        planner.examiner.examined, int(alive.sum()), int(alive[graph.edge_nodes].all(axis=1).sum()),
    )  # fmt: skip


def _search_figures(name: str, planner: PlateLiftPlanner) -> SearchFigures:
    graph = planner.graph
    alive = graph.knowledge.status == ALIVE
    starts = [start for start in graph.starts if alive[start]]
    paths, search_seconds = timed(lambda: [_cheapest(planner, start) for start in starts])
    first = _selected(planner, [path for path in paths if path is not None])
    plan, checked_seconds = timed(planner.search)
    return SearchFigures(
        name=name,
        minimise=planner.settings.minimise,
        starts=len(starts),
        goals=int((graph.goal & alive).sum()),
        search_seconds=search_seconds,
        first=first,
        checked=PathFigures(
            len(plan.steps), _changes(step.contact for step in plan.steps), max(step.force for step in plan.steps)
        )
        if plan.steps
        else None,
        sequences=int(plan.search["sequences"] or 0),
        checked_seconds=checked_seconds,
    )


def _cheapest(planner: PlateLiftPlanner, start: int) -> GraphPath | None:
    graph, by_force = planner.graph, planner.settings.minimise == "force"
    heuristic = np.zeros_like(graph.heuristic) if by_force else graph.heuristic
    return cheapest_path(
        graph.graph, graph.knowledge, start, graph.goal, heuristic, planner.examiner, bottleneck=by_force
    )


def _selected(planner: PlateLiftPlanner, paths: list[GraphPath]) -> PathFigures | None:
    """Of the cheapest path of each start the one of least force, as the paper selects."""
    if not paths:
        return None
    force, path = min(
        ((max(map(planner.examiner.largest_force, path.nodes)), path) for path in paths), key=lambda pair: pair[0]
    )
    contacts = (planner.poses.poses[int(planner.graph.node_pose[node])].contact for node in path.nodes)
    return PathFigures(len(path.nodes), _changes(contacts), force)


def _changes(contacts: Iterable[object]) -> int:
    return sum(before != after for before, after in pairwise(contacts))


def _hands(planner: PlateLiftPlanner) -> tuple:
    return planner.pair.first, planner.pair.second
