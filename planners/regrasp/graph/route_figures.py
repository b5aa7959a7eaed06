"""From a suction route that was tried to the figures of its regrasp graph."""

from __future__ import annotations

import numpy as np

from planners.geometry.pose import Transform
from planners.regrasp.graph.grasp_layer import GraspLayer
from planners.regrasp.graph.regrasp_figures import (
    EdgeFigures,
    EdgeState,
    LayerFigures,
    LayerName,
    RegraspEdgeKind,
    RegraspFigures,
)
from planners.regrasp.graph.regrasp_graph import Edge, Handover, Pick, Sequence
from planners.regrasp.graph.suction_route import SuctionRoute


def route_figures(name: str, route: SuctionRoute, T_world_tool: Transform, chosen: Sequence | None) -> RegraspFigures:
    """Return what a route has asked and tried.

    Args:
        name: of the object.
        route: with its suction pose.
        T_world_tool: where the tool was before.
        chosen: the sequence that was moved, if any.
    """
    tried = list(route.tried)
    goals = sorted({goal for edge in tried if (goal := _goal(edge)) is not None})
    layers = [_initial(route, T_world_tool), _layer(LayerName.SUCTION, None, route.suction)]
    layers += [_layer(LayerName.GOAL, goal, route.goals[goal]) for goal in goals]
    return RegraspFigures(
        object=name,
        moved=chosen is not None,
        T_object_tool=route.pose.T_object_tool,
        layers=tuple(layers),
        handover_pairs=route.handover_pairs,
        edges=tuple(_edge(edge, route, chosen) for edge in tried),
        sequence=() if chosen is None else tuple(tried.index(edge) for edge in chosen.edges),
    )


def _initial(route: SuctionRoute, T_world_tool: Transform) -> LayerFigures:
    start = route.start
    if start.layer is None:
        return LayerFigures(LayerName.INITIAL, None, T_world_tool, _numbers(start.nodes), {})
    return _layer(LayerName.INITIAL, None, start.layer)


def _layer(name: LayerName, goal: int | None, layer: GraspLayer) -> LayerFigures:
    rejected = {reason: _numbers(mask) for reason, mask in layer.rejected().items()}
    return LayerFigures(name, goal, layer.T_world_tool, _numbers(layer.reached), rejected)


def _edge(edge: Edge, route: SuctionRoute, chosen: Sequence | None) -> EdgeFigures:
    rejection = route.tried[edge]
    state = EdgeState.MOVED if rejection is None else EdgeState.DELETED
    if chosen is not None and edge in chosen.edges:
        state, rejection = EdgeState.CHOSEN, None
    reason = None if rejection is None else rejection.reason
    if isinstance(edge, Pick):
        return EdgeFigures(RegraspEdgeKind.PICK, 0, None, edge.node, None, state, reason)
    if isinstance(edge, Handover):
        return EdgeFigures(RegraspEdgeKind.HANDOVER, edge.round, edge.giver, edge.receiver, None, state, reason)
    return EdgeFigures(RegraspEdgeKind.TRANSFER, edge.round, edge.node, edge.node, _goal(edge), state, reason)


def _goal(edge: Edge) -> int | None:
    """Return the goal pose that an edge leads to; None where it leads to none."""
    return None if isinstance(edge, Pick | Handover) or edge.round == 0 else edge.end


def _numbers(mask: np.ndarray) -> tuple[int, ...]:
    return tuple(np.flatnonzero(mask).tolist())
