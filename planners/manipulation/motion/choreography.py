"""From a path with postures to motion: every edge becomes planned, checked and timed segments."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal, Self

import numpy as np

from planners.balance.balanced import Balanced, Unbalanced
from planners.cell.cell import Cell
from planners.cell.cell_size import resized
from planners.collision.model import Attached, CollisionQuery
from planners.geometry.pose import Array, Transform, inverse
from planners.graph.rejections import Rejection
from planners.hands.arm_motion import (
    FreeMotion,
    FreeMove,
    Stuck,
    among_all,
    interpolated,
    of_both_arms,
    openings,
    touching,
)
from planners.kinematics.inverse import BRANCHES
from planners.manipulation.contacts.contact_states import PrincipalContact
from planners.manipulation.contacts.dense_contact_states import PlateMotion
from planners.manipulation.lift_segment import BalancedContacts, GripHold, LiftSegment, PushHold
from planners.manipulation.motion.assignment import Assignment
from planners.manipulation.motion.manipulation_sequence import HoldPhase, ManipulationSequence
from planners.manipulation.motion.phase_track import PhaseTrack
from planners.manipulation.motion.posture_follower import PostureFollower
from planners.manipulation.reach.hand_reach import Hand
from planners.manipulation.reach.lift_workcell import LiftWorkcell
from planners.manipulation.statics.hold_balance import HandPair, HoldBalance
from planners.manipulation.statics.lift_torques import LiftTorques
from planners.motion.path import CurvePath, JointPath
from planners.motion.query import MotionSettings
from planners.motion.spacing import spaced, spent_on_the_way
from planners.motion.timing import JointLimits, RateLimit, TimingError, TimingSettings, time_path
from planners.motion.trajectory import Trajectory, hold_still
from planners.plan.segment import SegmentKind


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

    @classmethod
    def of(cls, cell: Cell) -> Self:
        """Return that of a cell; here it is of one of size 1. Longer ways are gone faster, as quickly sped up."""
        return resized(cls(), math.sqrt(cell.size), "plate_speed", "approach_speed")


PERSISTENCE = 4
"""A search for a free motion that was exhausted is tried once more with this many times its iterations."""

Step = Literal["arrival", "departure", "parking", "transfer", "rest"]
"""What a path gets stuck at: a hand comes, goes, or is put out of the way; the plate moves, or rests."""


@dataclass(frozen=True)
class StuckStep:
    """Why a path with these postures cannot be moved along."""

    rejection: Rejection
    step: Step
    hand: Hand | None
    """The hand that could not come, go or be parked; None for the plate."""
    place: int
    """On the path: of the node that has the hold of a hand that comes or goes; else of the edge that fails."""


@dataclass(eq=False)
class _State:
    """What has happened so far."""

    q: Array
    T_world_plate: Transform
    pose: int
    edge: int = 0
    """Of the path, that is being realised."""
    holding: dict[Hand, HoldPhase] = field(default_factory=dict)
    loose: list[Hand] = field(default_factory=list)
    segments: list[LiftSegment] = field(default_factory=list)


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
        self.workcell, self.follower, self.balance = workcell, follower, balance
        self.free = FreeMotion(motion or MotionSettings(), rng, persistence=PERSISTENCE)
        self.free_motions: dict[tuple[object, ...], tuple[Trajectory, int] | Rejection] = {}
        """With the goal that each leads to, or why none was found: many sequences ask for the same one."""
        self.pace = pace or PaceSettings.of(workcell.scene.cell)
        self.timing = timing or TimingSettings()
        arms = [workcell.arm(name) for name in ("left", "right")]
        self.limits = JointLimits(
            np.concatenate([arm.velocity_max for arm in arms]), np.concatenate([arm.acceleration_max for arm in arms])
        )
        self.torques = LiftTorques(workcell)

    def realise(self, sequence: ManipulationSequence, assignment: Assignment) -> tuple[LiftSegment, ...] | StuckStep:
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
        self.state = _State(start.copy(), self.follower.poses.poses[pose].T_world_plate, pose)
        self.tracks: dict[HoldPhase, PhaseTrack] = {}
        self._doing: tuple[Step, Hand | None, int] = ("rest", None, 0)
        """What is being done, for the report if it fails."""

    def realise(self) -> tuple[LiftSegment, ...] | StuckStep:
        for phase in self.sequence.phases:
            self.tracks[phase] = PhaseTrack.of(self.follower, self.sequence, phase, self.assignment[phase])
        try:
            for phase in self._changing(lambda e: e.first == 0):
                self._arrive(phase)
            for place, step in enumerate(self.sequence.motions):
                self.state.edge = place
                if step is not None:
                    self._park_loose_arms()
                    self._transfer(place, *step)
                    continue
                for phase in self._changing(lambda e, here=place: e.goes and e.last == here):
                    self._leave(phase)
                for phase in self._changing(lambda e, here=place: e.first == here + 1):
                    self._arrive(phase)
            self._end_in_hold()
        except Stuck as error:
            return StuckStep(error.rejection, *self._doing)
        return tuple(self.state.segments)

    def _end_in_hold(self) -> None:
        """Let a plan end with both hands on the plate, also where the last of them came when it was in the air."""
        if self.state.segments[-1].kind is not SegmentKind.TRANSFER:
            still = hold_still(self.state.q, self.plan.pace.finger_time, self.plan.timing.sample_step)
            self._add(SegmentKind.TRANSFER, (), still)

    def _changing(self, which: Callable[[HoldPhase], bool]) -> list[HoldPhase]:
        return sorted((e for e in self.sequence.phases if which(e)), key=lambda e: e.hand)

    @contextmanager
    def _during(self, step: Step, hand: Hand | None, place: int) -> Iterator[None]:
        """Note what is being done; where it gets stuck the note stays."""
        before = self._doing
        self._doing = step, hand, place
        yield
        self._doing = before

    def _stuck(self, reason: str) -> Stuck:
        """Return what to raise where the plate, or a hand, cannot go on."""
        return Stuck(Rejection("transfer" if self._doing[1] is None else "transit", reason))

    # Hands come and go.

    def _arrive(self, phase: HoldPhase) -> None:
        """Bring a hand to the plate: free motion, straight approach, and for the gripper the closing of the fingers."""
        hand, arm = phase.hand, self.plan.arm_of(phase.hand)
        joints, track, data = self.workcell.joints(arm), self.tracks[phase], self.workcell.arm(arm)
        with self._during("arrival", hand, phase.first):
            goals = track.windings(data.position_min, data.position_max)
            if not len(goals):
                raise self._stuck("no turn of the joints keeps them within limits while it holds")
            # All windings look the same to collisions.
            way = among_all(self.state.q, joints, track.approach)
            self._refuse_touch(self._straight_query(arm), way, "the approach")
            track.turn(goals[self._free_motion(hand, track.approach[-1] + goals)])
            self._straight(arm, track, track.approach[::-1], SegmentKind.APPROACH)
            self.state.q[joints] = track.approach[0]
        if hand == "grip":
            self._fingers(SegmentKind.GRIP)
        self.state.holding[hand] = phase
        if hand in self.state.loose:
            self.state.loose.remove(hand)

    def _leave(self, phase: HoldPhase) -> None:
        """Take a hand off the plate; it is parked when the plate is next to move."""
        hand, track = phase.hand, self.tracks[phase]
        del self.state.holding[hand]
        if hand == "grip":
            self._fingers(SegmentKind.RELEASE)
        with self._during("departure", hand, phase.last):
            self._straight(self.plan.arm_of(hand), track, track.retreat, SegmentKind.RETREAT)
        self.state.loose.append(hand)

    def _park_loose_arms(self) -> None:
        """Bring arms that hold nothing back to where they started; one that finds no way stays where it retreated to.

        Whether it is in the way there, the plate's motion says.
        """
        for hand in self.state.loose:
            home = self.workcell.scene.start_positions[self.workcell.joints(self.plan.arm_of(hand))]
            before = self._doing
            try:
                with self._during("parking", hand, self.state.edge):
                    self._free_motion(hand, home[None])
            except Stuck:
                # It is not what the sequence gets stuck at.
                self._doing = before
        self.state.loose.clear()

    def _free_motion(self, hand: Hand, goals: Array) -> int:
        """Move the arm of one hand through free space to one of the goals (k, 6); return which."""
        arm = self.plan.arm_of(hand)
        query = self.workcell.moving_arm_query(arm, self.state.T_world_plate, self._holding_arms())
        joints, data = self.workcell.joints(arm), self.workcell.arm(arm)
        asked = (hand, self.state.pose, frozenset(self._holding_arms()), *(_rounded(Q) for Q in (self.state.q, goals)))
        known = self.plan.free_motions.get(asked)
        if known is None:
            try:
                path, chosen = self.plan.free.find(FreeMove(f"{hand} hand", data, joints, self.state.q, goals, query))
                timed = self._timed(path, JointLimits(data.velocity_max, data.acceleration_max), ())
                known = of_both_arms(timed, self.state.q, joints), chosen
            except Stuck as stuck:
                known = stuck.rejection
            self.plan.free_motions[asked] = known
        if isinstance(known, Rejection):
            raise Stuck(known)
        trajectory, chosen = known
        self._add(SegmentKind.TRANSIT, (arm,), trajectory)
        return chosen

    def _timed(self, path: JointPath, limits: JointLimits, rates: tuple[RateLimit, ...]) -> Trajectory:
        """Put time along a path; a branch of the inverse kinematics may end or turn over between its samples."""
        try:
            return time_path(path, limits, self.plan.timing, rates)
        except TimingError as error:
            raise self._stuck(str(error)) from error

    def _refuse_touch(self, query: CollisionQuery, Q: Array, way: str) -> None:
        """Get stuck unless the polyline through Q (n, 12) keeps clear of everything."""
        names = touching(query, Q)
        if names is not None:
            raise self._stuck(f"{names[0]} and {names[1]} would touch on {way}")

    def _straight_query(self, arm: str, share: float = 1.0) -> CollisionQuery:
        """Query a straight way of a hand that is next to the plate; `share` of the margin is kept."""
        hands = {arm, *self._holding_arms()}
        return self.workcell.moving_arm_query(arm, self.state.T_world_plate, hands, share)

    def _straight(self, arm: str, track: PhaseTrack, coarse: Array, kind: SegmentKind) -> None:
        """Move a hand along its straight way; `coarse` (n, 6) runs from start to end of it."""
        ends = track.carrier_ends if kind is SegmentKind.RETREAT else track.carrier_ends[::-1]
        start, end = (self.state.T_world_plate @ transform for transform in ends)
        way = float(np.linalg.norm(end[:3, 3] - start[:3, 3]))
        joints = self.workcell.joints(arm)

        def at(s: Array) -> Array:
            """Joint positions (n, 12) after ways (n,) [m]."""
            carriers = np.repeat(start[None], len(s), axis=0)
            carriers[:, :3, 3] += (s / way)[:, None] * (end[:3, 3] - start[:3, 3])
            return among_all(self.state.q, joints, track.exact(carriers, interpolated(coarse, s / way)))

        pace = self.plan.pace
        rate = RateLimit(np.ones_like, pace.approach_speed, pace.approach_acceleration)
        trajectory = self._timed(CurvePath(at, way), self.plan.limits, (rate,))
        name = "the straight way to the plate" if kind is SegmentKind.APPROACH else "the straight way off the plate"
        query = self._straight_query(arm, self.workcell.settings.executed_share)
        self._refuse_touch(query, trajectory.positions, name)
        self._add(kind, (arm,), trajectory)
        self.state.q[joints] = coarse[-1]

    def _fingers(self, kind: SegmentKind) -> None:
        """Close or open the fingers, everything else at rest."""
        self._add(kind, (), hold_still(self.state.q, self.plan.pace.finger_time, self.plan.timing.sample_step))

    # The plate moves.

    def _transfer(self, place: int, number: int, forth: bool) -> None:
        """Move the plate along one motion of the graph with all hands that hold it."""
        motion = self.follower.motion(number)
        tracks = {self.plan.arm_of(h): self.tracks[e] for h, e in self.state.holding.items()}
        coarse = {arm: track.along(place) for arm, track in tracks.items()}

        def poses(s: Array) -> Array:
            return motion.poses(s if forth else 1.0 - s)

        def at(s: Array) -> Array:
            """Joint positions (n, 12) at shares (n,) of the motion."""
            plates, Q = poses(s), np.repeat(self.state.q[None], len(s), axis=0)
            for arm, track in tracks.items():
                Q[:, self.workcell.joints(arm)] = track.exact(plates, interpolated(coarse[arm], s))
            return Q

        stops = np.sort(motion.breaks if forth else 1.0 - motion.breaks)
        pace = self.plan.pace
        corners = self.follower.poses.plate.shape.polyhedron.vertices
        rate = RateLimit(lambda s: _corner_speed(poses, corners, s), pace.plate_speed, pace.plate_acceleration)
        with self._during("transfer", None, place):
            trajectory = self._timed(CurvePath(at, 1.0, stops), self.plan.limits, (rate,))
            carrier = min(tracks)
            plate = Attached(carrier, tracks[carrier].T_flange_plate)
            self._refuse_touch(self.workcell.transfer_query(plate, tracks), trajectory.positions, "the way")
            T_world_plate = poses(np.clip(trajectory.path_parameter, 0.0, 1.0))
            self.state.pose = self.sequence.poses[place + 1]
            sets = self._sets_in_motion(motion, T_world_plate, (self.sequence.poses[place], self.state.pose))
            support = motion.contact, motion.contact_points
            self._append(SegmentKind.TRANSFER, tuple(sorted(tracks)), trajectory, T_world_plate, support, sets)
        self.state.T_world_plate = (motion.end if forth else motion.start).T_world_plate

    def _sets_in_motion(
        self, motion: PlateMotion, T_world_plate: Array, ends: tuple[int, int]
    ) -> tuple[BalancedContacts, ...]:
        """Balance the plate at both ends, in their own contacts, and often enough of its poses (n, 4, 4) in between."""
        hands = self._hands()
        chosen = [BalancedContacts(0, self._balanced(self.balance_at(ends[0], hands)))]
        last = len(T_world_plate) - 1
        com_world, pace = self.follower.poses.plate.com_world(T_world_plate), self.plan.pace
        for sample in spaced(spent_on_the_way(T_world_plate, com_world, pace.set_rotation, pace.set_travel)):
            where = T_world_plate[sample], motion.contact_points, hands
            refusal = self.plan.balance.refusal(*where)
            answer = self.plan.balance.solve(*where) if refusal is None else refusal
            chosen.append(BalancedContacts(sample, self._balanced(answer)))
        chosen.append(BalancedContacts(last, self._balanced(self.balance_at(ends[1], hands))))
        return tuple(chosen)

    def balance_at(self, pose: int, hands: HandPair) -> Balanced | Unbalanced:
        """Return the remembered balance at a pose of the graph."""
        return self.plan.balance.at(pose, hands)

    def _balanced(self, answer: Balanced | Unbalanced) -> Balanced:
        if isinstance(answer, Unbalanced):
            raise Stuck(Rejection("transfer", "the plate cannot be held at a sample of the timed motion"))
        return answer

    # Bookkeeping.

    def _add(self, kind: SegmentKind, movers: tuple[str, ...], trajectory: Trajectory) -> None:
        """Append a segment in which the plate rests."""
        pose = self.follower.poses.poses[self.state.pose]
        plates = np.repeat(self.state.T_world_plate[None], len(trajectory.time), axis=0)
        with self._during("rest", None, self.state.edge):
            answer = self._balanced(self.balance_at(self.state.pose, self._hands()))
            sets = tuple(BalancedContacts(k, answer) for k in _at_rest(trajectory.time, self.plan.pace.set_pause))
            self._append(kind, movers, trajectory, plates, (pose.contact, pose.contact_points), sets)

    def _append(
        self,
        kind: SegmentKind,
        movers: tuple[str, ...],
        trajectory: Trajectory,
        T_world_plate: Array,
        support: tuple[PrincipalContact, Array],
        sets: tuple[BalancedContacts, ...],
    ) -> None:
        """Append a segment, or get stuck where a joint would need too much torque in it.

        `T_world_plate` has the plate's pose (n, 4, 4) at every sample, `support` the contact and its points (k, 3) in
        the plate frame [m].
        """
        for each in sets:
            rejection = self.plan.torques.refusal(trajectory, each.sample, T_world_plate[each.sample], each.balance)
            if rejection is not None:
                raise Stuck(rejection)
        grip, push = self._holds()
        segment = LiftSegment(
            kind=kind,
            movers=movers,
            contact=support[0],
            contact_points=support[1],
            grip=grip,
            push=push,
            trajectory=trajectory,
            widths={self.workcell.gripper: self._widths(kind, trajectory)},
            T_world_body=T_world_plate,
            contact_sets=sets,
        )
        self.state.segments.append(segment)
        self.state.q = trajectory.positions[-1].copy()

    def _widths(self, kind: SegmentKind, trajectory: Trajectory) -> Array:
        """Opening of the gripper over a segment (n,): it changes where the fingers move [m]."""
        closed, opened = self.workcell.grip_width, self.workcell.open_width
        start = end = closed if "grip" in self.state.holding else opened
        if kind in (SegmentKind.GRIP, SegmentKind.RELEASE):
            start, end = (opened, closed) if kind is SegmentKind.GRIP else (closed, opened)
        return openings(trajectory.time, start, end)

    def _hands(self) -> HandPair:
        grip, push = self.state.holding.get("grip"), self.state.holding.get("push")
        return (None if grip is None else grip.hold.index, None if push is None else push.hold.index)

    def _holding_arms(self) -> set[str]:
        return {self.plan.arm_of(hand) for hand in self.state.holding}

    def _holds(self) -> tuple[GripHold | None, PushHold | None]:
        grip, push = self.state.holding.get("grip"), self.state.holding.get("push")
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


def _rounded(positions: Array) -> bytes:
    """Return joint positions [rad] as a key: those of one posture differ by rounding where ways there do."""
    return np.round(positions, 6).tobytes()


def _corner_speed(poses: Callable[[Array], Array], corners: Array, s: Array) -> Array:
    """Return the speed per parameter of the fastest corner at parameters (n,) [m]."""
    h = 1e-4
    low, high = np.clip(s - h, 0.0, 1.0), np.clip(s + h, 0.0, 1.0)
    ends = [np.einsum("nij,vj->nvi", T[:, :3, :3], corners) + T[:, None, :3, 3] for T in (poses(low), poses(high))]
    return np.linalg.norm(ends[1] - ends[0], axis=2).max(axis=1) / (high - low)


def _at_rest(time: Array, pause: float) -> Iterator[int]:
    """Yield the first of samples (n,), the last, and between them the farthest at most a pause apart [s]."""
    sample, last = 0, len(time) - 1
    while sample < last:
        yield sample
        sample = max(sample + 1, int(np.searchsorted(time, time[sample] + pause, side="right")) - 1)
    yield last
