"""One run of a suction-tool plan: the timed motion by position control, until its end or until something gives way."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from planners.cell.hand import Gripper
from planners.contract.arrays import rounded
from planners.geometry.pose import Array, Transform, rotation_angle
from planners.plan.plan import Plan
from planners.plan.segment import Attachment, Grip, Segment, SegmentKind, riding_on
from planners.plan.simulation import GoalError, SimulatedToolMotion, ToolEnding
from planners.progress import Progress, Report
from planners.scene.moved_object import MovedObject
from planners.scene.solid import ExtrudedSolid
from planners.scene.suction_tool import TOOL_NAME
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.holds import Chain, CupHold, CupLoad, FingerHold, leaves_behind, misses_tool
from workers.simulation.recording import MOTION_EVERY, TOOL_UNITS, Failure, Recorder, Track
from workers.simulation.settings import ToolSimulationSettings, WatchSettings
from workers.simulation.timeline import PlannedMoment, SampledTimeline
from workers.simulation.world import FreeBody, ToolWorld

_REPORT_EVERY = 50
"""Steps between two reports of progress."""
_NO_LOAD = (0.0, 0.0)
_SWITCHING = (SegmentKind.GRIP, SegmentKind.RELEASE, SegmentKind.ATTACH, SegmentKind.DETACH)
"""Segments within which fingers or vacuum change."""
ToolFailure = Failure[ToolEnding]


class ToolExecution:
    """One simulated run of a plan. Call `run` once."""

    def __init__(self, plan: Plan, scene: SuctionToolScene, world: ToolWorld, settings: ToolSimulationSettings) -> None:
        """Prepare what the plan wants.

        Args:
            plan: solved.
            scene: that it was planned in.
            world: the physics, at the start.
            settings: see there.
        """
        self.scene, self.world, self.settings = scene, world, settings
        self.timeline = SampledTimeline(plan.segments)
        self.recorder = Recorder(TOOL_UNITS, length_digits=6)
        self.time = 0.0
        """[s]"""
        self._moments = self.timeline.every(settings.step)
        self._moment = next(self._moments)
        self._fingers: dict[str, FingerHold] = {}
        self._cup: CupHold | None = None
        self._chain = Chain([])
        self._positions = {name: self.timeline.poses(name, plan.bodies[name].pose)[:, :3] for name in world.bodies}
        """By body: (n, 3) where its origin should be, by sample [m]."""
        self._suction = [riding_on(TOOL_NAME, plan.segments, index) for index in range(len(plan.segments))]
        self._grips = [segment.grips for segment in plan.segments]
        around = [self._suction[max(index - 1, 0) : index + 2] for index in range(len(plan.segments))]
        self._passes = [frozenset(each[0] for each in near if each is not None) for near in around]
        """By segment: what the cup may touch."""
        self._moved: list[tuple[float, Array]] = []
        """Time and joint positions, at some of the recorder's times."""
        self._tracks = {name: Track() for name in world.bodies}
        self._standing = StandingWatch(world.bodies, settings.watch)
        self._passing: frozenset[str] = frozenset()
        self._done: Segment | None = None
        """The segment in which nothing is left to be taken or let go."""
        self._look = round(settings.watch.period / settings.step)
        self._record = round(settings.record_period / settings.step)
        self._steps = 0
        self._squeezes: dict[str, float] = {}
        self._load: CupLoad | None = None

    def run(self, progress: Progress) -> ToolFailure | None:
        """Execute everything; return what gave way, None when all objects are at their goals."""
        end = self.timeline.duration + self.settings.settle
        failure = None
        while failure is None and self.time < end - 0.5 * self.settings.step:
            failure = self._step()
            if self._steps % _REPORT_EVERY == 0:
                progress(Report("simulate", round(1000.0 * self.time / end), 1000))
        failure = failure or self._miss()
        if failure is not None and self.time < end - 0.5 * self.settings.step:
            self._stand_still()
        if failure is None:
            progress(Report("simulate", 1, 1))
        return failure

    def goal_errors(self) -> dict[str, GoalError]:
        """Return how far each object is from its goal now."""
        return {each.name: goal_error(each, self.world.bodies[each.name].T_world_body) for each in self.scene.objects}

    def motion(self) -> SimulatedToolMotion:
        """Return how robot and bodies moved, for playing it back; each body's poses have times of their own."""
        return SimulatedToolMotion(
            time=np.array([round(time, 4) for time, _ in self._moved]),
            positions=rounded(np.array([positions for _, positions in self._moved]).reshape(-1, 12), 5),
            bodies={name: track.stated() for name, track in self._tracks.items()},
        )

    # One step.

    def _step(self) -> ToolFailure | None:
        failure = self._take_and_let_go(self._moment)
        if failure is not None:
            return failure
        self._moment = ahead = next(self._moments)
        self._advance(ahead.positions, ahead.velocities)
        if self._steps % self._look == 0:
            failure = self._give_way() or self._standing.look(self._held(), self.time)
        if failure is not None or self._steps % self._record == 0:
            self._keep(ahead)
        return failure

    def _advance(self, positions: Array, velocities: Array) -> None:
        """Let holds act for one step while the joints are driven to positions (12,)."""
        world, step = self.world, self.settings.step
        holds = self._fingers.values()
        for hold in holds:
            hold.bond.follow(*world.hand(hold.arm, hold.T_flange_tcp))
        bonds = [hold.bond for hold in holds]
        if self._cup is not None:
            self._cup.bond.follow(world.tool.T_world_body)
            bonds.append(self._cup.bond)
        if self._chain.bonds != bonds:
            self._chain = Chain(bonds)
        self._chain.exert(step, self.scene.cell.gravity)
        for hold in holds:
            world.push_hand(hold.arm, -hold.bond.wrench, hold.bond.point)
        world.drive(positions, velocities)
        world.advance()
        self.time += step
        self._steps += 1

    def _stand_still(self) -> None:
        """Stop the robot where it is, and see what becomes of the rest."""
        positions = self.world.positions.copy()
        for _ in range(round(self.settings.aftermath / self.settings.step)):
            self._advance(positions, np.zeros(12))
            if self._steps % self._record == 0:
                self._keep(None)

    # Taking and letting go, as the plan says.

    def _take_and_let_go(self, moment: PlannedMoment) -> ToolFailure | None:
        if moment.segment is self._done:
            return None
        self._let_pass(moment.number)
        failure = self._move_fingers(self._wanted_grips(moment)) or self._switch_vacuum(self._wanted_suction(moment))
        if failure is None and moment.segment.kind not in _SWITCHING:
            self._done = moment.segment
        return failure

    def _wanted_grips(self, moment: PlannedMoment) -> tuple[Grip, ...]:
        kind, s, grips = moment.segment.kind, self.settings, self._grips[moment.number]
        opened = (kind is SegmentKind.GRIP and moment.elapsed < s.close_at) or (
            kind is SegmentKind.RELEASE and moment.elapsed >= s.open_at
        )
        return grips[1:] if opened else grips

    def _wanted_suction(self, moment: PlannedMoment) -> tuple[str, Attachment] | None:
        kind, at = moment.segment.kind, self.settings.vacuum_at
        off = (kind is SegmentKind.ATTACH and moment.elapsed < at) or (
            kind is SegmentKind.DETACH and moment.elapsed >= at
        )
        return None if off else self._suction[moment.number]

    def _move_fingers(self, wanted: tuple[Grip, ...]) -> ToolFailure | None:
        arms = [grip.arm for grip in wanted]
        if arms == [*self._fingers]:
            return None
        self._fingers = {arm: hold for arm, hold in self._fingers.items() if arm in arms}
        for grip in wanted:
            if grip.arm in self._fingers:
                continue
            hand = self.scene.cell.arms[grip.arm].hand
            assert isinstance(hand, Gripper)
            T_flange_tcp = hand.T_flange_tcp(grip.width)
            T_world_tcp, _ = self.world.hand(grip.arm, T_flange_tcp)
            missed = misses_tool(grip, T_world_tcp, self.world.tool, self.settings.taking)
            if missed is not None:
                return Failure("tool_slipped", self.time, missed)
            self._fingers[grip.arm] = FingerHold(
                grip, self.world.tool, T_world_tcp, T_flange_tcp, self.scene, self.settings
            )
        return None

    def _switch_vacuum(self, wanted: tuple[str, Attachment] | None) -> ToolFailure | None:
        if wanted is None:
            self._cup = None
            return None
        name, attachment = wanted
        if self._cup is not None and self._cup.name == name:
            return None
        tool, item = self.world.tool, self.world.bodies[name]
        missed = leaves_behind(attachment.T_to_body, tool, item, self.settings.taking)
        if missed is not None:
            return Failure("object_dropped", self.time, missed)
        self._cup = CupHold(tool, item, self.scene.tool.cup, self.settings)
        return None

    def _let_pass(self, index: int) -> None:
        """Let the cup touch what it sucks in a segment, before it or after it: its lip is no rigid body."""
        passing = self._passes[index]
        if passing == self._passing:
            return
        for name in passing ^ self._passing:
            self.world.tool.let_touch(self.world.bodies[name], touches=name not in passing)
        self._passing = passing

    # Looking at it.

    def _give_way(self) -> ToolFailure | None:
        period = self.settings.watch.period
        self._squeezes = {arm: hold.squeeze for arm, hold in self._fingers.items()}
        self._load = None if self._cup is None else self._cup.load
        if self._cup is not None and self._load is not None:
            cause = self._cup.lets_go(self._load, period)
            if cause is not None:
                self._cup = None
                return Failure("object_dropped", self.time, cause)
        for arm, hold in self._fingers.items():
            cause = hold.lets_go(self._squeezes[arm], period)
            if cause is not None:
                del self._fingers[arm]
                return Failure("tool_slipped", self.time, cause)
        return None

    def _held(self) -> list[str]:
        held = [] if self._cup is None else [self._cup.name]
        return [*held, TOOL_NAME] if self._fingers else held

    def _miss(self) -> ToolFailure | None:
        """Return which object is farthest off its goal, None if all are there."""
        s = self.settings.watch
        off = {n: e for n, e in self.goal_errors().items() if e.distance > s.goal_distance or e.angle > s.goal_angle}
        if not off:
            return None
        worst = max(off, key=lambda name: off[name].distance)
        error = off[worst]
        where = f"{1e3 * error.distance:.1f} mm and {np.degrees(error.angle):.1f} degrees off its goal"
        return Failure("off_goal", self.time, f"{worst} ended {where}")

    def _keep(self, moment: PlannedMoment | None) -> None:
        """Record how it is now; without a moment of the plan nothing is off it."""
        pull, share = _NO_LOAD if self._load is None else (self._load.pull, self._load.share)
        off = {name: 0.0 if moment is None else self._off(name, moment) for name in self._held()}
        tool_off = off.pop(TOOL_NAME, 0.0)
        self.recorder.add(
            self.time,
            suction_load=pull,
            suction_share=share,
            left_squeeze=self._squeezes.get("left", 0.0),
            right_squeeze=self._squeezes.get("right", 0.0),
            tool_off_plan=tool_off,
            object_off_plan=max(off.values(), default=0.0),
        )
        if len(self.recorder.time) % MOTION_EVERY == 1:
            self._moved.append((self.time, self.world.positions.copy()))
            for name, body in self.world.bodies.items():
                self._tracks[name].add(self.time, body.T_world_body)

    def _off(self, name: str, moment: PlannedMoment) -> float:
        planned = moment.between(self._positions[name])
        return float(np.linalg.norm(self.world.bodies[name].T_world_body[:3, 3] - planned))


class StandingWatch:
    """Watches what nothing holds: it has to stay where it was let go."""

    def __init__(self, bodies: Mapping[str, FreeBody], settings: WatchSettings) -> None:
        """Begin with all bodies standing where they are."""
        self._bodies, self._settings = bodies, settings
        self._least_cosine = math.cos(settings.tilt)
        self._R_center_bodies = np.array([body.T_center_body[:3, :3] for body in bodies.values()])
        self._centers, self._verticals = self._places()
        """(n, 3) of all bodies when they were let go: where their centres of mass were, and what was upwards in their
        own axes."""

    def look(self, held: Iterable[str], time: float) -> ToolFailure | None:
        """Return what has fallen, toppled or been pushed until a time [s]; what is held now may do as it likes."""
        centers, verticals = self._places()
        taken = frozenset(held)
        for i, name in enumerate(self._bodies):
            if name in taken:
                self._centers[i], self._verticals[i] = centers[i], verticals[i]
        # What is held is where it was let go by this.
        ways, cosines = centers - self._centers, np.einsum("ij,ij->i", verticals, self._verticals)
        fell, toppled = -ways[:, 2] > self._settings.fall, cosines < self._least_cosine
        shifts = np.hypot(ways[:, 0], ways[:, 1])
        moved = fell | toppled | (shifts > self._settings.shift)
        if not moved.any():
            return None
        first = int(np.argmax(moved))
        name = [*self._bodies][first]
        if fell[first]:
            if name == TOOL_NAME:
                return Failure("tool_slipped", time, "the tool fell: no hand held it and it stood on nothing")
            return Failure("object_dropped", time, f"{name} fell where the vacuum let it go")
        if toppled[first]:
            return Failure("toppled", time, f"{name} toppled over")
        return Failure("off_goal", time, f"{name} was pushed {1e3 * shifts[first]:.0f} mm from where it stood")

    def _places(self) -> tuple[Array, Array]:
        """Return where all centres of mass are (n, 3), world, and what is upwards (n, 3) in each body's own axes."""
        motions = np.array([body.motion for body in self._bodies.values()])
        return motions[:, 3], np.einsum("ij,ijk->ik", motions[:, 2], self._R_center_bodies)


def goal_error(moved: MovedObject, T_world_object: Transform) -> GoalError:
    """Return how far an object is from its goal, whichever of its equivalent poses is nearest.

    Where any turn about the object's axis is as good, turns about it do not count.
    """
    distances = np.linalg.norm(moved.goals[:, :3, 3] - T_world_object[:3, 3], axis=1)
    if _any_turn(moved):
        angles = np.arccos(np.clip(moved.goals[:, :3, 2] @ T_world_object[:3, 2], -1.0, 1.0))
    else:
        angles = np.array([rotation_angle(goal[:3, :3], T_world_object[:3, :3]) for goal in moved.goals])
    # A turn that moves the origin counts by both.
    best = int(np.argmin(distances + 0.1 * angles))
    return GoalError(distance=float(distances[best]), angle=float(angles[best]))


def _any_turn(moved: MovedObject) -> bool:
    solid = moved.body.solid
    round_ = isinstance(solid, ExtrudedSolid) and solid.is_round
    return moved.symmetry == "axis" or (moved.symmetry == "shape" and round_)
