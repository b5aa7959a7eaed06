"""What a suction-tool planner looked at, as `statistics.considered` of its document: for drawing."""

from __future__ import annotations

from typing import Any

from planners.contract.document_members import pose_row, rounded
from planners.graph.rejections import Rejection
from planners.regrasp.regrasp_figures import RegraspFigures
from planners.regrasp.tool_plan import Considered, ToolPlan

ARMS = ["left", "right"]
"""As nodes of regrasp graphs count them."""


def considered_document(plan: ToolPlan) -> dict[str, Any]:
    """Return places and poses of the cup, all grasps of the tool, and the regrasp graph of each move.

    A reason of null is none: what it belongs to is good, or it is used.
    """
    return {
        "order": list(plan.order),
        "steps": [
            {"object": step.object, "round": step.round, "arm": step.arm, "grasp": step.grasp, "by": step.by}
            for step in plan.steps
        ],
        "places": _places(plan.considered),
        "suction_poses": [
            {"object": tried.object, "pose": pose_row(tried.T_object_tool), "reason": _reason(tried.rejection)}
            for tried in plan.considered.suctions
        ],
        "tool_grasps": {
            "poses": [pose_row(T) for T in plan.grasps.T_tool_tcp],
            "widths": rounded(plan.grasps.widths),
        },
        "regrasp_graphs": [_graph(figures) for figures in plan.regrasp],
    }


def _places(considered: Considered) -> dict[str, Any]:
    return {
        name: [
            {
                "point": rounded(place.point),
                "normal": rounded(place.normal),
                "reason": None if place.reason is None else place.reason.value,
            }
            for place in places
        ]
        for name, places in considered.places.items()
    }


def _graph(figures: RegraspFigures) -> dict[str, Any]:
    return {
        "object": figures.object,
        "moved": figures.moved,
        "suction_pose": pose_row(figures.T_object_tool),
        "arms": ARMS,
        "layers": [
            {
                "layer": layer.layer.value,
                "goal": layer.goal,
                "tool_pose": pose_row(layer.T_world_tool),
                "possible": list(layer.possible),
                "rejected": {reason: list(nodes) for reason, nodes in layer.rejected.items()},
            }
            for layer in figures.layers
        ],
        "handover_pairs": list(figures.handover_pairs),
        "edges": [
            {
                "kind": edge.kind.value,
                "round": edge.round,
                "from": edge.start,
                "to": edge.end,
                "goal": edge.goal,
                "state": edge.state.value,
                "reason": edge.reason,
            }
            for edge in figures.edges
        ],
        "sequence": list(figures.sequence),
    }


def _reason(rejection: Rejection | None) -> str | None:
    return None if rejection is None else rejection.reason
