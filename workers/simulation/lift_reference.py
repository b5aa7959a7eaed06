"""What the plan of a lift wants at any time: joints, forces, where the plate is; and how near physics comes to it."""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, from_pose7
from planners.plan.contacts import Contact
from planners.plan.plan import Plan
from planners.plan.segment import Segment, SegmentKind
from planners.plan.simulation import NodeComparison
from workers.simulation.timeline import PlannedMoment, SampledTimeline

LEAD = 0.3
"""Hands and lifter begin to change what they bear so long before the plan has it change [s]."""
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
        self._planned = {name: np.concatenate([_wrenches(each, name) for each in plan.segments]) for name in BEARERS}
        borders = np.cumsum([len(segment.time) for segment in plan.segments])[:-1]
        told = {name: _begun_before(self.time, self._planned[name], borders) for name in BEARERS[:3]}
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


def _wrenches(segment: Segment, name: str) -> Array:
    """Return the (n, 6) planned wrenches of one bearer, linear in time between the contact sets; NaN: bears nothing."""
    absent = np.full(6, 0.0 if name == "cup" else np.nan)
    sets: defaultdict[int, list[Contact]] = defaultdict(list)
    for contact in segment.contacts:
        if contact.kind != "inertia" and (contact.by == name or (name, contact.kind) == ("support", "environment")):
            sets[contact.sample].append(contact)
    if not sets:
        return np.repeat(absent[None], len(segment.time), axis=0)
    samples = sorted({contact.sample for contact in segment.contacts})
    totals = np.array([_total(sets[sample]) if sample in sets else absent for sample in samples])
    if _leaves_a_stronger_contact(segment):
        # The first set still counts on the contact that the motion gives up at once.
        totals[0] = totals[1]
    return np.column_stack([np.interp(segment.time, segment.time[samples], totals[:, k]) for k in range(6)])


def _leaves_a_stronger_contact(segment: Segment) -> bool:
    counts: dict[int, int] = {}
    for contact in segment.contacts:
        counts[contact.sample] = counts.get(contact.sample, 0) + (contact.kind == "environment")
    samples = sorted(counts)
    return segment.kind is SegmentKind.TRANSFER and len(samples) > 1 and counts[samples[0]] > counts[samples[1]]


def _total(contacts: Sequence[Contact]) -> Array:
    """Return the (6,) sum of wrenches about the middle of their points."""
    points = np.array([contact.point for contact in contacts])
    wrenches = np.array([contact.wrench for contact in contacts])
    total = wrenches.sum(axis=0)
    total[3:] += np.cross(points - points.mean(axis=0), wrenches[:, :3]).sum(axis=0)
    return total


def _begun_before(time: Array, wrenches: Array, borders: NDArray[np.int64]) -> Array:
    """Let a bearer change its wrench before a segment that begins with another, not at its first instant.

    Both balance the plate as it is at the border, so all that lies between them does: friction cones are convex.
    """
    result = wrenches.copy()
    for border in borders:
        jump = np.nan_to_num(wrenches[border] - wrenches[border - 1])
        part = np.clip((time[:border] - (time[border] - LEAD)) / LEAD, 0.0, 1.0)
        result[:border] += part[:, None] * jump
    return result
