"""What a suction-tool planner looked at, as a plan lists it for drawing: cup, grasps, regrasp graphs."""

from __future__ import annotations

from planners.contract.arrays import significant
from planners.geometry.pose import pose_row, to_pose7s
from planners.plan.considered import (
    Considered,
    ConsideredPlace,
    ConsideredSuctionPose,
    GraspList,
    RegraspEdge,
    RegraspGraph,
    RegraspLayer,
    RegraspStep,
)
from planners.plan.scenery import ARMS
from planners.regrasp.graph.regrasp_figures import EdgeFigures, LayerFigures, RegraspFigures
from planners.regrasp.suction.suction_poses import SuctionCandidate
from planners.regrasp.tool_plan import ToolPlan


def considered_by(plan: ToolPlan) -> Considered:
    """Return all that was looked at."""
    return Considered(
        order=list(plan.order),
        steps=[
            RegraspStep(object=step.object, round=step.round, arm=step.arm, grasp=step.grasp, by=step.by)
            for step in plan.steps
        ],
        places={name: [_place(place) for place in places] for name, places in plan.considered.places.items()},
        suction_poses=[
            ConsideredSuctionPose(
                object=tried.object,
                pose=pose_row(tried.T_object_tool),
                reason=None if tried.rejection is None else tried.rejection.reason,
            )
            for tried in plan.considered.suctions
        ],
        tool_grasps=GraspList(
            poses=significant(to_pose7s(plan.grasps.T_tool_tcp)), widths=significant(plan.grasps.widths)
        ),
        regrasp_graphs=[_graph(figures) for figures in plan.regrasp],
    )


def _place(place: SuctionCandidate) -> ConsideredPlace:
    reason = None if place.reason is None else place.reason.value
    return ConsideredPlace(point=significant(place.point), normal=significant(place.normal), reason=reason)


def _graph(figures: RegraspFigures) -> RegraspGraph:
    return RegraspGraph(
        object=figures.object,
        moved=figures.moved,
        suction_pose=pose_row(figures.T_object_tool),
        arms=list(ARMS),
        layers=[_layer(layer) for layer in figures.layers],
        handover_pairs=figures.handover_pairs,
        edges=[_edge(edge) for edge in figures.edges],
        sequence=list(figures.sequence),
    )


def _layer(layer: LayerFigures) -> RegraspLayer:
    return RegraspLayer(
        layer=layer.layer.value,
        goal=layer.goal,
        tool_pose=pose_row(layer.T_world_tool),
        possible=list(layer.possible),
        rejected={reason: list(nodes) for reason, nodes in layer.rejected.items()},
    )


def _edge(edge: EdgeFigures) -> RegraspEdge:
    return RegraspEdge(
        **{"from": edge.start},
        kind=edge.kind.value,
        round=edge.round,
        to=edge.end,
        goal=edge.goal,
        state=edge.state.value,
        reason=edge.reason,
    )
