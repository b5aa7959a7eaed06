"""A plan as steps: in each, both arms move for the same time, and before it hands and payloads are set."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from planners.contract.arrays import ArmName
from planners.contract.task_spec import PlateLiftTask
from planners.geometry.pose import Array, Transform, from_pose7s, transform
from planners.lifting.hand_admittance import LEAST_PUSH, HandAdmittance
from planners.plan.plan import Plan
from planners.plan.planned_wrenches import planned_wrenches, told_wrenches
from planners.plan.scenery import ARMS, GripperDocument, StickDocument
from planners.plan.segment import Segment, SegmentKind
from planners.plan.simulation import LiftSimulation
from planners.program.stopping import StopBearing

STOP_DURATION = 1.0 / 16.0
"""Within which programs stop on the path, from any speed [s]."""
FORCE_ALLOWANCE = 20.0
"""What a wrist may feel beyond what its hand may exert before the program stops: inertia of the hand, noise [N]."""


@dataclass(frozen=True)
class Load:
    """What hangs on a flange: the hand and whatever is attached to it, but for the plate of a lift."""

    mass: float
    """[kg]"""
    com: tuple[float, float, float]
    """In the flange frame [m]."""


@dataclass(frozen=True, eq=False)
class WrenchCurve:
    """What a hand exerts on a plate, straight between samples."""

    time: Array
    """(n,) from the step's begin [s]."""
    values: Array
    """(n, 6) force and torque about the TCP, axes of the arm's base [N, Nm]; 0 while the hand comes or goes, NaN where
    it is away from the plate."""

    @property
    def bears(self) -> bool:
        """Whether the hand is at the plate all the time."""
        return not np.isnan(self.values).any()

    @property
    def comes(self) -> bool:
        """Whether the hand only comes to the plate, or goes from it."""
        return self.bears and not self.values.any()

    def at(self, time: Array) -> WrenchCurve:
        """Return the curve at other times (m,) of the step."""
        return WrenchCurve(time, np.column_stack([np.interp(time, self.time, column) for column in self.values.T]))


@dataclass(frozen=True, eq=False)
class ArmStep:
    """What one arm does in a step."""

    time: Array
    """(n,) from the step's begin; n = 1 where the arm stands still [s]."""
    positions: Array
    """(n, 6) [rad]"""
    velocities: Array
    """(n, 6) [rad/s]"""
    load: Load
    T_flange_tcp: Transform
    width: float | None
    """To which the fingers go during the step; None: they stay, or there are none [m]."""
    squeeze: float | None
    """With which they close [N]; None: they open, or stay."""
    vacuum: bool | None
    """Whether the vacuum of the tool goes on or off as the step begins; None: it stays. It is the same for both arms:
    nobody knows whose controller switches it, and a tool that is handed over keeps its valve."""
    force_limit: float
    """Of the force at the wrist, beyond which the program stops [N]."""
    wrenches: WrenchCurve | None = None
    """What the hand exerts on the plate of a lift during the step; None: there is no plate."""
    free: bool = False
    """Whether it is known that the hand touches nothing as the step begins."""

    @property
    def moves(self) -> bool:
        """Whether the arm moves."""
        return len(self.time) > 1

    @cached_property
    def curve(self) -> CubicHermiteSpline:
        """The (6,) joint positions at a time of the step [rad], and their derivatives; at rest, at any time."""
        if self.moves:
            return CubicHermiteSpline(self.time, self.positions, self.velocities)
        return CubicHermiteSpline([0.0, 1.0], np.repeat(self.positions, 2, axis=0), np.zeros((2, 6)))


@dataclass(frozen=True, eq=False)
class ProgramStep:
    """A segment of the plan, for both arms."""

    number: int
    """From 1, in the plan."""
    begin: float
    """On the plan's clock [s]."""
    kind: SegmentKind
    duration: float
    """[s]"""
    words: str
    """What is done, for a person."""
    arms: dict[ArmName, ArmStep]
    stop_share: float = 1.0
    """The largest share of the planned speed from which a stop loses nothing that is carried, see `StopBearing`; 0:
    there is none."""
    way: tuple[Array, Array] | None = None
    """Of a step that leads elsewhere than on: times from its begin, and where on the plan's clock that is (n,) [s]."""

    def clock(self, path_time: float) -> float:
        """Return where on the plan's clock a time from the step's begin is [s]."""
        if self.way is not None:
            return float(np.interp(path_time, *self.way))
        return self.begin + min(path_time, self.duration)


@dataclass(frozen=True, eq=False)
class Schedule:
    """All steps of a plan in their order, or those from one of them on."""

    plan: Plan
    steps: tuple[ProgramStep, ...]
    lift: LiftSimulation | None = None
    """What is known of the lift that follows the last step; None: no lift does."""
    with_objects: bool = True
    """Whether what the plan moves is there."""

    @classmethod
    def of(cls, plan: Plan, *, with_objects: bool = True) -> Schedule:
        """Return the steps of a plan: one for each segment, and the lift of a plate whose simulation came to it.

        Without the plate or the objects arms move as planned and bear nothing but hands and tool: no hand presses on
        what is not there, no object is in a payload, and no lift follows.
        """
        lift = plan.simulation if isinstance(plan.simulation, LiftSimulation) else None
        if lift is not None and (lift.lift is None or lift.lift.law is None or lift.lift.hand_wrenches is None):
            lift = None
        steps = tuple(_StepReader(plan, with_objects).steps())
        return cls(plan, steps, lift if with_objects else None, with_objects)

    def since(self, number: int) -> Schedule:
        """Return the steps from one of them on, by its number; they keep their numbers."""
        return replace(self, steps=tuple(step for step in self.steps if step.number >= number))

    def step(self, number: int) -> ProgramStep | None:
        """Return a step by its number; None: it is not one of these."""
        index = number - self.steps[0].number
        return self.steps[index] if 0 <= index < len(self.steps) else None

    @property
    def last(self) -> int:
        """The number of the last step; the lift, if one follows, has the next."""
        return self.steps[-1].number

    @cached_property
    def admittance(self) -> HandAdmittance:
        """How hands on the plate of a lift exert what is planned."""
        task = self.plan.task
        assert isinstance(task, PlateLiftTask)
        hands = self.plan.cell.hands.items()
        arm, stick = next((arm, hand) for arm, hand in hands if isinstance(hand, StickDocument))
        limit, spare = task.hand_force_limit, _spare_force(self.plan, arm)
        push = min(limit.normal, limit.net, math.inf if spare is None else spare)
        return HandAdmittance.of(stick.tip_radius, push, task.friction.eps)

    @property
    def openings(self) -> dict[ArmName, float]:
        """To what fingers go before anything moves, as the plan has them at its begin [m].

        None where hands hold something there already, or where what is executed begins later.
        """
        first, segment = self.steps[0], self.plan.segments[0]
        if first.number > 1 or first.way is not None or segment.grips:
            return {}
        return {arm: float(widths[0]) for arm, widths in segment.gripper_width.items()}

    @cached_property
    def start(self) -> dict[ArmName, Array]:
        """The (6,) joint positions from which each arm begins [rad]."""
        return {arm: self.steps[0].arms[arm].positions[0] for arm in ARMS}


_VACUUM = {SegmentKind.ATTACH: True, SegmentKind.DETACH: False}
_FINGERS_ACT = (SegmentKind.GRIP, SegmentKind.RELEASE)


@dataclass(frozen=True, eq=False)
class _StepReader:
    plan: Plan
    with_objects: bool

    @cached_property
    def _wrenches(self) -> dict[ArmName, Array]:
        """By arm: (n, 6) at all samples of the plan of a lift, as `WrenchCurve` has them; nothing for a pile."""
        if not isinstance(self.plan.task, PlateLiftTask):
            return {}
        segments, arms = self.plan.segments, self.plan.cell.arms
        told = {arm: told_wrenches(segments, planned_wrenches(segments, arm)) for arm in ARMS}
        plate = self.plan.bodies["plate"].pose
        for segment, first in zip(segments, self._first[:-1], strict=True):
            count = len(segment.time)
            poses = segment.body_poses.get("plate", np.repeat(plate[None], count, axis=0))
            plate = poses[-1]
            if segment.push is not None:
                normals = from_pose7s(poses)[:, :3, :3] @ segment.push.normal
                forces = told[segment.push.arm][first : first + count, :3]
                missing = np.maximum(0.0, LEAST_PUSH - np.einsum("ij,ij->i", forces, normals))
                forces += missing[:, None] * normals
        return {arm: in_base(rows, arms[arm].T_world_base) for arm, rows in told.items()}

    @cached_property
    def _first(self) -> list[int]:
        """Of each segment: which of all samples of the plan its first one is."""
        return [0, *np.cumsum([len(segment.time) for segment in self.plan.segments]).tolist()]

    def _wrench_curve(self, arm: ArmName, index: int, segment: Segment) -> WrenchCurve | None:
        if not self.with_objects or arm not in self._wrenches:
            return None
        rows, away = self._rows(arm, index), self._is_away(arm, index)
        takes = index + 1 < len(self.plan.segments) and not self._is_away(arm, index + 1)
        gives_up = segment.kind is SegmentKind.RELEASE and index > 0 and not self._is_away(arm, index - 1)
        if takes or gives_up or not away:
            # While a hand takes hold, or gives it up, it gives way to all that it touches.
            rows = np.nan_to_num(rows)
        return WrenchCurve(segment.time - segment.time[0], rows)

    def _is_free(self, arm: ArmName, index: int) -> bool:
        if not self.with_objects or arm not in self._wrenches or not self._is_away(arm, index):
            return False
        before = None if index == 0 else self._wrench_curve(arm, index - 1, self.plan.segments[index - 1])
        return before is None or not before.bears

    def _is_away(self, arm: ArmName, index: int) -> bool:
        return bool(np.isnan(self._rows(arm, index)).all())

    def _rows(self, arm: ArmName, index: int) -> Array:
        return self._wrenches[arm][self._first[index] : self._first[index + 1]]

    def steps(self) -> Iterator[ProgramStep]:
        stops = None if self._wrenches else StopBearing(self.plan, STOP_DURATION)
        for index, segment in enumerate(self.plan.segments):
            yield ProgramStep(
                number=index + 1,
                begin=float(segment.time[0]),
                kind=segment.kind,
                duration=segment.end - float(segment.time[0]),
                words=_words(segment),
                arms={arm: self._arm_step(arm, index, segment) for arm in ARMS},
                stop_share=1.0 if stops is None else stops.share(segment),
            )

    def _arm_step(self, arm: ArmName, index: int, segment: Segment) -> ArmStep:
        hand, count = self.plan.cell.hands[arm], len(segment.time) if arm in segment.movers else 1
        widths = segment.gripper_width.get(arm)
        gripper = isinstance(hand, GripperDocument)
        changes = widths is not None and float(np.ptp(widths)) > 0.0
        if gripper:
            assert widths is not None, "a plan gives the opening of every gripper in every segment"
            T_flange_tcp = transform(None, [0.0, 0.0, float(np.interp(widths[-1], *hand.tcp.T))])
        else:
            T_flange_tcp = hand.T_flange_tip
        return ArmStep(
            time=segment.time[:count] - segment.time[0],
            positions=_columns(segment.positions[:count], arm),
            velocities=_columns(segment.velocities[:count], arm),
            load=self._load(arm, index),
            T_flange_tcp=T_flange_tcp,
            width=float(widths[-1]) if widths is not None and changes else None,
            squeeze=self._squeeze(arm, index) if changes and segment.kind is SegmentKind.GRIP else None,
            vacuum=_VACUUM.get(segment.kind) if gripper else None,
            force_limit=self._force_limit(arm),
            wrenches=self._wrench_curve(arm, index, segment),
            free=self._is_free(arm, index),
        )

    def _squeeze(self, arm: ArmName, index: int) -> float | None:
        """Return with what the fingers close: what the plan says, else the hand's least force; None: on nothing.

        A plate is gripped from the segment after the one in which the fingers close on it, a tool from that one on.
        """
        hand = self.plan.cell.hands[arm]
        assert isinstance(hand, GripperDocument)
        near = self.plan.segments[index : index + 2]
        grip = next((grip for segment in near for grip in segment.grips if grip.arm == arm), None)
        if grip is None or grip.squeeze is not None:
            return None if grip is None else grip.squeeze
        return 0.0 if hand.force_range is None else float(hand.force_range[0])

    def _load(self, arm: ArmName, index: int) -> Load:
        """Return hand and attachments as one mass; what two hands have is half on each.

        A plate is none of it: what a hand has of it is a wrench that it feels, see `WrenchCurve`.
        """
        hand = self.plan.cell.hands[arm]
        mass = hand.mass or 0.0
        moment = mass * np.asarray(hand.com if hand.com is not None else np.zeros(3))
        holding, beside = self._holding(index)
        share = 1.0 / max(1, len(holding))
        for body, T_flange_body in carried_by(arm, beside) if arm in holding else ():
            described = self.plan.bodies[body]
            if described.role == "object" and not self.with_objects:
                continue
            carried = share * (described.mass or 0.0)
            mass += carried
            moment += carried * (T_flange_body[:3, :3] @ described.com + T_flange_body[:3, 3])
        com = moment / mass if mass > 0.0 else np.zeros(3)
        return Load(mass, (float(com[0]), float(com[1]), float(com[2])))

    def _holding(self, index: int) -> tuple[tuple[ArmName, ...], Segment]:
        """Return the hands that hold a tool all through a segment, and a segment that says what rides on them.

        While fingers close or open nothing rides: those of the other hand have it as before, or as afterwards.
        """
        segments, segment = self.plan.segments, self.plan.segments[index]
        if self._wrenches:
            return (), segment
        if segment.kind not in _FINGERS_ACT:
            return tuple(arm for arm in ARMS if any(ride.to == arm for _, ride in segment.rides)), segment
        holding = tuple(grip.arm for grip in segment.grips[1:])
        near = segments[index::-1] if segment.kind is SegmentKind.GRIP else segments[index:]
        return holding, next((each for each in near if each.kind not in _FINGERS_ACT), segment)

    def _force_limit(self, arm: ArmName) -> float:
        """Return what the wrist may feel: all that the arm's payload leaves beside the hand, and an allowance.

        The controller takes off what it is told to be the payload, so that what is carried is not felt.
        """
        return (_spare_force(self.plan, arm) or 0.0) + FORCE_ALLOWANCE


def _spare_force(plan: Plan, arm: ArmName) -> float | None:
    """Return what an arm's payload leaves beside its hand [N]; None where the document does not tell."""
    robot, hand = plan.cell.arms[arm], plan.cell.hands[arm]
    if robot.payload is None or hand.mass is None:
        return None
    return (robot.payload - hand.mass) * float(np.linalg.norm(plan.cell.gravity))


def in_base(wrenches: Array, T_world_base: Transform) -> Array:
    """Return wrenches (n, 6) in the axes of an arm's base instead of the world's."""
    return np.hstack([wrenches[:, :3] @ T_world_base[:3, :3], wrenches[:, 3:] @ T_world_base[:3, :3]])


def carried_by(arm: ArmName, segment: Segment) -> Iterator[tuple[str, Transform]]:
    """Yield what rides on a flange, and on that, with `T_flange_body`."""
    waiting: list[tuple[str, Transform]] = [(arm, np.eye(4))]
    while waiting:
        carrier, T_flange_carrier = waiting.pop()
        for body, ride in segment.rides:
            if ride.to == carrier:
                T_flange_body = T_flange_carrier @ ride.T_to_body
                yield body, T_flange_body
                waiting.append((body, T_flange_body))


def _words(segment: Segment) -> str:
    movers = " and ".join(segment.movers) or "nobody"
    state = segment.contact_state
    touching = (
        "" if state is None else ", plate in the air" if state.element == "none" else f", plate on {state.element}"
    )
    moves = "moves" if len(segment.movers) < 2 else "move"
    return f"{segment.kind.value}, {movers} {moves}{touching}"


def _of(arm: ArmName) -> slice:
    first = 6 * ARMS.index(arm)
    return slice(first, first + 6)


def _columns(rows: Array, arm: ArmName) -> Array:
    return rows[..., _of(arm)]
