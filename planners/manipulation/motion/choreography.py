"""From a path with postures to motion: every edge becomes planned, checked and timed segments."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from planners.balance.balanced import Balanced, Unbalanced
from planners.collision.model import CollisionQuery
from planners.collision.placement import Attached
from planners.geometry.pose import Array, Transform, inverse
from planners.graph.rejections import Rejection
from planners.kinematics.inverse import BRANCHES
from planners.manipulation.contacts.dense_contact_states import PlateMotion
from planners.manipulation.graph.failures import Hand
from planners.manipulation.motion.assignment import Assignment
from planners.manipulation.motion.manipulation_sequence import HoldPhase, ManipulationSequence
from planners.manipulation.motion.phase_track import PhaseTrack
from planners.manipulation.motion.posture_follower import PostureFollower
from planners.manipulation.reach.lift_workcell import LiftWorkcell
from planners.manipulation.statics.hold_balance import HandPair, HoldBalance
from planners.manipulation.statics.lift_torques import LiftTorques
from planners.motion.blended_path import BlendedPath
from planners.motion.checker import ArmEdgeChecker
from planners.motion.path import CurvePath, JointPath
from planners.motion.path_search import plan_motion
from planners.motion.query import MotionOutcome, MotionQuery, MotionResult, MotionSettings
from planners.motion.spacing import spaced, spent_on_the_way
from planners.motion.timing import JointLimits, RateLimit, TimingError, TimingSettings, time_path
from planners.motion.trajectory import Trajectory, hold_still
from planners.segment import ContactSet, GripHold, PushHold, Segment, SegmentKind


@dataclass(frozen=True)
class PaceSettings:
    """How fast a heavy plate and the hands next to it move. Balances are quasi-static, so plates move gently."""

    plate_speed: float = 0.10
    """Of the fastest corner [m/s]."""
    plate_acceleration: float = 0.10
    """Of the fastest corner along its way [m/s^2]: 1 % of the plate's weight."""
    approach_speed: float = 0.10
    """Of a hand on its last straight way [m/s]."""
    approach_acceleration: float = 0.5
    """[m/s^2]"""
    finger_time: float = 0.4
    """Time in which the fingers close or open [s]."""
    set_rotation: float = math.radians(1.9)
    """Largest turn of the plate between two contact sets [rad]: the document's rule is 2 degrees."""
    set_travel: float = 0.0095
    """Largest way of the centre of mass between two contact sets [m]: the document's rule is 10 mm."""
    set_pause: float = 0.24
    """Longest time between two contact sets while the plate rests [s]: the document's rule is 0.25 s."""


PERSISTENCE = 4
"""A search for a free motion that was exhausted is tried once more with this many times its iterations."""

Step = Literal["arrival", "departure", "parking", "transfer", "rest"]
"""What a path gets stuck at: a hand comes, goes, or is put out of the way; the plate moves, or rests."""


@dataclass(frozen=True)
class Stuck:
    """Why a path with these postures cannot be moved along."""

    rejection: Rejection
    step: Step
    hand: Hand | None
    """The hand that could not come, go or be parked; None for the plate."""
    place: int
    """On the path: of the node that has the hold of a hand that comes or goes; else of the edge that fails."""


@dataclass(eq=False)
class _Stage:
    """What has happened so far."""

    q: Array
    T_world_plate: Transform
    pose: int
    edge: int = 0
    """Of the path, that is being realised."""
    holding: dict[Hand, HoldPhase] = field(default_factory=dict)
    loose: list[Hand] = field(default_factory=list)
    segments: list[Segment] = field(default_factory=list)


class Choreographer:
    """Plans the motion of whole paths for one plate lift."""

    def __init__(
        self,
        workcell: LiftWorkcell,
        follower: PostureFollower,
        balance: HoldBalance,
        rng: np.random.Generator,
        motion: MotionSettings | None = None,
        pace: PaceSettings | None = None,
        timing: TimingSettings | None = None,
    ) -> None:
        self.workcell, self.follower, self.balance, self.rng = workcell, follower, balance, rng
        self.motion_settings = motion or MotionSettings()
        self.pace = pace or PaceSettings()
        self.timing = timing or TimingSettings()
        arms = [workcell.arm(name) for name in ("left", "right")]
        self.limits = JointLimits(
            np.concatenate([arm.velocity_max for arm in arms]), np.concatenate([arm.acceleration_max for arm in arms])
        )
        self.torques = LiftTorques(workcell)
        self.motion_queries = 0

    def realise(self, sequence: ManipulationSequence, assignment: Assignment) -> tuple[Segment, ...] | Stuck:
        """Plan all motion of a path, or say where it got stuck."""
        run = _Run(self, sequence, assignment)
        return run.realise()

    def arm_of(self, hand: Hand) -> str:
        """Return the arm that has a hand."""
        return self.workcell.gripper if hand == "grip" else self.workcell.pusher


class _Run:
    """One attempt to realise one path with one choice of postures."""

    def __init__(self, choreographer: Choreographer, sequence: ManipulationSequence, assignment: Assignment) -> None:
        self.plan, self.sequence, self.assignment = choreographer, sequence, assignment
        self.workcell, self.follower = choreographer.workcell, choreographer.follower
        start = choreographer.workcell.scene.start_positions
        pose = sequence.poses[0]
        self.stage = _Stage(start.copy(), self.follower.poses.poses[pose].T_world_plate, pose)
        self.tracks: dict[HoldPhase, PhaseTrack] = {}

    def realise(self) -> tuple[Segment, ...] | Stuck:
        for phase in self.sequence.phases:
            self.tracks[phase] = PhaseTrack.of(self.follower, self.sequence, phase, self.assignment[phase])
        try:
            for phase in self._changing(lambda e: e.first == 0):
                self._arrive(phase)
            for place, step in enumerate(self.sequence.motions):
                self.stage.edge = place
                if step is not None:
                    self._park_loose_arms()
                    self._transfer(place, *step)
                    continue
                for phase in self._changing(lambda e, here=place: e.goes and e.last == here):
                    self._leave(phase)
                for phase in self._changing(lambda e, here=place: e.first == here + 1):
                    self._arrive(phase)
            self._end_in_hold()
        except _GotStuck as error:
            return error.stuck
        return tuple(self.stage.segments)

    def _end_in_hold(self) -> None:
        """Let a plan end with both hands on the plate, also where the last of them came when it was in the air."""
        if self.stage.segments[-1].kind is not SegmentKind.TRANSFER:
            still = hold_still(self.stage.q, self.plan.pace.finger_time, self.plan.timing.sample_step)
            self._add(SegmentKind.TRANSFER, (), still)

    def _changing(self, which: Callable[[HoldPhase], bool]) -> list[HoldPhase]:
        return sorted((e for e in self.sequence.phases if which(e)), key=lambda e: e.hand)

    # Hands come and go.

    def _arrive(self, phase: HoldPhase) -> None:
        """Bring a hand to the plate: free motion, straight approach, and for the gripper the closing of the fingers."""
        hand, arm = phase.hand, self.plan.arm_of(phase.hand)
        joints, track = self.workcell.joints(arm), self.tracks[phase]
        coming = _Errand("arrival", hand, phase.first)
        goals = track.windings(self.workcell.arm(arm).position_min, self.workcell.arm(arm).position_max)
        if not len(goals):
            raise coming.stuck("transit", "no turn of the joints keeps them within limits while it holds")
        # All windings look the same to collisions.
        self._refuse_touch(self._straight_query(arm), self._with_arm(arm, track.approach), coming, "the approach")
        chosen = self._free_motion(arm, track.approach[-1] + goals, coming)
        track.turn(goals[chosen])
        self._straight(arm, track, track.approach[::-1], SegmentKind.APPROACH, coming)
        self.stage.q[joints] = track.approach[0]
        if hand == "grip":
            self._fingers(arm, SegmentKind.GRIP)
        self.stage.holding[hand] = phase
        if hand in self.stage.loose:
            self.stage.loose.remove(hand)

    def _leave(self, phase: HoldPhase) -> None:
        """Take a hand off the plate; it is parked when the plate is next to move."""
        hand, arm = phase.hand, self.plan.arm_of(phase.hand)
        track = self.tracks[phase]
        del self.stage.holding[hand]
        if hand == "grip":
            self._fingers(arm, SegmentKind.RELEASE)
        self._straight(arm, track, track.retreat, SegmentKind.RETREAT, _Errand("departure", hand, phase.last))
        self.stage.loose.append(hand)

    def _park_loose_arms(self) -> None:
        """Bring arms that hold nothing back to where they started."""
        for hand in list(self.stage.loose):
            arm = self.plan.arm_of(hand)
            home = self.workcell.scene.start_positions[self.workcell.joints(arm)]
            self._free_motion(arm, home[None], _Errand("parking", hand, self.stage.edge))
            self.stage.loose.remove(hand)

    def _free_motion(self, arm: str, goals: Array, errand: _Errand) -> int:
        """Move one arm through free space to one of the goals; return which."""
        query = self.workcell.moving_arm_query(arm, self.stage.T_world_plate, self._holding_arms())
        joints = self.workcell.joints(arm)
        checker = ArmEdgeChecker(query, self.stage.q.copy(), joints)
        result = self._search(arm, goals, checker)
        if result.outcome is not MotionOutcome.FOUND or result.path is None or result.goal_index is None:
            detail = self._why(query, result.outcome, goals, arm)
            raise errand.stuck("transit", f"free motion of the {errand.hand} hand: {result.outcome.value}{detail}")
        path = BlendedPath.through(result.path, checker)
        limits = JointLimits(self.plan.limits.velocity[joints], self.plan.limits.acceleration[joints])
        self._add(SegmentKind.TRANSIT, (arm,), self._of_both(self._timed(path, limits, (), errand), joints))
        return result.goal_index

    def _search(self, arm: str, goals: Array, checker: ArmEdgeChecker) -> MotionResult:
        """Look for a free motion of one arm; where the search was exhausted, once more with more iterations."""
        data, settings = self.workcell.arm(arm), self.plan.motion_settings
        start = self.stage.q[self.workcell.joints(arm)].copy()
        query = MotionQuery(start, goals, data.position_min, data.position_max, checker, data.velocity_max)
        self.plan.motion_queries += 1
        result = plan_motion(query, settings, self.plan.rng)
        if result.outcome is MotionOutcome.ITERATIONS_EXHAUSTED:
            self.plan.motion_queries += 1
            patient = replace(settings, max_iterations=PERSISTENCE * settings.max_iterations)
            result = plan_motion(query, patient, self.plan.rng)
        return result

    def _timed(self, path: JointPath, limits: JointLimits, rates: tuple[RateLimit, ...], errand: _Errand) -> Trajectory:
        """Put time along a path; a branch of the inverse kinematics may end or turn over between its samples."""
        try:
            return time_path(path, limits, self.plan.timing, rates)
        except TimingError as error:
            raise errand.stuck("transfer" if errand.hand is None else "transit", str(error)) from error

    def _refuse_touch(self, query: CollisionQuery, Q: Array, errand: _Errand, way: str) -> None:
        """Get stuck unless the polyline through Q (n, 12) keeps clear of everything."""
        found = query.path(Q)
        if not found.free:
            one, other = query.pair_names(found.pair)
            stage = "transfer" if errand.hand is None else "transit"
            raise errand.stuck(stage, f"{one} and {other} would touch on {way}")

    def _why(self, query: CollisionQuery, outcome: MotionOutcome, goals: Array, arm: str) -> str:
        """Name the bodies in the way, where an end of a motion is what collides."""
        ends = {MotionOutcome.START_IN_COLLISION: self.stage.q[None], MotionOutcome.GOALS_IN_COLLISION: goals[:1]}
        if outcome not in ends:
            return ""
        q = self.stage.q[None] if outcome is MotionOutcome.START_IN_COLLISION else self._with_arm(arm, goals[:1])
        pair = int(query.first_collision(q)[0])
        return "" if pair < 0 else f" ({' and '.join(query.pair_names(pair))})"

    def _straight_query(self, arm: str, share: float = 1.0) -> CollisionQuery:
        """Query a straight way of a hand that is next to the plate; `share` of the margin is kept."""
        hands = {arm, *self._holding_arms()}
        return self.workcell.moving_arm_query(arm, self.stage.T_world_plate, hands, share)

    def _straight(self, arm: str, track: PhaseTrack, coarse: Array, kind: SegmentKind, errand: _Errand) -> None:
        """Move a hand along its straight way; `coarse` (n, 6) runs from start to end of it."""
        ends = track.carrier_ends if kind is SegmentKind.RETREAT else track.carrier_ends[::-1]
        start, end = (self.stage.T_world_plate @ transform for transform in ends)
        way = float(np.linalg.norm(end[:3, 3] - start[:3, 3]))
        joints = self.workcell.joints(arm)

        def at(s: Array) -> Array:
            carriers = np.repeat(start[None], len(s), axis=0)
            carriers[:, :3, 3] += (s / way)[:, None] * (end[:3, 3] - start[:3, 3])
            return self._columns({arm: track.exact(carriers, _interpolated(coarse, s / way))}, len(s))

        pace = self.plan.pace
        rate = RateLimit(np.ones_like, pace.approach_speed, pace.approach_acceleration)
        trajectory = self._timed(CurvePath(at, way), self.plan.limits, (rate,), errand)
        name = "the straight way to the plate" if kind is SegmentKind.APPROACH else "the straight way off the plate"
        query = self._straight_query(arm, self.workcell.settings.executed_share)
        self._refuse_touch(query, trajectory.positions, errand, name)
        self._add(kind, (arm,), trajectory)
        self.stage.q[joints] = coarse[-1]

    def _fingers(self, arm: str, kind: SegmentKind) -> None:
        """Close or open the fingers, everything else at rest."""
        self._add(kind, (), hold_still(self.stage.q, self.plan.pace.finger_time, self.plan.timing.sample_step))

    # The plate moves.

    def _transfer(self, place: int, number: int, forth: bool) -> None:
        """Move the plate along one motion of the graph with all hands that hold it."""
        motion = self.follower.motion(number)
        tracks = {self.plan.arm_of(h): self.tracks[e] for h, e in self.stage.holding.items()}
        coarse = {arm: track.along(place) for arm, track in tracks.items()}

        def poses(s: Array) -> Array:
            return motion.poses(s if forth else 1.0 - s)

        def at(s: Array) -> Array:
            plates = poses(s)
            return self._columns({a: t.exact(plates, _interpolated(coarse[a], s)) for a, t in tracks.items()}, len(s))

        stops = np.sort(motion.breaks if forth else 1.0 - motion.breaks)
        pace = self.plan.pace
        corners = self.follower.poses.plate.shape.polyhedron.vertices
        rate = RateLimit(lambda s: _corner_speed(poses, corners, s), pace.plate_speed, pace.plate_acceleration)
        errand = _Errand("transfer", None, place)
        trajectory = self._timed(CurvePath(at, 1.0, stops), self.plan.limits, (rate,), errand)
        carrier = min(tracks)
        plate = Attached(carrier, tracks[carrier].T_flange_plate)
        self._refuse_touch(self.workcell.transfer_query(plate, tracks), trajectory.positions, errand, "the way")
        T_world_plate = poses(np.clip(trajectory.path_parameter, 0.0, 1.0))
        end = motion.end if forth else motion.start
        self.stage.pose = self.sequence.poses[place + 1]
        sets = self._sets_in_motion(motion, T_world_plate, (self.sequence.poses[place], self.stage.pose), errand)
        self._refuse_torques(trajectory, T_world_plate, sets, errand)
        grip, push = self._holds()
        self.stage.segments.append(
            Segment(
                kind=SegmentKind.TRANSFER,
                movers=tuple(sorted(tracks)),
                contact=motion.contact,
                contact_points=motion.contact_points,
                grip=grip,
                push=push,
                trajectory=trajectory,
                widths={self.workcell.gripper: np.full(len(trajectory.time), self._width())},
                T_world_body=T_world_plate,
                contact_sets=sets,
            )
        )
        self.stage.q = trajectory.positions[-1].copy()
        self.stage.T_world_plate = end.T_world_plate

    def _sets_in_motion(
        self, motion: PlateMotion, T_world_plate: Array, ends: tuple[int, int], errand: _Errand
    ) -> tuple[ContactSet, ...]:
        """Balance the plate at both ends, in their own contacts, and often enough in between."""
        hands = self._hands()
        chosen = [ContactSet(0, self._balanced(self.balance_at(ends[0], hands), errand))]
        last = len(T_world_plate) - 1
        com_world, pace = self.follower.poses.plate.com_world(T_world_plate), self.plan.pace
        for sample in spaced(spent_on_the_way(T_world_plate, com_world, pace.set_rotation, pace.set_travel)):
            where = T_world_plate[sample], motion.contact_points, hands
            refusal = self.plan.balance.refusal(*where)
            answer = self.plan.balance.solve(*where) if refusal is None else refusal
            chosen.append(ContactSet(sample, self._balanced(answer, errand)))
        chosen.append(ContactSet(last, self._balanced(self.balance_at(ends[1], hands), errand)))
        return tuple(chosen)

    def _refuse_torques(
        self, trajectory: Trajectory, T_world_plate: Array, sets: tuple[ContactSet, ...], errand: _Errand
    ) -> None:
        """Get stuck where a joint would need too much torque."""
        for each in sets:
            rejection = self.plan.torques.refusal(trajectory, each.sample, T_world_plate[each.sample], each.balance)
            if rejection is not None:
                raise _GotStuck(Stuck(rejection, errand.step, errand.hand, errand.place))

    def balance_at(self, pose: int, hands: HandPair) -> Balanced | Unbalanced:
        """Return the remembered balance at a pose of the graph."""
        return self.plan.balance.at(pose, hands)

    def _balanced(self, answer: Balanced | Unbalanced, errand: _Errand) -> Balanced:
        if isinstance(answer, Unbalanced):
            raise errand.stuck("transfer", "the plate cannot be held at a sample of the timed motion")
        return answer

    # Bookkeeping.

    def _add(self, kind: SegmentKind, movers: tuple[str, ...], trajectory: Trajectory) -> None:
        """Append a segment in which the plate rests."""
        pose = self.follower.poses.poses[self.stage.pose]
        count = len(trajectory.time)
        grip, push = self._holds()
        resting = _Errand("rest", None, self.stage.edge)
        answer = self._balanced(self.balance_at(self.stage.pose, self._hands()), resting)
        plates = np.repeat(self.stage.T_world_plate[None], count, axis=0)
        sets = tuple(ContactSet(k, answer) for k in _at_rest(trajectory.time, self.plan.pace.set_pause))
        self._refuse_torques(trajectory, plates, sets, resting)
        self.stage.segments.append(
            Segment(
                kind=kind,
                movers=movers,
                contact=pose.contact,
                contact_points=pose.contact_points,
                grip=grip,
                push=push,
                trajectory=trajectory,
                widths={self.workcell.gripper: self._width_over(kind, trajectory)},
                T_world_body=plates,
                contact_sets=sets,
            )
        )
        self.stage.q = trajectory.positions[-1].copy()

    def _width_over(self, kind: SegmentKind, trajectory: Trajectory) -> Array:
        """Opening of the gripper over a segment: ramped where the fingers move."""
        closed, opened = self.workcell.grip_width, self.workcell.open_width
        if kind not in (SegmentKind.GRIP, SegmentKind.RELEASE):
            return np.full(len(trajectory.time), self._width())
        part = 0.5 - 0.5 * np.cos(np.pi * trajectory.time / trajectory.time[-1])
        start, end = (opened, closed) if kind is SegmentKind.GRIP else (closed, opened)
        width = start + part * (end - start)
        width[-1] = end
        return width

    def _width(self) -> float:
        return self.workcell.grip_width if "grip" in self.stage.holding else self.workcell.open_width

    def _hands(self) -> HandPair:
        grip, push = self.stage.holding.get("grip"), self.stage.holding.get("push")
        return (None if grip is None else grip.hold.index, None if push is None else push.hold.index)

    def _holding_arms(self) -> set[str]:
        return {self.plan.arm_of(hand) for hand in self.stage.holding}

    def _holds(self) -> tuple[GripHold | None, PushHold | None]:
        grip, push = self.stage.holding.get("grip"), self.stage.holding.get("push")
        grip_hold = push_hold = None
        if grip is not None:
            flip = self.assignment[grip] // BRANCHES
            data = self.follower.grips[grip.hold.index]
            T_plate_flange = self.follower.hand("grip").T_plate_flange[grip.hold.index, flip]
            grip_hold = GripHold(
                self.workcell.gripper,
                data.T_plate_tcp[flip],
                self.workcell.grip_width,
                inverse(T_plate_flange),
                flip == 1,
            )
        if push is not None:
            contact = self.follower.pushes[push.hold.index]
            push_hold = PushHold(self.workcell.pusher, contact.point, contact.normal)
        return grip_hold, push_hold

    def _columns(self, moving: dict[str, Array], count: int) -> Array:
        """Put the moving arms' (n, 6) positions among all twelve; idle arms stay."""
        q = np.repeat(self.stage.q[None], count, axis=0)
        for arm, positions in moving.items():
            q[:, self.workcell.joints(arm)] = positions
        return q

    def _with_arm(self, arm: str, positions: Array) -> Array:
        return self._columns({arm: positions}, len(positions))

    def _of_both(self, trajectory: Trajectory, joints: slice) -> Trajectory:
        """Widen one arm's trajectory to all twelve joints."""
        count = len(trajectory.time)
        q = np.repeat(self.stage.q[None], count, axis=0)
        v, a = np.zeros((count, 12)), np.zeros((count, 12))
        q[:, joints], v[:, joints], a[:, joints] = trajectory.positions, trajectory.velocities, trajectory.accelerations
        return replace(trajectory, positions=q, velocities=v, accelerations=a)


@dataclass(frozen=True)
class _Errand:
    """What is being done, for the report if it fails."""

    step: Step
    hand: Hand | None
    place: int

    def stuck(self, stage: str, reason: str) -> _GotStuck:
        """Return what to raise."""
        return _GotStuck(Stuck(Rejection(stage, reason), self.step, self.hand, self.place))


class _GotStuck(Exception):
    """Carries a `Stuck` out of nested steps."""

    def __init__(self, stuck: Stuck) -> None:
        self.stuck = stuck
        super().__init__(stuck.rejection.reason)


def _interpolated(coarse: Array, part: Array) -> Array:
    """Interpolate evenly spaced rows (m, 6) at parts (n,) of the way."""
    at = np.clip(part, 0.0, 1.0) * (len(coarse) - 1)
    below = np.minimum(at.astype(int), len(coarse) - 2)
    weight = (at - below)[:, None]
    return (1.0 - weight) * coarse[below] + weight * coarse[below + 1]


def _corner_speed(poses: Callable[[Array], Array], corners: Array, s: Array) -> Array:
    """Return the speed per parameter of the fastest corner at parameters (n,) [m]."""
    h = 1e-4
    low, high = np.clip(s - h, 0.0, 1.0), np.clip(s + h, 0.0, 1.0)
    ends = [np.einsum("nij,vj->nvi", T[:, :3, :3], corners) + T[:, None, :3, 3] for T in (poses(low), poses(high))]
    return np.linalg.norm(ends[1] - ends[0], axis=2).max(axis=1) / (high - low)


def _at_rest(time: Array, pause: float) -> Iterator[int]:
    """Yield the first sample, the last, and in between the farthest ones that are no longer than a pause apart."""
    sample, last = 0, len(time) - 1
    while sample < last:
        yield sample
        sample = max(sample + 1, int(np.searchsorted(time, time[sample] + pause, side="right")) - 1)
    yield last
