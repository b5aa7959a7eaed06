"""What a suction-tool planner looked at: places for the cup, grasps of the tool, and regrasp graphs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from app.viewer.palette import GOOD_COLOUR, REASON_COLOURS

LAST_LAYER = "suction"
"""The layer whose grasps are drawn: the tool on the object at its start."""


@dataclass(frozen=True)
class GraspNode:
    """A grasp of the tool by an arm, and why it fell; None: it is possible."""

    arm: str
    grasp: int
    reason: str | None


def looked_at(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what a document lists as considered; nothing for a plate lift."""
    return document["statistics"].get("considered") or {}


def graph_of(document: Mapping[str, Any], name: str) -> Mapping[str, Any] | None:
    """Return the regrasp graph of an object: the one that moved it, else the last one that was tried."""
    graphs = looked_at(document).get("regrasp_graphs", ())
    mine = [graph for graph in graphs if graph["object"] == name]
    moved = [graph for graph in mine if graph["moved"]]
    return (moved or mine or [None])[-1]


def layer_of(graph: Mapping[str, Any], name: str) -> Mapping[str, Any] | None:
    """Return a layer of a graph by its name."""
    return next((layer for layer in graph["layers"] if layer["layer"] == name), None)


def nodes_of(document: Mapping[str, Any], graph: Mapping[str, Any], layer: Mapping[str, Any]) -> Iterator[GraspNode]:
    """Yield the grasps that were asked in a layer, the rejected ones first."""
    count = len(document["statistics"]["considered"]["tool_grasps"]["widths"])
    for reason, nodes in layer["rejected"].items():
        yield from (GraspNode(graph["arms"][node // count], node % count, reason) for node in nodes)
    yield from (GraspNode(graph["arms"][node // count], node % count, None) for node in layer["possible"])


def reason_colours(document: Mapping[str, Any]) -> dict[str | None, str]:
    """Return a colour for each reason that appears, the most frequent first; None is for what did not fall."""
    counts: Counter[str] = Counter()
    considered = looked_at(document)
    for places in considered.get("places", {}).values():
        counts.update(place["reason"] for place in places if place["reason"] is not None)
    for graph in considered.get("regrasp_graphs", ()):
        for layer in graph["layers"]:
            counts.update({reason: len(nodes) for reason, nodes in layer["rejected"].items()})
        counts.update(edge["reason"] for edge in graph["edges"] if edge["reason"] is not None)
    colours: dict[str | None, str] = {None: GOOD_COLOUR}
    for index, (reason, _) in enumerate(counts.most_common()):
        colours[reason] = REASON_COLOURS[min(index, len(REASON_COLOURS) - 1)]
    return colours


def tell_considered(document: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return what the page draws and counts, by object; None where nothing was considered."""
    considered = looked_at(document)
    if not considered:
        return None
    return {
        "grasps": len(considered.get("tool_grasps", {}).get("widths", ())),
        "colours": [{"reason": reason, "colour": colour} for reason, colour in reason_colours(document).items()],
        "objects": [_object(document, name) for name in _names(document)],
    }


def _names(document: Mapping[str, Any]) -> list[str]:
    """Return all objects, those that are moved first, in their order."""
    order = document["statistics"]["considered"]["order"]
    given = [item["name"] for item in document["task"]["objects"]]
    return list(dict.fromkeys([*order, *given]))


def _object(document: Mapping[str, Any], name: str) -> dict[str, Any]:
    graph, considered = graph_of(document, name), document["statistics"]["considered"]
    return {
        "name": name,
        "places": _tally(place["reason"] for place in considered["places"].get(name, ())),
        "grasps": _grasp_tally(document, graph),
        "held": any(step["object"] == name and step["by"] == "held" for step in considered["steps"]),
        "graph": None if graph is None else _graph(graph),
    }


def _grasp_tally(document: Mapping[str, Any], graph: Mapping[str, Any] | None) -> list[list[Any]]:
    layer = None if graph is None else layer_of(graph, LAST_LAYER)
    if graph is None or layer is None:
        return []
    return _tally(node.reason for node in nodes_of(document, graph, layer))


def _tally(reasons: Iterator[str | None]) -> list[list[Any]]:
    """Return reasons with their numbers, what did not fall first, then the most frequent."""
    counts = Counter(reasons)
    return [[reason, n] for reason, n in sorted(counts.items(), key=lambda item: (item[0] is not None, -item[1]))]


def _graph(graph: Mapping[str, Any]) -> dict[str, Any]:
    members = ("moved", "arms", "handover_pairs", "edges", "sequence")
    layers = [{k: layer[k] for k in ("layer", "goal", "possible", "rejected")} for layer in graph["layers"]]
    return {**{member: graph[member] for member in members}, "layers": layers}
