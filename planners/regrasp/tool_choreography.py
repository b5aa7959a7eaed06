"""From steps of a regrasp sequence to motion: each step becomes planned, checked and timed segments."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.collision.model import CollisionQuery, NamePair
from planners.geometry.pose import Array, Transform, inverse
from planners.graph.rejections import Rejection
from planners.kinematics.forward import flange_poses
from planners.motion.arm_checker import ArmEdgeChecker
from planners.motion.blended_path import BlendedPath
from planners.motion.checker import EdgeChecker
from planners.motion.curve_path import CurvePath
from planners.motion.limits import JointLimits, RateLimit
from planners.motion.path import JointPath
from planners.motion.query import MotionOutcome, MotionQuery, plan_motion
from planners.motion.timing import TimingError, time_path
from planners.motion.trajectory import Trajectory, hold_still
from planners.regrasp.carried import carried_rates
from planners.regrasp.grasps import TOOL_FRAME
from planners.regrasp.hold_statics import HoldStatics
from planners.regrasp.level_checker import LevelChecker
from planners.regrasp.suction_hold import cup_wrenches, suction_margin, weight
from planners.regrasp.tool_segment import SuckedObject, ToolHold, ToolSegment
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.regrasp.tool_stage import HeldGrasp, ToolStage
from planners.regrasp.tool_traffic import ToolTraffic
from planners.regrasp.visit import Posture, StraightLeg, Visit
from planners.scene.arm import Arm
from planners.segment import SegmentKind

_UP = np.array([0.0, 0.0, 1.0])
SLOWER = 1.05
"""A motion that cup or fingers do not hold is slowed by this much more than it need be: its timing changes too."""
SLOWINGS = 4
"""How often a motion is slowed before it is given up."""


@dataclass(frozen=True, eq=False)
class HandoverPlace:
    """A pose of the tool at which it can change hands, and the branches both arms may use there, as bit sets."""

    T_world_tool: Transform
    giver: int
    receiver: int


class Stuck(Exception):
    """A step cannot be moved; `rejection` says why."""

    def __init__(self, rejection: Rejection) -> None:
        self.rejection = rejection
        super().__init__(rejection.reason)


class ToolChoreographer:
    """Plans the motion of single steps in one scene: each leads from one stage to the next, or raises `Stuck`."""

    def __init__(
        self,
        traffic: ToolTraffic,
        statics: HoldStatics,
        park: Mapping[str, Array],
        settings: ToolPlannerSettings,
        rng: np.random.Generator,
    ) -> None:
        """Take what all steps share.

        Args:
            traffic: collision queries.
            statics: whether cup and fingers hold.
            park: (6,) where each arm stands while the other moves [rad].
            settings: distances, paces and budgets.
            rng: of the searches for free motion.
        """
        self.traffic, self.statics, self.settings, self.rng = traffic, statics, settings, rng
        self.workcell, self.grasps = traffic.workcell, traffic.grasps
        self._park = park
        self.motion_queries = 0

    # Steps.

    def pick_up(self, stage: ToolStage, held: HeldGrasp, branches: int) -> ToolStage:
        """Take the tool from where it rests and lift it straight up."""
        stage = self.shaped(self.parked(stage, self.workcell.other(held.arm)), held)
        T_world_flange = stage.T_world_tool @ self.traffic.T_tool_flange(held)
        lift = StraightLeg(T_world_flange, self.settings.carry.unrest * _UP)
        visit = Visit(self.arm(held.arm), (self.approach(T_world_flange), lift))
        taken = replace(stage, holder=held, widths={**stage.widths, held.arm: float(self.grasps.widths[held.grasp])})
        close = self.traffic.close_pairs(stage, frozenset({TOOL_FRAME}))
        posture = self.choose(
            stage,
            visit,
            branches,
            [self.traffic.hand(stage, held.arm, around=True), self.traffic.carrying(taken, close)],
        )
        stage, posture = self.arrive(stage, visit, posture, SegmentKind.TRANSIT)
        stage = self.straight(stage, visit, 0, posture, SegmentKind.APPROACH)
        stage = self.gripped(stage, held)
        return self.straight(stage, visit, 1, posture, SegmentKind.TRANSFER, close)

    def suck(self, stage: ToolStage, name: str, T_object_tool: Transform, branches: int) -> ToolStage:
        """Bring the tool onto an object along the facet's normal, and lift both straight up."""
        carry, held = self.settings.carry, _held(stage)
        stage = self.parked(stage, self.workcell.other(held.arm))
        T_world_tool = stage.T_world_objects[name] @ T_object_tool
        T_world_flange = T_world_tool @ self.traffic.T_tool_flange(held)
        normal = T_world_tool[:3, 2]
        above = StraightLeg(_moved(T_world_flange, carry.descent * normal), -carry.descent * normal)
        visit = Visit(self.arm(held.arm), (above, StraightLeg(T_world_flange, carry.lift * _UP)))
        sucked = SuckedObject(name, inverse(T_object_tool))
        bare = replace(stage, T_world_tool=T_world_tool)
        laden = replace(bare, sucked=sucked)
        cup = self.traffic.close_pairs(bare, frozenset({TOOL_FRAME}))
        rest = self.traffic.close_pairs(laden, frozenset({TOOL_FRAME, name}))
        postures = self.choose(
            stage, visit, branches, [self.traffic.carrying(bare, cup), self.traffic.carrying(laden, rest)]
        )
        stage, posture = self.arrive(stage, visit, postures, SegmentKind.TRANSFER)
        stage = self.straight(stage, visit, 0, posture, SegmentKind.TRANSFER, cup)
        stage = self._vacuum(replace(stage, sucked=sucked), SegmentKind.ATTACH)
        return self.straight(stage, visit, 1, posture, SegmentKind.TRANSFER, rest)

    def put_down(self, stage: ToolStage, T_world_goal: Transform, branches: int) -> ToolStage:
        """Bring tool and object over the goal, lower them, let go, and take the tool off along the facet's normal."""
        carry, held, sucked = self.settings.carry, _held(stage), stage.sucked
        assert sucked is not None
        name = sucked.name
        stage = self.parked(stage, self.workcell.other(held.arm))
        T_world_tool = T_world_goal @ inverse(sucked.T_tool_object)
        T_world_flange = T_world_tool @ self.traffic.T_tool_flange(held)
        lowered = StraightLeg(_moved(T_world_flange, carry.lift * _UP), -carry.lift * _UP)
        leaving = StraightLeg(T_world_flange, carry.descent * T_world_tool[:3, 2])
        visit = Visit(self.arm(held.arm), (lowered, leaving))
        laden = replace(stage, T_world_tool=T_world_tool, T_world_objects={**stage.T_world_objects, name: T_world_goal})
        bare = replace(laden, sucked=None)
        rest = self.traffic.close_pairs(laden, frozenset({TOOL_FRAME, name}))
        cup = self.traffic.close_pairs(bare, frozenset({TOOL_FRAME}))
        postures = self.choose(
            stage, visit, branches, [self.traffic.carrying(laden, rest), self.traffic.carrying(bare, cup)]
        )
        stage, posture = self.arrive(stage, visit, postures, SegmentKind.TRANSFER)
        stage = self.straight(stage, visit, 0, posture, SegmentKind.TRANSFER, rest)
        stage = replace(self._vacuum(stage, SegmentKind.DETACH), sucked=None)
        return self.straight(stage, visit, 1, posture, SegmentKind.TRANSFER, cup)

    def hand_over(self, stage: ToolStage, receiver: HeldGrasp, places: Sequence[HandoverPlace]) -> ToolStage:
        """Bring the tool to a handover place, let the other arm take it there, and park the arm that gave it.

        Places are tried in the order given until the budget of motions is spent.
        """
        stage = self.parked(stage, receiver.arm)
        reasons: Counter[Rejection] = Counter()
        moved = 0
        for place in places:
            if moved >= self.settings.orientations:
                break
            try:
                exchange = _Exchange(self, stage, receiver, place)
                moved += 1
                return exchange.realise()
            except Stuck as stuck:
                reasons[stuck.rejection] += 1
        raise Stuck(_commonest(reasons, Rejection("handover", "no place is known for the two grasps")))

    def parked(self, stage: ToolStage, arm: str) -> ToolStage:
        """Bring an arm that holds nothing to where it is out of the way."""
        goal = self._park[arm]
        if np.array_equal(stage.q[self.workcell.joints(arm)], goal):
            return stage
        query = self.traffic.hand(stage, arm)
        return self._free(stage, self.arm(arm), goal[None], query, SegmentKind.TRANSIT)[0]

    # Motion.

    def choose(self, stage: ToolStage, visit: Visit, branches: int, queries: Sequence[CollisionQuery]) -> list[Posture]:
        """Return the postures of a visit that pass all its legs, each by its own query, free of collision.

        Raises:
            Stuck: there is none; says what most of them would touch.
        """
        carry, joints = self.settings.carry, self.workcell.joints(visit.arm.name)
        reasons: Counter[Rejection] = Counter()
        free: list[Posture] = []
        for posture in visit.postures(branches, carry.step, carry.continuity):
            for way, query in zip(posture.ways, queries, strict=True):
                touch = self.touch(query, _columns(stage.q, joints, way))
                if touch is not None:
                    reasons[Rejection("reach", f"{touch} on a straight way")] += 1
                    break
            else:
                free.append(posture)
        if not free:
            raise Stuck(
                _commonest(reasons, Rejection("reach", f"the {visit.arm.name} arm cannot follow a straight way"))
            )
        return free

    def arrive(
        self, stage: ToolStage, visit: Visit, postures: Sequence[Posture], kind: SegmentKind
    ) -> tuple[ToolStage, Posture]:
        """Move an arm through free space to where one of the postures begins its visit; return which, and its turns."""
        arm = visit.arm
        turned = [
            posture.turned(turns)
            for posture in postures
            for turns in posture.windings(arm.position_min, arm.position_max)
        ]
        if not turned:
            raise Stuck(Rejection("reach", f"no turn of the {arm.name} arm's joints keeps them within their limits"))
        query = self.traffic.carrying(stage) if kind is SegmentKind.TRANSFER else self.traffic.hand(stage, arm.name)
        stage, chosen = self._free(stage, arm, np.array([posture.start for posture in turned]), query, kind)
        return stage, turned[chosen]

    def straight(
        self,
        stage: ToolStage,
        visit: Visit,
        leg: int,
        posture: Posture,
        kind: SegmentKind,
        close: Mapping[NamePair, float] | None = None,
    ) -> ToolStage:
        """Move along a leg of a visit; `close` names pairs that may come closer than the usual margin [m]."""
        length = visit.legs[leg].length
        pace, share = self.settings.pace, self.settings.carry.executed_share
        laden = stage.sucked is not None
        speed = pace.carried_speed if laden else pace.straight_speed
        acceleration = pace.carried_acceleration if laden else pace.straight_acceleration
        path = CurvePath(lambda s: visit.exact(leg, s / length, posture), length)
        moved = self._moving(stage, visit.arm, kind, path, (RateLimit(np.ones_like, speed, acceleration),))
        if kind is SegmentKind.TRANSFER:
            query = self.traffic.carrying(stage, close, share=share)
        else:
            query = self.traffic.hand(stage, visit.arm.name, around=True, share=share)
        touch = self.touch(query, moved.segments[-1].trajectory.positions)
        if touch is not None:
            raise Stuck(Rejection("transit", f"{touch} on a straight way"))
        return moved

    def _free(
        self, stage: ToolStage, arm: Arm, goals: Array, query: CollisionQuery, kind: SegmentKind
    ) -> tuple[ToolStage, int]:
        """Move one arm through free space to one of the goals (k, 6); return which."""
        joints = self.workcell.joints(arm.name)
        start = stage.q[joints].copy()
        checker: EdgeChecker = ArmEdgeChecker(query, stage.q.copy(), joints)
        if kind is SegmentKind.TRANSFER and stage.sucked is not None:
            checker = self._level(stage, arm, checker, np.vstack([start, goals]))
        self.motion_queries += 1
        result = plan_motion(
            MotionQuery(start, goals, arm.position_min, arm.position_max, checker, arm.velocity_max),
            self.settings.motion,
            self.rng,
        )
        if result.path is None or result.goal_index is None:
            raise Stuck(self._no_motion(stage, arm, goals, query, result.outcome))
        path = BlendedPath.through(result.path, checker)
        rates: tuple[RateLimit, ...] = ()
        if kind is SegmentKind.TRANSFER:
            rates = carried_rates(path, arm, slice(0, 6), self._centres(stage), self.settings.carried)
        return self._moving(stage, arm, kind, path, rates), result.goal_index

    def _level(self, stage: ToolStage, arm: Arm, checker: EdgeChecker, ends: Array) -> EdgeChecker:
        """Keep the tool about upright over the object, as far as `ends` (k, 6) of the motion are [rad]."""
        T_flange_tool = inverse(self.traffic.T_tool_flange(_held(stage)))
        poses = flange_poses(arm.dh, arm.T_world_base, np.ascontiguousarray(ends))
        sucked = stage.sucked
        assert sucked is not None
        least = min(math.cos(self.settings.carried_tilt), float((poses[:, 2, :3] @ T_flange_tool[:3, 2]).min()) - 1e-9)
        return LevelChecker(checker, arm, T_flange_tool, least, lambda tools: bool(self.hanging(sucked, tools).all()))

    def hanging(self, sucked: SuckedObject, T_world_tools: Array) -> NDArray[np.bool_]:
        """Say at which poses of the tool (n, 4, 4) the cup can hold an object at rest."""
        body = next(each for each in self.workcell.objects if each.name == sucked.name)
        assert body.mass is not None
        T_object_tool, cup = inverse(sucked.T_tool_object), self.workcell.tool.cup
        borne = cup_wrenches(weight(body.mass), T_world_tools @ sucked.T_tool_object, body.com, T_object_tool)
        return suction_margin(borne, cup) >= 0.0

    def _no_motion(
        self, stage: ToolStage, arm: Arm, goals: Array, query: CollisionQuery, outcome: MotionOutcome
    ) -> Rejection:
        ends = {MotionOutcome.START_IN_COLLISION: stage.q[None]}
        ends[MotionOutcome.GOALS_IN_COLLISION] = _columns(stage.q, self.workcell.joints(arm.name), goals)
        touch = self.touch(query, ends[outcome][:1]) if outcome in ends else None
        detail = "" if touch is None else f" ({touch})"
        return Rejection("transit", f"free motion of the {arm.name} arm: {outcome.value}{detail}")

    def touch(self, query: CollisionQuery, Q: Array) -> str | None:
        """Say which bodies would touch along the polyline through Q (n, 12); None where it is free."""
        found = query.path(Q) if len(Q) > 1 else None
        pair = int(query.first_collision(Q)[0]) if found is None else found.pair
        return None if pair < 0 else "{} and {} would touch".format(*query.pair_names(pair))

    def _moving(
        self, stage: ToolStage, arm: Arm, kind: SegmentKind, path: JointPath, rates: Sequence[RateLimit]
    ) -> ToolStage:
        """Append a motion of one arm along a path of its six joints, slow enough for cup and fingers to hold."""
        if path.length == 0.0:
            return stage
        joints, slowness = self.workcell.joints(arm.name), 1.0
        for _ in range(SLOWINGS):
            limits = JointLimits(arm.velocity_max / slowness, arm.acceleration_max / slowness**2)
            slower = [RateLimit(r.rate, r.velocity / slowness, r.acceleration / slowness**2) for r in rates]
            try:
                trajectory = _of_both(time_path(path, limits, self.settings.timing, slower), stage.q, joints)
            except TimingError as error:
                raise Stuck(Rejection("transit", f"{arm.name} arm: {error}")) from error
            moved = self._appended(stage, kind, (arm.name,), trajectory)
            if kind is not SegmentKind.TRANSFER:
                return moved
            stretch = self.statics.stretch(moved.segments[-1], stage.places, self.settings.hold_reserve)
            if stretch is None:
                raise Stuck(self._gives_way(moved, stage))
            if stretch <= 1.0:
                return moved
            slowness *= SLOWER * stretch
        raise Stuck(Rejection("hold", "no motion slow enough for cup and fingers was found"))

    def _gives_way(self, moved: ToolStage, stage: ToolStage) -> Rejection:
        rejection = self.statics.worst(moved.segments[-1], stage.places).rejection
        return rejection or Rejection("hold", "cup or fingers do not hold with the reserve asked for")

    # At rest.

    def shaped(self, stage: ToolStage, held: HeldGrasp) -> ToolStage:
        """Open an empty hand as wide as a grasp wants it on the way to the tool."""
        width = float(self.grasps.open_widths[held.grasp])
        if stage.widths[held.arm] == width:
            return stage
        shaped = self._still(stage, SegmentKind.TRANSIT, self.settings.pace.finger_time, {held.arm: width})
        touch = self.touch(self.traffic.hand(shaped, held.arm), shaped.q[None])
        if touch is not None:
            raise Stuck(Rejection("transit", f"{touch} while the {held.arm} hand opens"))
        return shaped

    def gripped(self, stage: ToolStage, held: HeldGrasp) -> ToolStage:
        """Close a hand on the tool; it holds it alone, or together with the hand that gives it."""
        holds = [held] if stage.holder is None else [held, stage.holder]
        width = {held.arm: float(self.grasps.widths[held.grasp])}
        stage = self._still(stage, SegmentKind.GRIP, self.settings.pace.finger_time, width, holds)
        return replace(stage, holder=stage.holder or held)

    def released(self, stage: ToolStage, receiver: HeldGrasp) -> ToolStage:
        """Hold the tool in both hands for a moment, then open the one that gives it."""
        giver = _held(stage)
        pace = self.settings.pace
        stage = self._still(stage, SegmentKind.HANDOVER, pace.handover_time, {}, [giver, receiver])
        width = {giver.arm: float(self.grasps.open_widths[giver.grasp])}
        stage = self._still(stage, SegmentKind.RELEASE, pace.finger_time, width, [giver, receiver])
        return replace(stage, holder=receiver)

    def _vacuum(self, stage: ToolStage, kind: SegmentKind) -> ToolStage:
        """Turn the vacuum on or off; the object stands while that lasts."""
        after = self._still(stage, kind, self.settings.pace.vacuum_time, {})
        rejection = self.statics.worst(after.segments[-1], stage.places).rejection
        if rejection is not None:
            raise Stuck(rejection)
        return after

    def _still(
        self,
        stage: ToolStage,
        kind: SegmentKind,
        duration: float,
        widths: Mapping[str, float],
        holds: Iterable[HeldGrasp] | None = None,
    ) -> ToolStage:
        trajectory = hold_still(stage.q, duration, self.settings.timing.sample_step)
        return self._appended(stage, kind, (), trajectory, widths, holds)

    # Bookkeeping.

    def _appended(
        self,
        stage: ToolStage,
        kind: SegmentKind,
        movers: tuple[str, ...],
        trajectory: Trajectory,
        widths: Mapping[str, float] | None = None,
        holds: Iterable[HeldGrasp] | None = None,
    ) -> ToolStage:
        """Append a segment; `widths` are openings at its end [m], `holds` the hands on the tool, if not the holder."""
        after = {**stage.widths, **(widths or {})}
        if holds is None:
            holds = [] if stage.holder is None else [stage.holder]
        body_poses = self._body_poses(stage, trajectory) if kind is SegmentKind.TRANSFER else {}
        segment = ToolSegment(
            kind=kind,
            movers=movers,
            trajectory=trajectory,
            widths={arm: _ramp(trajectory.time, stage.widths[arm], after[arm]) for arm in after},
            holds=tuple(self.hold(held) for held in holds),
            sucked=stage.sucked,
            body_poses=body_poses,
        )
        ends = {name: poses[-1] for name, poses in body_poses.items()}
        return replace(
            stage,
            q=trajectory.positions[-1].copy(),
            widths=after,
            T_world_tool=ends.pop(TOOL_FRAME, stage.T_world_tool),
            T_world_objects={**stage.T_world_objects, **ends},
            segments=(*stage.segments, segment),
        )

    def _body_poses(self, stage: ToolStage, trajectory: Trajectory) -> dict[str, Array]:
        held = _held(stage)
        arm = self.arm(held.arm)
        Q = np.ascontiguousarray(trajectory.positions[:, self.workcell.joints(held.arm)])
        tool = flange_poses(arm.dh, arm.T_world_base, Q) @ inverse(self.traffic.T_tool_flange(held))
        poses = {TOOL_FRAME: tool}
        if stage.sucked is not None:
            poses[stage.sucked.name] = tool @ stage.sucked.T_tool_object
        return poses

    def hold(self, held: HeldGrasp) -> ToolHold:
        """Return a grasp as segments name it."""
        return ToolHold(
            arm=held.arm,
            T_tool_tcp=self.grasps.T_tool_tcp[held.grasp],
            width=float(self.grasps.widths[held.grasp]),
            T_flange_tool=inverse(self.traffic.T_tool_flange(held)),
        )

    def approach(self, T_world_flange: Transform) -> StraightLeg:
        """Return the way of a hand along its own z to where it grips."""
        back = self.settings.carry.approach * T_world_flange[:3, 2]
        return StraightLeg(_moved(T_world_flange, -back), back)

    def retreat(self, T_world_flange: Transform) -> StraightLeg:
        """Return the way of a hand along its own z off the tool."""
        return StraightLeg(T_world_flange, -self.settings.carry.approach * T_world_flange[:3, 2])

    def arm(self, name: str) -> Arm:
        """Return an arm by name."""
        return self.workcell.arm(name)

    def _centres(self, stage: ToolStage) -> Array:
        """Return the centres of mass of what is carried, in the flange frame of the arm that holds (k, 3) [m]."""
        centres = [self.workcell.tool.com]
        if stage.sucked is not None:
            body = next(body for body in self.workcell.objects if body.name == stage.sucked.name)
            centres.append(_point(stage.sucked.T_tool_object, body.com))
        T_flange_tool = inverse(self.traffic.T_tool_flange(_held(stage)))
        return np.array([_point(T_flange_tool, centre) for centre in centres])


class _Exchange:
    """The tool changes hands at one place: which postures of both arms go together there, and the motion."""

    def __init__(self, plan: ToolChoreographer, stage: ToolStage, receiver: HeldGrasp, place: HandoverPlace) -> None:
        """Find the postures.

        Raises:
            Stuck: no two postures go together.
        """
        giver = _held(stage)
        self.plan, self.stage, self.giver, self.receiver = plan, stage, giver, receiver
        traffic, T = plan.traffic, place.T_world_tool
        self.give = Visit(plan.arm(giver.arm), (plan.retreat(T @ traffic.T_tool_flange(giver)),))
        self.take = Visit(plan.arm(receiver.arm), (plan.approach(T @ traffic.T_tool_flange(receiver)),))
        grasps = plan.grasps
        opened = {giver.arm: float(grasps.open_widths[giver.grasp])}
        opened[receiver.arm] = float(grasps.open_widths[receiver.grasp])
        closed = {giver.arm: float(grasps.widths[giver.grasp]), receiver.arm: float(grasps.widths[receiver.grasp])}
        at_place = replace(stage, T_world_tool=T)
        coming = replace(at_place, widths={**closed, receiver.arm: opened[receiver.arm]})
        both = replace(at_place, widths=closed)
        leaving = replace(at_place, widths={**closed, giver.arm: opened[giver.arm]}, holder=receiver)
        self.pairs = self._pairs(
            place,
            traffic.hand(coming, receiver.arm, around=True),
            traffic.everything(both, [giver.arm, receiver.arm]),
            traffic.hand(leaving, giver.arm, around=True),
        )

    def realise(self) -> ToolStage:
        """Plan all motion of the exchange.

        Raises:
            Stuck: some of it was not found.
        """
        plan = self.plan
        givers = list(dict.fromkeys(giver for giver, _ in self.pairs))
        stage, giving = plan.arrive(self.stage, self.give, givers, SegmentKind.TRANSFER)
        stage = plan.shaped(stage, self.receiver)
        takers = [taker for giver, taker in self.pairs if giver.branch == giving.branch]
        stage, taking = plan.arrive(stage, self.take, takers, SegmentKind.TRANSIT)
        stage = plan.straight(stage, self.take, 0, taking, SegmentKind.APPROACH)
        stage = plan.gripped(stage, self.receiver)
        stage = plan.released(stage, self.receiver)
        stage = plan.straight(stage, self.give, 0, giving, SegmentKind.RETREAT)
        return plan.parked(stage, self.giver.arm)

    def _pairs(
        self, place: HandoverPlace, coming: CollisionQuery, both: CollisionQuery, leaving: CollisionQuery
    ) -> list[tuple[Posture, Posture]]:
        """Return the pairs of postures with which the receiver can come, both can hold, and the giver can leave."""
        carry, cell = self.plan.settings.carry, self.plan.workcell
        givers = list(self.give.postures(place.giver, carry.step, carry.continuity))
        takers = list(self.take.postures(place.receiver, carry.step, carry.continuity))
        if not givers or not takers:
            raise Stuck(Rejection("handover", "an arm cannot follow the straight way to the tool or off it"))
        reasons: Counter[Rejection] = Counter()
        pairs = []
        for giver in givers:
            for taker in takers:
                q = _columns(self.stage.q, cell.joints(self.giver.arm), giver.start[None])[0]
                come = _columns(q, cell.joints(self.receiver.arm), taker.ways[0])
                leave = _columns(come[-1], cell.joints(self.giver.arm), giver.ways[0])
                ways = ((both, come[-1:]), (coming, come), (leaving, leave))
                touches = (self.plan.touch(query, Q) for query, Q in ways)
                touch = next((each for each in touches if each is not None), None)
                if touch is None:
                    pairs.append((giver, taker))
                else:
                    reasons[Rejection("handover", f"{touch} while the tool changes hands")] += 1
        if not pairs:
            raise Stuck(_commonest(reasons, Rejection("handover", "no two postures go together")))
        return pairs


def _held(stage: ToolStage) -> HeldGrasp:
    assert stage.holder is not None, "the tool is held in this step"
    return stage.holder


def _commonest(reasons: Counter[Rejection], otherwise: Rejection) -> Rejection:
    return max(reasons, key=reasons.__getitem__) if reasons else otherwise


def _moved(T: Transform, way: Array) -> Transform:
    moved = T.copy()
    moved[:3, 3] += way
    return moved


def _point(T: Transform, point: Array) -> Array:
    return T[:3, :3] @ point + T[:3, 3]


def _columns(q: Array, joints: slice, positions: Array) -> Array:
    """Put one arm's positions (n, 6) among all twelve; the other arm stays."""
    Q = np.repeat(q[None], len(positions), axis=0)
    Q[:, joints] = positions
    return Q


def _of_both(trajectory: Trajectory, q: Array, joints: slice) -> Trajectory:
    """Widen one arm's trajectory to all twelve joints."""
    count = len(trajectory.time)
    still = np.zeros((count, len(q)))
    return replace(
        trajectory,
        positions=_columns(q, joints, trajectory.positions),
        velocities=_columns(still[0], joints, trajectory.velocities),
        accelerations=_columns(still[0], joints, trajectory.accelerations),
    )


def _ramp(time: Array, start: float, end: float) -> Array:
    """Return openings (n,) that go smoothly from one to the other [m]."""
    if start == end:
        return np.full(len(time), start)
    widths = start + (0.5 - 0.5 * np.cos(np.pi * time / time[-1])) * (end - start)
    widths[-1] = end
    return widths
