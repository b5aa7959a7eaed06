"""Which hand reaches which pose of the plate in which postures, and what follows from it whatever is kept back."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from planners.collision.model import CollisionModel, CollisionQuery, Fixed
from planners.geometry.pose import inverse
from planners.graph.rejections import Rejection, Rejections
from planners.manipulation.graph.manipulation_graph import HandHold, ManipulationStateGraph, build_graph, edge_count
from planners.manipulation.graph.rising_reach import RisingReach
from planners.manipulation.lift_sampling import LiftSampling
from planners.manipulation.motion.posture_follower import PostureFollower, PostureQueries, SweepSettings
from planners.manipulation.reach.hand_reach import Hand, HandReach, PairReach, PlateQuery
from planners.manipulation.reach.lift_workcell import LiftWorkcell
from planners.manipulation.reach.reach_memory import ReachMemory
from planners.manipulation.reach.reached_postures import ReachedPostures
from planners.manipulation.statics.hold_balance import HoldBalance
from planners.manipulation.statics.lift_programs import keeping_back
from planners.progress import Progress, Report


class LiftReach:
    """The reach of both hands in one sampling, and the graph that is merged from it."""

    def __init__(
        self,
        sampling: LiftSampling,
        rejections: Rejections,
        progress: Progress,
        memory: ReachMemory | None = None,
        ruled_out: NDArray[np.bool_] | None = None,
    ) -> None:
        """Find the postures, and take all holds from the poses at which plate or cup meet what stands in the cell.

        Args:
            sampling: poses and holds.
            rejections: what plate or cup meet is added.
            progress: told of the poses; may raise to stop.
            memory: of what other lifts have found; None: there were none.
            ruled_out: (poses, 1 + grips, 1 + pushes) what no graph has to contain, 0 for the hand that is absent.
        """
        workcell, plates = sampling.workcell, sampling.T_world_plates
        self.sampling, self.pair = sampling, _pair_reach(sampling)
        if memory is None:
            grips, pushes = self.pair.some_postures(plates, lambda done: progress(Report("reach", done, len(plates))))
        else:
            progress(Report("reach", 0, len(plates)))
            grips, pushes = memory.postures(workcell, self.pair, plates)
            progress(Report("reach", len(plates), len(plates)))
        self.lifted = workcell.plate_query(workcell.holding, workcell.lifted, hands=[])
        for names in self.lifted.meetings(plates):
            rejections.add(meeting(*names))
        blocked = self.lifted.first_collisions(plates) >= 0
        grips[blocked] = 0
        pushes[blocked] = 0
        self.reached = ReachedPostures(self.pair, plates, (grips, pushes), whole=memory is not None)
        self.follower = PostureFollower(
            sampling.poses,
            self.reached,
            _posture_queries(workcell, self.lifted),
            (sampling.grips, sampling.pushes),
            SweepSettings.of(workcell.scene.cell),
        )
        self._ruled_out = ruled_out
        self._whole: ManipulationStateGraph | None = None
        self._risings: dict[tuple[float, ...], RisingReach] = {}

    def with_limits(self, sampling: LiftSampling) -> LiftReach:
        """Return the same reach for a sampling in which nothing but forces is another."""
        other = copy(self)
        other.sampling, other._risings = sampling, {}
        return other

    @property
    def edge_count(self) -> int:
        """How many edges the graph of all holds has."""
        return self.edges_left(self._ruled_out)

    def edges_left(self, ruled_out: NDArray[np.bool_] | None) -> int:
        """Return how many edges that graph would have without the nodes (poses, 1 + grips, 1 + pushes) given."""
        return edge_count(self.sampling.poses, self.sampling.holds, self.reached.some, ruled_out)

    def graph(self, grips: tuple[HandHold, ...], pushes: tuple[HandHold, ...]) -> ManipulationStateGraph:
        """Merge the graph of these holds, nothing in it examined; that of all holds is asked for again and again.

        All postures have to be known of those that are told apart.
        """
        known = self._whole
        if known is None or (known.grips, known.pushes) != (grips, pushes):
            # Two of the largest would not fit into memory.
            self._whole = None
            costs = self.sampling.settings.costs
            known = build_graph(self.sampling.poses, grips, pushes, *self.reached.some, costs, self._ruled_out)
            if (grips, pushes) == self.sampling.holds:
                self._whole = known
        return known.unexamined()

    def rising(self, heights: Sequence[float], balance: HoldBalance) -> RisingReach | None:
        """Return what goals have to do so that the lift can go on straight up; None where no height is asked for.

        Args:
            heights: rising, at which that is looked at [m].
            balance: with the share of all limits that is kept back; of the cup's force more is.
        """
        if not heights:
            return None
        stated, key = self.sampling.stated, tuple(heights)
        kept = keeping_back(stated, self.sampling.settings.cup_reserve, balance.reserve)
        if key not in self._risings:
            self._risings[key] = RisingReach(balance, self.pair, self.lifted, heights, kept)
        return self._risings[key].keeping(balance, kept)


def meeting(one: str, other: str) -> Rejection:
    """Return the rejection of a place at which the plate or its cup, whichever is named, meets the other."""
    body, obstacle = (one, other) if one in ("plate", "cup") else (other, one)
    return Rejection("clearance", f"the {body} would touch {obstacle}")


def _pair_reach(sampling: LiftSampling) -> PairReach:
    """Return what the two hands can be asked; a grip has two flips, a push several turns about the stick."""
    workcell, rolls = sampling.workcell, sampling.settings.pushes.rolls
    T_tcp_flange = inverse(workcell.gripping_hand.T_flange_tcp(workcell.grip_width))
    T_tip_flange = inverse(workcell.pushing_hand.T_flange_tcp)
    T_plate_tcp = np.array([grip.T_plate_tcp for grip in sampling.grips]).reshape(-1, 2, 4, 4)
    T_plate_tip = np.array([push.T_plate_tcp for push in sampling.pushes]).reshape(-1, rolls, 4, 4)
    between = workcell.plate_query(workcell.holding, workcell.between_arms, hands=[workcell.gripper, workcell.pusher])
    return PairReach(
        _hand_reach(workcell, workcell.gripper, T_plate_tcp @ T_tcp_flange),
        _hand_reach(workcell, workcell.pusher, T_plate_tip @ T_tip_flange),
        between,
    )


def _posture_queries(workcell: LiftWorkcell, lifted: PlateQuery) -> PostureQueries:
    """Return what counts as a collision when postures are followed along the plate's motions and approaches."""
    gripper, pusher = workcell.gripper, workcell.pusher
    with_idle: dict[Hand, PlateQuery] = {
        "grip": workcell.plate_query(workcell.holding, workcell.with_idle(gripper), hands=[gripper]),
        "push": workcell.plate_query(workcell.open, workcell.with_idle(pusher), hands=[pusher]),
    }
    opened: dict[Hand, PlateQuery] = {
        "grip": workcell.plate_query(workcell.open, workcell.without_other(gripper), hands=[gripper]),
        "push": workcell.plate_query(workcell.open, workcell.without_other(pusher), hands=[pusher]),
    }
    share, T_world_plate = workcell.settings.executed_share, Fixed(workcell.scene.T_world_plate)

    def between(model: CollisionModel) -> CollisionQuery:
        return workcell.query(model, workcell.between_arms, T_world_plate, hands=[gripper, pusher], share=share)

    beside: dict[Hand, CollisionQuery] = {"grip": between(workcell.open), "push": between(workcell.holding)}
    return PostureQueries(with_idle, opened, beside, lifted)


def _hand_reach(workcell: LiftWorkcell, arm: str, T_plate_flange: np.ndarray) -> HandReach:
    return HandReach(
        arm=workcell.arm(arm),
        first_joint=workcell.joints(arm).start,
        T_plate_flange=np.ascontiguousarray(T_plate_flange),
        alone=workcell.plate_query(workcell.holding, workcell.without_other(arm), hands=[arm]),
        hand_only=workcell.plate_query(workcell.holding, workcell.hand_without_other(arm), hands=[arm]),
        start_positions=workcell.scene.start_positions,
    )
