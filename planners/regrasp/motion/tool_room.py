"""Whether there is room for the tool at a suction pose, hands left out: the cheapest question about it."""

from __future__ import annotations

from collections.abc import Sequence

from planners.collision.model import Fixed, PairMask, Placement
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Transform
from planners.graph.rejections import Rejection, Rejections
from planners.regrasp.motion.scene_state import SceneState
from planners.regrasp.motion.state_queries import StateQueries
from planners.regrasp.motion.tool_motion import moved_by
from planners.regrasp.suction.suction_poses import STAGE, SuctionPose
from planners.regrasp.tool_workcell import TOOL_FRAME
from planners.scene.moved_object import MovedObject


class ToolRoom:
    """Asks what stands still, other objects among it, whether the tool alone overlaps it."""

    def __init__(self, queries: StateQueries, descent: float, *, objects: bool = True) -> None:
        """Take what all objects share.

        Args:
            queries: who may come how close to whom.
            descent: straight way of the tool along the facet's normal, onto the object and off it [m].
            objects: whether other objects are in the way, or only what never moves.
        """
        self._queries, self._descent = queries, descent
        self._left_out = frozenset() if objects else frozenset(body.name for body in queries.workcell.objects)

    def poses(
        self, state: SceneState, target: MovedObject, poses: Sequence[SuctionPose], most: int, rejections: Rejections
    ) -> tuple[SuctionPose, ...]:
        """Return the first `most` suction poses at which the tool has room at the start and at a goal.

        Args:
            state: where everything is.
            target: the object.
            poses: in the order in which they are to be tried.
            most: that are returned.
            rejections: what was in the way is added.
        """
        kept: list[SuctionPose] = []
        for pose in poses:
            in_the_way = self._in_the_way(state, target, pose)
            if in_the_way is None:
                kept.append(pose)
            else:
                rejections.add(Rejection(STAGE, in_the_way, target.name))
            if len(kept) == most:
                break
        return tuple(kept)

    def _in_the_way(self, state: SceneState, target: MovedObject, pose: SuctionPose) -> str | None:
        T_object_tool = pose.T_object_tool
        touched = self._touched(state, target.name, state.T_world_objects[target.name] @ T_object_tool)
        if touched is not None:
            return f"With its cup on the object at its start, the tool has no room beside {touched}."
        at_goals = (self._touched(state, target.name, T_world_goal @ T_object_tool) for T_world_goal in target.goals)
        first = next(at_goals)
        if first is None or any(touched is None for touched in at_goals):
            return None
        return f"With its cup on the object at its goal, the tool has no room beside {first}."

    def _touched(self, state: SceneState, name: str, T_world_tool: Transform) -> str | None:
        """Return what the tool overlaps on the object, or is too close to where its straight way there begins."""
        workcell = self._queries.workcell
        away = moved_by(T_world_tool, self._descent * T_world_tool[:3, 2])
        placements: dict[str, Placement | None] = {key: Fixed(T) for key, T in state.T_world_objects.items()}
        for T, share in ((T_world_tool, 0.0), (away, 1.0)):
            placements[TOOL_FRAME] = Fixed(T)
            query = workcell.query(state.widths, placements, share=share, only=self._pairs(name))
            pair = int(query.first_collision(state.q)[0])
            if pair >= 0:
                return next(touched for touched in query.pair_names(pair) if touched != workcell.tool.body.name)
        return None

    def _pairs(self, name: str) -> PairMask:
        """Choose the pairs of the tool with all but the arms and the object it is on."""
        workcell = self._queries.workcell
        arms, left_out = workcell.cell.arms, self._left_out | {name}

        def chosen(a: CollisionBody, b: CollisionBody) -> bool:
            one = (a.frame == TOOL_FRAME) != (b.frame == TOOL_FRAME)
            return one and not {a.group, b.group} & arms.keys() and not {a.frame, b.frame} & left_out

        return workcell.pairs(("room", left_out), chosen)
