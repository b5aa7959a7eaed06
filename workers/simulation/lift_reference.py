"""What the plan of a lift wants at any time: joints, forces, where the plate is; and how near physics comes to it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from planners.geometry.pose import Array, from_pose7
from planners.plan.plan import Plan
from planners.plan.planned_wrenches import LEAD, planned_wrenches, told_wrenches
from planners.plan.segment import SegmentKind
from planners.plan.simulation import NodeComparison
from workers.simulation.timeline import PlannedMoment, SampledTimeline

BEARERS = ("left", "right", "cup", "support")
"""Who exerts forces on the plate; "support" is whatever it rests on."""
_STANDS = np.zeros(3)
_MEAN_TIME = 0.06
"""Forces at nodes are means over so long [s]."""


class LiftReference(SampledTimeline):
    """The plan of a lift on one time axis."""

    def __init__(self, plan: Plan, pad: Array) -> None:
        """Take a solved plan, and the pad's centre (3,) in the plate's frame [m]."""
        super().__init__(plan.segments)
        poses = self.poses("plate", plan.bodies["plate"].pose)
        # Normalised one by one: together, some quaternions get another last digit, and physics makes much of it.
        self.T_world_plate = np.array([from_pose7(pose) for pose in poses])
        """(n, 4, 4)"""
        self._planned = {name: planned_wrenches(plan.segments, name) for name in BEARERS}
        told = {name: told_wrenches(plan.segments, self._planned[name]) for name in BEARERS[:3]}
        points = self.T_world_plate[:, :3, :3] @ pad + self.T_world_plate[:, :3, 3]
        first = self.table.shape[1]
        self._told = {name: slice(first + 6 * i, first + 6 * i + 6) for i, name in enumerate(told)}
        self._cup_point = slice(first + 18, first + 21)
        """Where they stand in a row."""
        self.table = np.hstack([self.table, *told.values(), points])
        self._cup_velocities = np.zeros_like(points)
        """(n, 3) from each sample to the next of its segment [m/s]."""
        widths = np.diff(self.time)
        self._cup_velocities[:-1] = np.diff(points, axis=0) / np.where(widths > 0.0, widths, np.inf)[:, None]

    def plate_rotation(self, moment: PlannedMoment) -> Array:
        """Return `R_world_plate` (3, 3), of the nearer sample."""
        return self.T_world_plate[moment.high if moment.part > 0.5 else moment.low, :3, :3]

    def cup_point(self, moment: PlannedMoment) -> Array:
        """Return where the cup pulls (3,), world [m]."""
        return moment.row[self._cup_point]

    def cup_velocity(self, moment: PlannedMoment) -> Array:
        """Return how fast that point moves (3,) [m/s]."""
        return self._cup_velocities[moment.low] if moment.high > moment.low else _STANDS

    def wrench(self, name: str, moment: PlannedMoment) -> Array | None:
        """Return what an arm or "cup" is told to exert on the plate, None when it touches nothing.

        It is as planned, but what changes from one hold to the next begins to before. (6,) about the middle of the
        contacts, world axes [N, Nm].
        """
        value = moment.row[self._told[name]]
        return None if math.isnan(value[0]) else value

    def largest_pushes(self, arm: str) -> list[float]:
        """Return for each segment how hard an arm's stick presses at most until it leaves its place, as planned [N]."""
        begins = np.cumsum([0, *(len(segment.time) for segment in self.segments)]).tolist()
        pushes, after = [0.0] * len(self.segments), None
        for number in reversed(range(len(self.segments))):
            push = self.segments[number].push
            if push is not None:
                rows = slice(begins[number], begins[number + 1])
                normals = self.T_world_plate[rows, :3, :3] @ push.normal
                along = np.nan_to_num(np.einsum("ij,ij->i", self._planned[arm][rows, :3], normals))
                stays = after is not None and np.array_equal(after.point, push.point)
                pushes[number] = max(float(along.max()), pushes[number + 1] if stays else 0.0)
            after = push
        return pushes

    def planned_forces(self, moment: PlannedMoment) -> dict[str, Array]:
        """Return the planned force (3,) of everything that touches the plate [N]."""
        forces = {name: moment.between(rows)[:3] for name, rows in self._planned.items()}
        return {name: force for name, force in forces.items() if not np.isnan(force[0])}


class NodeForcesRecorder:
    """Compares forces at the end of each motion of the plate, before the lifter prepares for what comes next."""

    def __init__(self, reference: LiftReference, step: float) -> None:
        """Prepare for moments `step` apart [s]."""
        self.nodes: list[NodeComparison] = []
        self.largest_difference = 0.0
        """[N]"""
        self._reference, self._step = reference, step
        self._ends = [self._end(index) for index in range(len(reference.segments))]
        """By segment: until when the plate moves as it is planned to [s]; None: it does not."""
        self._recent: deque[Mapping[str, Array]] = deque(maxlen=max(1, round(_MEAN_TIME / step)))

    def due(self, time: float, moment: PlannedMoment) -> bool:
        """Say whether the forces at a time [s] count."""
        end = self._ends[moment.number]
        return end is not None and end - _MEAN_TIME < time <= end + self._step

    def take(self, time: float, moment: PlannedMoment, forces: Mapping[str, Array]) -> None:
        """Take in the forces (3,) on the plate by who exerts them, when they are due [N]."""
        self._recent.append(forces)
        end = self._ends[moment.number]
        if end is None or time + self._step <= end:
            return
        if not self.nodes or self.nodes[-1].segment != moment.number:
            self._compare(time, moment)
        self._recent.clear()

    def _compare(self, time: float, moment: PlannedMoment) -> None:
        planned = self._reference.planned_forces(moment)
        simulated = {name: np.mean([row[name] for row in self._recent], axis=0) for name in planned}
        difference = max(float(np.linalg.norm(simulated[name] - force)) for name, force in planned.items())
        self.largest_difference = max(self.largest_difference, difference)
        self.nodes.append(
            NodeComparison(
                segment=moment.number,
                time=time,
                planned={name: np.round(force, 3) for name, force in planned.items()},
                simulated={name: np.round(force, 3) for name, force in simulated.items()},
                largest_difference=round(difference, 3),
            )
        )

    def _end(self, index: int) -> float | None:
        segment, last = self._reference.segments[index], index == len(self._reference.segments) - 1
        if segment.kind is not SegmentKind.TRANSFER:
            return None
        return segment.end - (0.0 if last else min(LEAD, 0.5 * float(segment.end - segment.time[0])))
