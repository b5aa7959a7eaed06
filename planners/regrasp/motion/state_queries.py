"""Who may come how close to whom in each step of a suction-tool plan, as collision queries."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from planners.collision.model import Attached, CollisionQuery, Fixed, NamePair, PairMask, Placement, Riding
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Transform, inverse
from planners.regrasp.grasps.tool_grasps import ToolGrasps
from planners.regrasp.motion.scene_state import HeldGrasp, SceneState
from planners.regrasp.tool_workcell import TOOL_FRAME, ToolWorkcell


class StateQueries:
    """Collision queries of one scene for stages of its plan. Only what moves is checked, against everything."""

    def __init__(self, workcell: ToolWorkcell, grasps: ToolGrasps) -> None:
        self.workcell, self.grasps = workcell, grasps
        self.T_tool_flanges = {arm: grasps.T_tool_flange(workcell.gripper(arm)) for arm in workcell.cell.arms}

    def T_tool_flange(self, held: HeldGrasp) -> Transform:
        """Return where the flange is on the tool in a grasp."""
        return self.T_tool_flanges[held.arm][held.grasp]

    def hand(self, state: SceneState, arm: str, *, around: bool = False, share: float = 1.0) -> CollisionQuery:
        """Query an arm that moves an empty hand; the tool stays where it is, at rest or in the other hand.

        Args:
            state: where everything is.
            arm: which arm.
            around: whether the open fingers are about to take the tool, or have just let go of it.
            share: the part of all margins that is kept.
        """
        placements = {TOOL_FRAME: Fixed(state.T_world_tool), **self._objects(state)}
        return self.workcell.query(
            state.widths, placements, around=[arm] if around else [], share=share, only=self._moving(arm, frozenset())
        )

    def carrying(
        self, state: SceneState, margins: Mapping[NamePair, float] | None = None, *, share: float = 1.0
    ) -> CollisionQuery:
        """Query an arm that moves the tool it holds, and the object on the cup.

        Args:
            state: where everything is; the tool is held by one arm.
            margins: of pairs that may come closer than the usual margin [m].
            share: the part of all margins that is kept.
        """
        held = state.holder
        assert held is not None
        placements = {TOOL_FRAME: Attached(held.arm, inverse(self.T_tool_flange(held))), **self._objects(state)}
        return self.workcell.query(
            state.widths,
            placements,
            holding=[held.arm],
            margins=margins,
            share=share,
            only=self._moving(held.arm, state.carried),
        )

    def everything(self, state: SceneState, holding: Iterable[str]) -> CollisionQuery:
        """Query both arms, the tool and the object on the cup among all else; the tool stays where it is."""
        either = [self._moving(arm, state.carried) for arm in self.workcell.cell.arms]
        placements = {TOOL_FRAME: Fixed(state.T_world_tool), **self._objects(state)}
        return self.workcell.query(state.widths, placements, holding=holding, only=either[0] | either[1])

    def close_pairs(self, state: SceneState, carried: frozenset[str]) -> dict[NamePair, float]:
        """Return margins of the pairs that what is carried may come close to, because it stands there already.

        A body that rests beside another keeps apart from it, and one that rests on another may seem to overlap it by
        as much as bodies do that touch by intention. What overlaps by more is not among them.
        """
        margins: dict[NamePair, float] = {}
        depth = self.workcell.settings.touch_depth
        model = self.workcell.model(state.widths)
        arms = self.workcell.cell.arms

        def chosen(a: CollisionBody, b: CollisionBody) -> bool:
            return (a.frame in carried) != (b.frame in carried) and not {a.group, b.group} & arms.keys()

        mask = self.workcell.pairs(("close", carried), chosen)
        placements = {TOOL_FRAME: Fixed(state.T_world_tool), **self._objects(state)}
        for _ in range(2 * len(model.pair_names)):
            query = self.workcell.query(state.widths, placements, margins=margins, only=mask)
            pair = int(query.first_collision(state.q)[0])
            if pair < 0:
                break
            names = query.pair_names(pair)
            if margins.get(names) == -depth:
                break
            margins[names] = 0.0 if names not in margins else -depth
        return margins

    def _objects(self, state: SceneState) -> dict[str, Placement]:
        placements: dict[str, Placement] = {name: Fixed(T) for name, T in state.T_world_objects.items()}
        if state.sucked is not None:
            placements[state.sucked.name] = Riding(TOOL_FRAME, state.sucked.T_tool_object)
        return placements

    def _moving(self, arm: str, carried: frozenset[str]) -> PairMask:
        """Choose the pairs of an arm and of what it carries with all else."""

        def moves(body: CollisionBody) -> bool:
            return body.group == arm or body.frame in carried

        def chosen(a: CollisionBody, b: CollisionBody) -> bool:
            return (moves(a) or moves(b)) and not (a.frame in carried and b.frame in carried)

        return self.workcell.pairs(("moving", arm, carried), chosen)
