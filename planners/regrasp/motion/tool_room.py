"""Whether there is room for the tool at a suction pose, hands left out: the cheapest question about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.collision.kernel import CollisionKernel, first_collisions, set_frame
from planners.collision.model import CollisionQuery, Fixed, PairMask, Placement
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Array, Transform
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
        room = _Room.of(self._queries, state, self._pairs(target.name))
        for pose in poses:
            in_the_way = self._in_the_way(room, target, state.T_world_objects[target.name], pose)
            if in_the_way is None:
                kept.append(pose)
            else:
                rejections.add(Rejection(STAGE, in_the_way, target.name))
            if len(kept) == most:
                break
        return tuple(kept)

    def _in_the_way(self, room: _Room, target: MovedObject, T_world_object: Transform, pose: SuctionPose) -> str | None:
        T_object_tool = pose.T_object_tool
        touched = room.touched(T_world_object @ T_object_tool, self._descent)
        if touched is not None:
            return f"With its cup on the object at its start, the tool has no room beside {touched}."
        at_goals = (room.touched(T_world_goal @ T_object_tool, self._descent) for T_world_goal in target.goals)
        first = next(at_goals)
        if first is None or any(touched is None for touched in at_goals):
            return None
        return f"With its cup on the object at its goal, the tool has no room beside {first}."

    def _pairs(self, name: str) -> PairMask:
        """Choose the pairs of the tool with all but the arms and the object it is on."""
        workcell = self._queries.workcell
        arms, left_out = workcell.cell.arms, self._left_out | {name}

        def chosen(a: CollisionBody, b: CollisionBody) -> bool:
            one = (a.frame == TOOL_FRAME) != (b.frame == TOOL_FRAME)
            return one and not {a.group, b.group} & arms.keys() and not {a.frame, b.frame} & left_out

        return workcell.pairs(("room", left_out), chosen)


@dataclass(frozen=True, eq=False)
class _Room:
    """What stands still in one state, asked about one place of the tool after the other."""

    queries: tuple[CollisionQuery, CollisionQuery]
    """With no margins, and with all of them."""
    kernels: tuple[CollisionKernel, CollisionKernel]
    """Theirs, in which the tool is placed."""
    q: Array
    """(1, 12) [rad]"""
    tool: str
    """Name of its body."""

    @classmethod
    def of(cls, queries: StateQueries, state: SceneState, pairs: PairMask) -> _Room:
        """Place everything but the tool."""
        placements: dict[str, Placement | None] = {name: Fixed(T) for name, T in state.T_world_objects.items()}
        placements[TOOL_FRAME] = Fixed(state.T_world_tool)
        workcell = queries.workcell
        touching, close = (workcell.query(state.widths, placements, share=share, only=pairs) for share in (0.0, 1.0))
        kernels = touching.kernel_copy(), close.kernel_copy()
        return cls((touching, close), kernels, np.ascontiguousarray(state.q[None]), workcell.tool.body.name)

    def touched(self, T_world_tool: Transform, descent: float) -> str | None:
        """Return what the tool overlaps on the object, or is too close to where its straight way there begins."""
        away = moved_by(T_world_tool, descent * T_world_tool[:3, 2])
        for query, kernel, T in zip(self.queries, self.kernels, (T_world_tool, away), strict=True):
            set_frame(kernel, query.frame_index(TOOL_FRAME), T)
            pair = int(first_collisions(kernel, self.q)[0])
            if pair >= 0:
                return next(name for name in query.pair_names(pair) if name != self.tool)
        return None
