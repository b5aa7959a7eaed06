"""What can be played of a plan: the plan itself, and the simulation of it if there is one, each at any time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from planners.contract.shapes import Cylinder
from planners.contract.task_spec import PlateLiftTask
from planners.geometry.pose import Array, Transform, from_pose7, inverse, pose_row, transform
from planners.kinematics.forward import flange_pose_of_plan
from planners.plan.plan import Plan
from planners.plan.scenery import BodyDocument
from planners.plan.segment import Grip, Segment, riding_on
from planners.plan.simulation import LiftSimulation, ToolSimulation
from planners.plan.timeline import ContactForce, Moment, PoseTrack, locate, mix
from planners.scene.suction_tool import TOOL_NAME
from workers.robot.execution_log import ExecutedMotion

SourceName = Literal["plan", "simulation", "execution"]
GRIPPING, PUSHING, LOAD = "gripping hand", "pushing hand", "suction load"
"""Names of curves: vertical forces on the plate by what the hand does to it, and what the cup bears."""
UP = np.array([0.0, 0.0, 1.0])


class Playback:
    """A plan, its simulation and an execution of it, each on a time axis that begins with it."""

    def __init__(self, plan: Plan, executed: ExecutedMotion | None = None) -> None:
        self.plan = plan
        self.simulation = _simulated(plan)
        self.executed = executed

    def at(self, source: SourceName, time: float) -> Moment:
        """Return where everything is at a time [s]; the plan stands in for what is not there."""
        if source == "simulation" and self.simulation is not None:
            return self.simulation.at(time)
        if source == "execution" and self.executed is not None:
            return self._executed_at(self.executed, time)
        return self.plan.at(time)

    def _executed_at(self, executed: ExecutedMotion, time: float) -> Moment:
        """Return the arms as they were measured, and everything else as the plan has it where they were in it."""
        sample, s = locate(executed.time, float(np.clip(time, 0.0, executed.time[-1])))
        after = min(sample + 1, len(executed.time) - 1)
        clock = float(mix(executed.clock[sample], executed.clock[after], s))
        positions = mix(executed.positions[sample], executed.positions[after], s)
        moment = replace(self.plan.at(clock), time=time, positions=positions)
        return self._raised(moment) if clock >= self.plan.duration and self.plan.task.kind == "plate_lift" else moment

    def _raised(self, moment: Moment) -> Moment:
        """Return a moment with the plate, and what hangs on it, as high as the hands have raised it since the end."""
        ended, arms = self.plan.at(self.plan.duration).positions, self.plan.cell.arms
        heights = [
            [
                flange_pose_of_plan(arm.dh, arm.T_world_base, q[6 * i : 6 * i + 6])[2, 3]
                for i, arm in enumerate(arms.values())
            ]
            for q in (ended, moment.positions)
        ]
        up = float(np.mean(heights[1]) - np.mean(heights[0])) * UP
        poses = {name: moment.body_poses[name] + [*up, 0.0, 0.0, 0.0, 0.0] for name in ("plate", "cup", "cable")}
        contacts = tuple(
            replace(each, point=each.point + up) if each.body == "plate" else each for each in moment.contacts
        )
        return replace(moment, body_poses={**moment.body_poses, **poses}, contacts=contacts)

    @property
    def durations(self) -> dict[SourceName, float]:
        """How long each source that is there takes [s]."""
        there: dict[SourceName, float] = {"plan": self.plan.duration}
        if self.simulation is not None:
            there["simulation"] = self.simulation.duration
        if self.executed is not None:
            there["execution"] = float(self.executed.time[-1])
        return there


class Simulated(ABC):
    """A simulation, to be asked for any time in [0, `duration`]; times outside are taken to the nearer end.

    Joints and bodies move straight between samples; before the first one they are as planned. Fingers open and close
    as planned.
    """

    def __init__(self, plan: Plan, simulation: LiftSimulation | ToolSimulation, planned_until: float) -> None:
        """Take a plan, its simulation, and until when hands do as planned [s]."""
        self.duration = simulation.time
        """When it ended [s]."""
        self._plan, self._planned_until = plan, planned_until
        self._time, self._positions = simulation.motion.time, simulation.motion.positions
        self._curves = {curve.name: curve for curve in simulation.force_curves}

    def at(self, time: float) -> Moment:
        """Return where everything is at `time` [s]."""
        time = float(min(max(time, 0.0), self.duration))
        planned = self._plan.at(min(time, self._planned_until))
        positions, poses = planned.positions, planned.body_poses
        if len(self._time) and time >= self._time[0]:
            sample, s = locate(self._time, time)
            positions = mix(self._positions[sample], self._positions[min(sample + 1, len(self._time) - 1)], s)
            poses = {**poses, **self._poses(time)}
        poses = {**poses, **self._riding(poses)}
        forces = () if planned.segment is None else tuple(self._forces(time, planned.segment, poses))
        return Moment(time, planned.segment, positions, planned.widths, poses, forces)

    @abstractmethod
    def _poses(self, time: float) -> dict[str, Array]:
        """Return the poses (7,) of the bodies that physics moved."""

    def _riding(self, poses: Mapping[str, Array]) -> dict[str, Array]:
        """Return the poses (7,) of what follows these bodies."""
        return {}

    @abstractmethod
    def _forces(self, time: float, segment: int, poses: Mapping[str, Array]) -> Iterator[ContactForce]:
        """Yield the forces that the simulation tells, where hands hold on as in a segment of the plan."""

    def _value(self, name: str, time: float) -> float:
        curve = self._curves[name]
        return float(np.interp(time, curve.time, curve.value)) if len(curve.time) else 0.0


class LiftPlayback(Simulated):
    """A simulated plate lift: the cup rides on the plate, the cable stands upright on one point of it.

    Its contacts are the vertical force of each hand, where it holds the plate, and the load of the cup.
    """

    def __init__(self, plan: Plan, simulation: LiftSimulation) -> None:
        super().__init__(plan, simulation, simulation.time)
        self._plate = PoseTrack(simulation.motion.plate)
        cup, cable = plan.bodies["cup"], plan.bodies["cable"]
        T_plate_world = inverse(plan.bodies["plate"].T_world_start)
        self._T_plate_cup = T_plate_world @ cup.T_world_start
        self._pad = _apply(self._T_plate_cup, -0.5 * _height(cup) * UP)
        self._half_cable = 0.5 * _height(cable) * UP
        self._cable_end = _apply(T_plate_world, cable.pose[:3] - self._half_cable)

    def _poses(self, time: float) -> dict[str, Array]:
        return {"plate": self._plate.at(*locate(self._time, time))}

    def _riding(self, poses: Mapping[str, Array]) -> dict[str, Array]:
        T_world_plate = from_pose7(poses["plate"])
        cable = transform(None, _apply(T_world_plate, self._cable_end) + self._half_cable)
        return {"cup": pose_row(T_world_plate @ self._T_plate_cup), "cable": pose_row(cable)}

    def _forces(self, time: float, segment: int, poses: Mapping[str, Array]) -> Iterator[ContactForce]:
        T_world_plate = from_pose7(poses["plate"])
        held, push = self._plan.segments[segment], self._plan.segments[segment].push
        places = [(GRIPPING, grip.arm, grip.pose[:3]) for grip in held.grips]
        places += [] if push is None else [(PUSHING, push.arm, push.point)]
        for name, arm, place in places:
            point, force = _apply(T_world_plate, place), _wrench(self._value(name, time) * UP)
            yield ContactForce(arm, "plate", "measured", None, point, UP, force, 0.0)
        # The cup pulls along its cable, or else along the pad's normal.
        task, outward, load = self._plan.task, T_world_plate[:3, 2], self._value(LOAD, time)
        assert isinstance(task, PlateLiftTask)
        pull = _wrench(load * (UP if task.lifter_model == "cable" else outward))
        pad = _apply(T_world_plate, self._pad)
        yield ContactForce("cup", "plate", "suction", None, pad, -outward, pull, task.cup.mu)


class ToolPlayback(Simulated):
    """A simulated suction-tool plan; its contacts are the pull of the cup and the squeeze that each hand needs."""

    def __init__(self, plan: Plan, simulation: ToolSimulation) -> None:
        super().__init__(plan, simulation, simulation.time if simulation.failed_at is None else simulation.failed_at)
        self._tracks = {name: (track.time, PoseTrack(track.poses)) for name, track in simulation.motion.bodies.items()}

    def _poses(self, time: float) -> dict[str, Array]:
        return {name: track.at(*locate(times, time)) for name, (times, track) in self._tracks.items()}

    def _forces(self, time: float, segment: int, poses: Mapping[str, Array]) -> Iterator[ContactForce]:
        T_world_tool = from_pose7(poses[TOOL_NAME])
        up, pull = T_world_tool[:3, 2], self._value(LOAD, time)
        sucked = riding_on(TOOL_NAME, self._plan.segments, segment)
        if sucked is not None and pull != 0.0:
            yield ContactForce(TOOL_NAME, sucked[0], "suction", None, T_world_tool[:3, 3], -up, _wrench(pull * up), 0.0)
        for grip in self._plan.segments[segment].grips:
            squeeze = self._value(f"{grip.arm} squeeze", time)
            if squeeze > 0.0:
                yield from _fingers(grip, T_world_tool, squeeze)


def _simulated(plan: Plan) -> Simulated | None:
    match plan.simulation:
        case None:
            return None
        case LiftSimulation() as simulation:
            return LiftPlayback(plan, simulation)
        case ToolSimulation() as simulation:
            return ToolPlayback(plan, simulation)


def objects_of_segments(segments: Sequence[Segment]) -> list[str | None]:
    """Return which object each segment of a suction-tool plan is about.

    That is the next one on the cup, or the last one while the cup leaves it.
    """
    subjects: list[str | None] = [None] * len(segments)
    following = None
    for index in range(len(segments) - 1, -1, -1):
        sucked = riding_on(TOOL_NAME, segments, index)
        following = following if sucked is None else sucked[0]
        subjects[index] = following
    last = None
    for index in range(len(segments)):
        leaves = index > 0 and segments[index - 1].kind == "detach"
        if subjects[index] is None or leaves:
            subjects[index] = last
        last = subjects[index]
    return subjects


def _fingers(grip: Grip, T_world_tool: Transform, squeeze: float) -> Iterator[ContactForce]:
    """Yield both pads, pressing with the squeeze that is needed."""
    T_world_tcp = T_world_tool @ grip.T_body_tcp
    for finger, inward in ((0, 1.0), (1, -1.0)):
        normal = inward * T_world_tcp[:3, 1]
        point = T_world_tcp[:3, 3] - 0.5 * grip.width * normal
        pressed = _wrench(squeeze * normal)
        yield ContactForce(grip.arm, TOOL_NAME, "soft_finger", finger, point, normal, pressed, 0.0)


def _wrench(force: Array) -> Array:
    """Return a force (3,) as a wrench (6,) without torque."""
    return np.concatenate([force, np.zeros(3)])


def _height(body: BodyDocument) -> float:
    assert isinstance(body.shape, Cylinder), "cup and cable are cylinders"
    return body.shape.height


def _apply(T_a_b: Transform, point: Array) -> Array:
    return T_a_b[:3, :3] @ point + T_a_b[:3, 3]
