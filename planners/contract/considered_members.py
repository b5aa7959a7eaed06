"""From what a suction-tool planner looked at to the document's `statistics.considered`."""

from __future__ import annotations

from typing import Any

from planners.contract.document_members import pose_row, significant
from planners.geometry.pose import to_pose7s
from planners.graph.rejections import Rejection
from planners.regrasp.graph.regrasp_figures import EdgeFigures, LayerFigures, RegraspFigures
from planners.regrasp.suction.suction_poses import SuctionCandidate
from planners.regrasp.tool_plan import ToolPlan

ARMS = ["left", "right"]
"""In the order in which nodes count arms."""


def considered_members(plan: ToolPlan) -> dict[str, Any]:
    """Return the members of `planners.contract.considered.Considered`."""
    return {
        "order": list(plan.order),
        "steps": [
            {"object": step.object, "round": step.round, "arm": step.arm, "grasp": step.grasp, "by": step.by}
            for step in plan.steps
        ],
        "places": {name: [_place(place) for place in places] for name, places in plan.considered.places.items()},
        "suction_poses": [
            {"object": tried.object, "pose": pose_row(tried.T_object_tool), "reason": _reason(tried.rejection)}
            for tried in plan.considered.suctions
        ],
        "tool_grasps": {
            "poses": significant(to_pose7s(plan.grasps.T_tool_tcp)),
            "widths": significant(plan.grasps.widths),
        },
        "regrasp_graphs": [_graph(figures) for figures in plan.regrasp],
    }


def _place(place: SuctionCandidate) -> dict[str, Any]:
    reason = None if place.reason is None else place.reason.value
    return {"point": significant(place.point), "normal": significant(place.normal), "reason": reason}


def _reason(rejection: Rejection | None) -> str | None:
    return None if rejection is None else rejection.reason


def _graph(figures: RegraspFigures) -> dict[str, Any]:
    return {
        "object": figures.object,
        "moved": figures.moved,
        "suction_pose": pose_row(figures.T_object_tool),
        "arms": ARMS,
        "layers": [_layer(layer) for layer in figures.layers],
        "handover_pairs": list(figures.handover_pairs),
        "edges": [_edge(edge) for edge in figures.edges],
        "sequence": list(figures.sequence),
    }


def _layer(layer: LayerFigures) -> dict[str, Any]:
    return {
        "layer": layer.layer.value,
        "goal": layer.goal,
        "tool_pose": pose_row(layer.T_world_tool),
        "possible": list(layer.possible),
        "rejected": {reason: list(nodes) for reason, nodes in layer.rejected.items()},
    }


def _edge(edge: EdgeFigures) -> dict[str, Any]:
    return {
        "kind": edge.kind.value,
        "round": edge.round,
        "from": edge.start,
        "to": edge.end,
        "goal": edge.goal,
        "state": edge.state.value,
        "reason": edge.reason,
    }
