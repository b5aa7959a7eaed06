"""Motion of one arm in a suction-tool plan: through free space and along straight ways, checked, timed, and held."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from planners.cell.arm import Arm
from planners.collision.model import CollisionQuery, NamePair
from planners.geometry.pose import Array, Transform, inverse
from planners.graph.rejections import Rejection
from planners.hands.arm_motion import FreeMotion, FreeMove, Stuck, among_all, of_both_arms, touching
from planners.kinematics.forward import flange_poses
from planners.motion.checker import EdgeChecker
from planners.motion.path import CurvePath, JointPath
from planners.motion.timing import JointLimits, RateLimit, TimingError, TimingSettings, time_path
from planners.motion.trajectory import Trajectory
from planners.plan.segment import SegmentKind
from planners.regrasp.motion.cartesian_path import CartesianPath, Onward, Posture, StraightLeg
from planners.regrasp.motion.scene_state import SceneState, SegmentWriter
from planners.regrasp.motion.state_queries import StateQueries
from planners.regrasp.motion.travel_time import carried_rates, least_travel_time, straight_times
from planners.regrasp.motion.upright_postures import UprightPostures
from planners.regrasp.statics.hold_statics import HoldStatics
from planners.regrasp.statics.laden_arm import LadenArm, LadenChecker
from planners.regrasp.statics.static_hold import CarryingHand, StaticHold
from planners.regrasp.tool_settings import ToolPlannerSettings

SLOWER = 1.05
"""A motion that cup or fingers do not hold is slowed by this much more than it need be: its timing changes too."""
SLOWINGS = 5
"""How often a motion is slowed before it is given up."""
TOUCH = "{} and {} would touch"
"""What is said of two bodies."""


class ToolMotion:
    """Plans motions of one arm from state to state, or raises `Stuck`."""

    def __init__(
        self,
        queries: StateQueries,
        writer: SegmentWriter,
        statics: HoldStatics,
        park: Mapping[str, Array],
        settings: ToolPlannerSettings,
        rng: np.random.Generator,
    ) -> None:
        """Take what all motions share.

        Args:
            queries: collision queries.
            writer: of segments.
            statics: whether cup and fingers hold.
            park: (6,) where each arm stands while the other moves [rad].
            settings: distances, paces and budgets.
            rng: of the searches.
        """
        self.queries, self.writer, self.statics = queries, writer, statics
        self.settings, self.workcell = settings, queries.workcell
        self.static_hold = StaticHold(statics.scene, settings.finger_reserve)
        self.free = FreeMotion(settings.motion, rng, touch=TOUCH)
        self._park = park

    def parked(self, state: SceneState, arm: str) -> SceneState:
        """Bring an arm that holds nothing to where it is out of the way."""
        goal = self._park[arm]
        if np.array_equal(state.q[self.workcell.joints(arm)], goal):
            return state
        query = self.queries.hand(state, arm)
        return self._free(state, self.arm(arm), goal[None], query, SegmentKind.TRANSIT)[0]

    def home(self, arm: str) -> Onward:
        """Return where an arm is out of the way, as the place it goes to next: as good a guess as any."""
        return Onward(self._park[arm][None])

    def choose(
        self, state: SceneState, cartesian: CartesianPath, branches: int, on_legs: Sequence[CollisionQuery]
    ) -> list[Posture]:
        """Return the postures of a Cartesian path that pass all its legs, each by its own query, free of collision.

        Raises:
            Stuck: there is none; says what most of them would touch.
        """
        carry, joints = self.settings.carry, self.workcell.joints(cartesian.arm.name)
        reasons: Counter[Rejection] = Counter()
        free: list[Posture] = []
        for posture in cartesian.postures(branches, carry.step, carry.continuity):
            for way, query in zip(posture.ways, on_legs, strict=True):
                touch = self.touch(query, among_all(state.q, joints, way))
                if touch is not None:
                    reasons[Rejection("reach", f"{touch} on a straight way")] += 1
                    break
            else:
                free.append(posture)
        if not free:
            raise Stuck(
                commonest(reasons, Rejection("reach", f"the {cartesian.arm.name} arm cannot follow a straight way"))
            )
        return free

    def arrive(
        self,
        state: SceneState,
        cartesian: CartesianPath,
        postures: Sequence[Posture],
        kind: SegmentKind,
        onward: Onward,
        close: Mapping[NamePair, float] | None = None,
    ) -> tuple[SceneState, Posture]:
        """Move an arm through free space to where one of the postures begins; return which, and its turns.

        Those with the shortest way there, and onward from the end of the Cartesian path, come first. What is carried
        may stay close to what it stands beside already, and come close to the pairs of `close` [m].
        """
        arm = cartesian.arm
        turned = [
            posture.turned(turns)
            for posture in postures
            for turns in posture.windings(arm.position_min, arm.position_max)
        ]
        if not turned:
            raise Stuck(Rejection("reach", f"no turn of the {arm.name} arm's joints keeps them within their limits"))
        if kind is SegmentKind.TRANSFER:
            beside = self.queries.close_pairs(state, state.carried)
            query = self.queries.carrying(state, {**beside, **(close or {})})
        else:
            query = self.queries.hand(state, arm.name)
        starts = np.array([posture.start for posture in turned])
        ends = np.array([posture.end for posture in turned])
        costs = self._times(state, arm, starts, kind) + self._onward_times(arm, ends, onward)
        state, chosen = self._free(state, arm, starts, query, kind, costs)
        return state, turned[chosen]

    def straight(
        self,
        state: SceneState,
        cartesian: CartesianPath,
        leg: int,
        posture: Posture,
        kind: SegmentKind,
        close: Mapping[NamePair, float] | None = None,
    ) -> SceneState:
        """Move along a leg of a Cartesian path; `close` names pairs that may come closer than the usual margin [m]."""
        length = cartesian.legs[leg].length
        pace, share = self.settings.pace, self.workcell.settings.executed_share
        laden = state.sucked is not None
        speed = pace.carried_speed if laden else pace.straight_speed
        acceleration = pace.carried_acceleration if laden else pace.straight_acceleration
        path = CurvePath(lambda s: cartesian.exact(leg, s / length, posture), length)
        rates = (RateLimit(np.ones_like, speed, acceleration),)
        moved = self._moving(state, cartesian.arm, kind, path, rates, self.settings.timing)
        if kind is SegmentKind.TRANSFER:
            query = self.queries.carrying(state, close, share=share)
        else:
            query = self.queries.hand(state, cartesian.arm.name, around=True, share=share)
        touch = self.touch(query, moved.segments[-1].trajectory.positions)
        if touch is not None:
            raise Stuck(Rejection("transit", f"{touch} on a straight way"))
        return moved

    def _times(self, state: SceneState, arm: Arm, goals: Array, kind: SegmentKind) -> Array:
        """Return how long (k,) an arm takes straight to goals (k, 6), if nothing is in the way [s]."""
        T_tool_flange = self.queries.T_tool_flange(state.held) if kind is SegmentKind.TRANSFER else None
        return straight_times(arm, state.q[self.workcell.joints(arm.name)], goals, T_tool_flange, self.settings.carried)

    def _onward_times(self, arm: Arm, ends: Array, onward: Onward) -> Array:
        """Return how long (k,) an arm takes from ends (k, 6) of a Cartesian path to the nearest place onward [s]."""
        if not len(onward.positions):
            return np.zeros(len(ends))
        there = np.repeat(onward.positions[None], len(ends), axis=0)
        if onward.held is None:
            return least_travel_time(arm, ends[:, None], there)
        flanges = np.repeat(self.queries.T_tool_flange(onward.held)[None], len(ends), axis=0)
        return least_travel_time(arm, ends[:, None], there, flanges, self.settings.carried)

    def _free(
        self,
        state: SceneState,
        arm: Arm,
        goals: Array,
        query: CollisionQuery,
        kind: SegmentKind,
        costs: Array | None = None,
    ) -> tuple[SceneState, int]:
        """Move one arm through free space to one of the goals (k, 6), those of least cost (k,) first; return which."""
        joints = self.workcell.joints(arm.name)
        move = FreeMove(f"{arm.name} arm", arm, joints, state.q, goals, query, costs)
        checker: EdgeChecker = move.checker()
        if kind is SegmentKind.TRANSFER:
            checker = self._laden_checker(state, arm, checker, np.vstack([move.start, goals]))
            if state.sucked is not None:
                move = replace(move, source=UprightPostures(arm, checker.hand.T_flange_tool, checker.least_cosine))
        path, chosen = self.free.find(move, checker)
        rates, timing = tuple[RateLimit, ...](), self.settings.timing
        if kind is SegmentKind.TRANSFER:
            pace = self.settings.carried
            rates = carried_rates(path, arm, slice(0, 6), self._centres(state), pace)
            timing = replace(timing, sample_step=pace.sample_step)
        return self._moving(state, arm, kind, path, rates, timing), chosen

    def _laden_checker(self, state: SceneState, arm: Arm, checker: EdgeChecker, ends: Array) -> LadenChecker:
        """Keep what is carried borne; under the tool an object about level, as far as `ends` (k, 6) are [rad].

        The joints' torques at rest stay within what postures may use, or as far as the ends use more.
        """
        held = state.held
        T_flange_tool = inverse(self.queries.T_tool_flange(held))
        least = -1.0
        if state.sucked is not None:
            poses = flange_poses(arm.dh, arm.T_world_base, np.ascontiguousarray(ends))
            level = float((poses[:, 2, :3] @ T_flange_tool[:3, 2]).min()) - 1e-9
            least = min(math.cos(self.settings.carried_tilt), level)
        hold, load = self.writer.hold(held), self.static_hold.load(state.sucked)
        hand = CarryingHand(arm, hold.T_flange_tool, hold.T_tool_tcp, hold.width, load)
        laden = self._laden(state, arm, SegmentKind.TRANSFER)
        most = max(1.0 - self.settings.torque.posture_reserve, *(laden.share(end) for end in ends))
        return LadenChecker(checker, hand, least - 1e-9, laden, most + 1e-9)

    def _laden(self, state: SceneState, arm: Arm, kind: SegmentKind) -> LadenArm:
        """Return an arm with what it carries in a motion of a kind: tool and object in a transfer, else nothing."""
        gravity = self.workcell.cell.gravity
        if kind is not SegmentKind.TRANSFER:
            return LadenArm.of(arm, gravity)
        return LadenArm.of(
            arm, gravity, self.writer.hold(state.held).T_flange_tool, self.static_hold.load(state.sucked)
        )

    def touch(self, query: CollisionQuery, Q: Array) -> str | None:
        """Say which bodies would touch along the polyline through Q (n, 12); None where it is free."""
        names = touching(query, Q)
        return None if names is None else TOUCH.format(*names)

    def _moving(
        self,
        state: SceneState,
        arm: Arm,
        kind: SegmentKind,
        path: JointPath,
        rates: Sequence[RateLimit],
        timing: TimingSettings,
    ) -> SceneState:
        """Append a motion of one arm along a path of its six joints, slow enough for joints, cup and fingers."""
        if path.length == 0.0:
            return state
        joints, slowness = self.workcell.joints(arm.name), 1.0
        laden, borne = self._laden(state, arm, kind), None
        for _ in range(SLOWINGS):
            limits = JointLimits(arm.velocity_max / slowness, arm.acceleration_max / slowness**2)
            slower = [
                replace(r, velocity=r.velocity / slowness, acceleration=r.acceleration / slowness**2)
                for r in (*rates, *(borne or ()))
            ]
            try:
                timed = time_path(path, limits, timing, slower)
            except TimingError as error:
                raise Stuck(Rejection("transit", f"{arm.name} arm: {error}")) from error
            trajectory = of_both_arms(timed, state.q, joints)
            moved = self.writer.appended(state, kind, (arm.name,), trajectory)
            stretch = laden.stretch(trajectory, joints, self.settings.torque.motion_reserve, kind.value)
            if isinstance(stretch, Rejection):
                raise Stuck(stretch)
            if kind is SegmentKind.TRANSFER:
                held = self.statics.stretch(moved.segments[-1], state.places)
                if held is None:
                    rejection = self.statics.worst(moved.segments[-1], state.places).rejection
                    assert rejection is not None
                    raise Stuck(rejection)
                if held > 1.0 and borne is None:
                    borne = self._borne(state, arm, path, timed)
                    continue
                stretch = max(stretch, held)
            if stretch <= 1.0:
                return moved
            slowness *= SLOWER * stretch
        raise Stuck(Rejection("hold", "no motion slow enough for joints, cup and fingers was found"))

    def _borne(self, state: SceneState, arm: Arm, path: JointPath, timed: Trajectory) -> tuple[RateLimit, ...]:
        """Return what makes a motion of one arm along a path so slow, where it must be, that cup and fingers hold.

        Where the tool hangs askew fingers bear little inertia, elsewhere much: a motion that is slowed as a whole is as
        slow as in the worst place everywhere. `timed` is the motion that is too fast.
        """
        joints = self.workcell.joints(arm.name)
        s = np.unique(np.concatenate([path.grid(*ends) for ends in pairwise([0.0, *path.stops, path.length])]))
        points = path.evaluate(s)
        along = of_both_arms(Trajectory(s, points.positions, points.first, points.second, s), state.q, joints)
        segment = self.writer.appended(state, SegmentKind.TRANSFER, (arm.name,), along).segments[-1]
        speeds = np.diff(timed.path_parameter) / np.diff(timed.time)
        rates = np.diff(speeds) / np.diff(timed.time)[1:]
        borne = self.statics.borne_rates(segment, state.places, float(np.abs(rates).max()), float(speeds.max() ** 2))
        if borne is None:
            return ()
        turning = partial(_inverse_between, borne.parameter, borne.squared_speed)
        faster, slower = (partial(_inverse_between, borne.parameter, sign * borne.rate) for sign in (1.0, -1.0))
        return RateLimit(faster, np.inf, 1.0, turning), RateLimit(slower, np.inf, 1.0, turning)

    def approach(self, T_world_flange: Transform) -> StraightLeg:
        """Return the way of a hand along its own z to where it grips."""
        back = self.settings.carry.approach * T_world_flange[:3, 2]
        return StraightLeg(moved_by(T_world_flange, -back), back)

    def retreat(self, T_world_flange: Transform) -> StraightLeg:
        """Return the way of a hand along its own z off the tool."""
        return StraightLeg(T_world_flange, -self.settings.carry.approach * T_world_flange[:3, 2])

    def arm(self, name: str) -> Arm:
        """Return an arm by name."""
        return self.workcell.arm(name)

    def _centres(self, state: SceneState) -> Array:
        """Return the centres of mass of what is carried, in the flange frame of the arm that holds (k, 3) [m]."""
        centres = [self.workcell.tool.com]
        if state.sucked is not None:
            body = next(body for body in self.workcell.objects if body.name == state.sucked.name)
            centres.append(_point(state.sucked.T_tool_object, body.com))
        T_flange_tool = inverse(self.queries.T_tool_flange(state.held))
        return np.array([_point(T_flange_tool, centre) for centre in centres])


def commonest(reasons: Counter[Rejection], otherwise: Rejection) -> Rejection:
    """Return the reason that was counted most; `otherwise` where none was."""
    return max(reasons, key=reasons.__getitem__) if reasons else otherwise


def moved_by(T: Transform, way: Array) -> Transform:
    """Return a pose (4, 4) moved by (3,) in the world [m]."""
    moved = T.copy()
    moved[:3, 3] += way
    return moved


def _point(T: Transform, point: Array) -> Array:
    return T[:3, :3] @ point + T[:3, 3]


def _inverse_between(parameter: Array, values: Array, s: Array) -> Array:
    """Return one over values (k,) of parameters (k,), at (n,) of them."""
    return 1.0 / np.interp(s, parameter, values)
