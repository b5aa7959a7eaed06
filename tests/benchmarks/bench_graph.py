"""Tables III and IV of paper B: the whole graph, examined node by node, and searched for all starts and goals.

It is the graph of the planner that people run, and of the same planner with what is ours left out, one thing at a time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter
from typing import Any

from planners.graph.search import ALIVE, UNKNOWN, GoalSearch, GraphPath
from planners.manipulation.contacts.dense_contact_states import DenseContactStateGraph
from planners.manipulation.graph.manipulation_graph import build_graph
from planners.manipulation.graph.node_examiner import hands_of
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.statics.hold_balance import HandPair
from tests.benchmarks.lift_variants import OURS, VARIANTS, Variant, kept_reserve
from tests.benchmarks.tasks import SOLVABLE, Note, timed


@dataclass(frozen=True)
class GraphFigures:
    """Table III for one task; seconds."""

    name: str
    variant: str
    reserve: float
    """Share of every limit that is kept back [1]."""
    grips: int
    pushes: int
    dcsg_nodes: int
    dcsg_edges: int
    dcsg_seconds: float
    reach_seconds: float
    """RV1: which hand reaches which pose free of collision, and which pairs of hands keep the arms apart."""
    rise_seconds: float
    """Whether hands can go up from where they hold the plate at a goal; the paper does not ask."""
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
    variant: str
    minimise: str
    reserve: float
    """Share of every limit that is kept back [1]."""
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


class Timed:
    """Stands before an object and adds up the seconds spent in its methods."""

    def __init__(self, timed_object: object) -> None:
        self._object, self.seconds = timed_object, 0.0

    def __getattr__(self, name: str) -> Any:
        member = getattr(self._object, name)
        return self._timed(member) if callable(member) else member

    def _timed(self, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any, **named: Any) -> Any:
            found, seconds = timed(lambda: method(*given, **named))
            self.seconds += seconds
            return found

        return call


def measure(
    note: Note, names: Sequence[str] = SOLVABLE, variants: Sequence[Variant] = VARIANTS
) -> tuple[list[GraphFigures], list[SearchFigures]]:
    """Build and search the whole graph of each task with each variant of the planner; ours for either objective."""
    graphs, searches = [], []
    for name in names:
        for variant in variants:
            for minimise in ("cost", "force") if variant is OURS else ("cost",):
                note(f"whole graph of {name}, least {minimise}, {variant.name}")
                planner = variant.planner(name, minimise=minimise, reserve=kept_reserve(name, minimise))
                planner.begin()
                examined = _examine(planner)
                if minimise == "cost":
                    graphs.append(_graph_figures(name, variant, planner, examined))
                searches.append(_search_figures(name, variant, planner))
    return graphs, searches


@dataclass(frozen=True)
class _Examined:
    """Seconds that examining all nodes took."""

    pairs: float
    rise: float
    by_hold: Counter[HandPair]


def _examine(planner: PlateLiftPlanner) -> _Examined:
    """Have the planner's own examiner examine all nodes."""
    graph, examiner = planner.search.graph, planner.search.examiner
    pair, rise = Timed(examiner.pair), Timed(examiner.rising)
    examiner.pair = pair
    if examiner.rising is not None:
        examiner.rising = rise
    by_hold: Counter[HandPair] = Counter()
    for node in range(graph.graph.node_count):
        if graph.knowledge.status[node] == UNKNOWN:
            before, begun = pair.seconds + rise.seconds, perf_counter()
            examiner(node)
            spent = perf_counter() - begun - (pair.seconds + rise.seconds - before)
            by_hold[hands_of(*graph.hold_of(node))] += spent
    return _Examined(pair.seconds, rise.seconds, by_hold)


def _graph_figures(name: str, variant: Variant, planner: PlateLiftPlanner, seconds: _Examined) -> GraphFigures:
    graph, scene, settings, sampling = planner.search.graph, planner.scene, planner.settings, planner.sampling
    plates = sampling.T_world_plates
    _, dcsg_seconds = timed(
        lambda: DenseContactStateGraph.build(
            planner.sampling.prism, scene.plate.com, scene.T_world_plate, settings.sampling
        )
    )
    reach = sum(timed(lambda hand=hand: hand.postures(plates))[1] for hand in _hands(planner))
    _, merge_seconds = timed(
        lambda: build_graph(sampling.poses, graph.grips, graph.pushes, *planner.reach.reached.sets, settings.costs)
    )
    alive = graph.knowledge.status == ALIVE
    grips, pushes = len(planner.sampling.grips), len(planner.sampling.pushes)
    return GraphFigures(
        name=name,
        variant=variant.name,
        reserve=settings.reserve,
        grips=grips,
        pushes=pushes,
        dcsg_nodes=len(planner.sampling.poses.poses),
        dcsg_edges=len(planner.sampling.poses.edges),
        dcsg_seconds=dcsg_seconds,
        reach_seconds=reach + seconds.pairs,
        rise_seconds=seconds.rise,
        holds=grips + pushes + grips * pushes,
        balance_seconds=tuple(seconds.by_hold.values()),
        merge_seconds=merge_seconds,
        candidates=graph.graph.node_count,
        examined=planner.search.examiner.examined,
        nodes=int(alive.sum()),
        edges=int(alive[graph.edge_nodes].all(axis=1).sum()),
    )


def _search_figures(name: str, variant: Variant, planner: PlateLiftPlanner) -> SearchFigures:
    graph = planner.search.graph
    alive = graph.knowledge.status == ALIVE
    starts = [start for start in graph.starts if alive[start]]
    by_force = planner.settings.minimise == "force"

    def cheapest() -> list[GraphPath | None]:
        search = GoalSearch(graph.graph, graph.knowledge, graph.goal, planner.search.examiner, bottleneck=by_force)
        return [search.path_from(start) for start in starts]

    paths, search_seconds = timed(cheapest)
    first = _selected(planner, [path for path in paths if path is not None])
    plan, checked_seconds = timed(lambda: planner.planned(planner.search))
    return SearchFigures(
        name=name,
        variant=variant.name,
        minimise=planner.settings.minimise,
        reserve=planner.settings.reserve,
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


def _selected(planner: PlateLiftPlanner, paths: list[GraphPath]) -> PathFigures | None:
    """Of the cheapest path of each start the one of least force, as the paper selects."""
    if not paths:
        return None
    force, path = min(
        ((max(map(planner.search.examiner.largest_force, path.nodes)), path) for path in paths),
        key=lambda pair: pair[0],
    )
    contacts = (planner.sampling.poses.poses[int(planner.search.graph.node_pose[node])].contact for node in path.nodes)
    return PathFigures(len(path.nodes), _changes(contacts), force)


def _changes(contacts: Iterable[object]) -> int:
    return sum(before != after for before, after in pairwise(contacts))


def _hands(planner: PlateLiftPlanner) -> tuple:
    return planner.reach.pair.first, planner.reach.pair.second
