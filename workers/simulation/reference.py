"""What a plan document says should happen at any time: joints, holds, forces, and where the plate should be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, from_pose7
from workers.simulation.sampled_plan import SampledPlan, between

LEAD = 0.3
"""Hands and lifter begin to change what they bear so long before the plan has it change [s]."""


BEARERS = ("left", "right", "cup", "support")
"""Who exerts forces on the plate; "support" is whatever it rests on."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One segment of the plan, as far as hands are concerned."""

    kind: str
    begin: float
    end: float
    """[s]"""
    grip: Mapping[str, Any] | None
    push: Mapping[str, Any] | None
    """As in the document's `hold`."""
    contact: str
    """Element that touches the support: face, edge, vertex or none."""


@dataclass(frozen=True, eq=False)
class PlanReference(SampledPlan):
    """The whole plan of a lift on one time axis."""

    T_world_plate: Array
    """(n, 4, 4)"""
    stages: tuple[Stage, ...]
    planned: Mapping[str, Array]
    """By `BEARERS`: (n, 6) on the plate about the middle of its contacts, world axes; NaN: touches nothing."""
    wrenches: Mapping[str, Array]
    """What hands and lifter are told: as planned, but what changes from one hold to the next begins to before."""
    cup_points: Array
    """(n, 3) where the cup pulls, world [m]."""

    @classmethod
    def of(cls, document: Mapping[str, Any], pad: Array) -> Self:
        """Read a solved plan document; `pad` is the pad's centre (3,) in the plate's frame [m]."""
        segments = document["segments"]
        samples = SampledPlan.joined(segments)
        sizes = [len(segment["time"]) for segment in segments]
        poses, plate = [], from_pose7(document["bodies"]["plate"]["pose"])
        for segment, size in zip(segments, sizes, strict=True):
            rows = segment["body_poses"].get("plate")
            poses.append(np.repeat(plate[None], size, axis=0) if rows is None else np.array([*map(from_pose7, rows)]))
            plate = poses[-1][-1]
        T_world_plate = np.concatenate(poses)
        planned = {name: np.concatenate([_wrenches(segment, name) for segment in segments]) for name in BEARERS}
        borders = np.cumsum(sizes)[:-1]
        wrenches = {name: _begun_before(samples.time, planned[name], borders) for name in (*BEARERS[:2], "cup")}
        return cls(
            time=samples.time,
            positions=samples.positions,
            velocities=samples.velocities,
            segment_of=samples.segment_of,
            T_world_plate=T_world_plate,
            stages=tuple(_stage(segment) for segment in segments),
            planned=planned,
            wrenches=wrenches,
            cup_points=T_world_plate[:, :3, :3] @ pad + T_world_plate[:, :3, 3],
        )

    def at(self, time: float) -> Moment:
        """Return what should be at a time [s], held after the end."""
        return Moment(self, *self.locate(time))


@dataclass(frozen=True, eq=False)
class Moment:
    """One instant of a plan, between two of its samples."""

    reference: PlanReference
    low: int
    high: int
    part: float

    @property
    def stage(self) -> Stage:
        """The segment that it is in."""
        return self.reference.stages[self.reference.segment_of[self.low]]

    @property
    def positions(self) -> Array:
        """(12,) [rad]."""
        return self._between(self.reference.positions)

    @property
    def velocities(self) -> Array:
        """(12,) [rad/s]."""
        return self._between(self.reference.velocities)

    @property
    def rotation_world_plate(self) -> Array:
        """(3, 3), of the nearer sample."""
        return self.reference.T_world_plate[self.high if self.part > 0.5 else self.low, :3, :3]

    @property
    def cup_point(self) -> Array:
        """(3,) [m]."""
        return self._between(self.reference.cup_points)

    @property
    def cup_velocity(self) -> Array:
        """(3,) [m/s]."""
        if self.low == self.high:
            return np.zeros(3)
        points, time = self.reference.cup_points, self.reference.time
        return (points[self.high] - points[self.low]) / (time[self.high] - time[self.low])

    def wrench(self, name: str) -> Array | None:
        """Return the (6,) wrench that an arm or "cup" is told to exert on the plate, None when it touches nothing."""
        value = self._between(self.reference.wrenches[name])
        return None if np.isnan(value[0]) else value

    def planned_forces(self) -> dict[str, Array]:
        """Return the planned force (3,) of everything that touches the plate [N]."""
        forces = {name: self._between(rows)[:3] for name, rows in self.reference.planned.items()}
        return {name: force for name, force in forces.items() if not np.isnan(force[0])}

    def _between(self, rows: Array) -> Array:
        return between(rows, (self.low, self.high, self.part))


_STANDS = ("support", "environment")


def _stage(segment: Mapping[str, Any]) -> Stage:
    hold = segment["hold"] or {"grip": None, "push": None}
    time = segment["time"]
    return Stage(segment["kind"], time[0], time[-1], hold["grip"], hold["push"], segment["contact_state"]["element"])


def _wrenches(segment: Mapping[str, Any], name: str) -> Array:
    """Return the (n, 6) planned wrenches of one bearer, linear in time between the contact sets."""
    time = np.array(segment["time"])
    sets: dict[int, list[Mapping[str, Any]]] = {}
    for contact in segment["contacts"]:
        if contact["kind"] != "inertia" and (contact["by"] == name or (name, contact["kind"]) == _STANDS):
            sets.setdefault(contact["sample"], []).append(contact)
    absent = np.full(6, 0.0 if name == "cup" else np.nan)
    if not sets:
        return np.repeat(absent[None], len(time), axis=0)
    samples = sorted({contact["sample"] for contact in segment["contacts"]})
    totals = np.array([_total(sets[sample]) if sample in sets else absent for sample in samples])
    if _leaves_a_stronger_contact(segment) and len(samples) > 1:
        # The first set still counts on the contact that the motion gives up at once.
        totals[0] = totals[1]
    return np.column_stack([np.interp(time, time[samples], totals[:, k]) for k in range(6)])


def _leaves_a_stronger_contact(segment: Mapping[str, Any]) -> bool:
    counts: dict[int, int] = {}
    for contact in segment["contacts"]:
        counts[contact["sample"]] = counts.get(contact["sample"], 0) + (contact["kind"] == "environment")
    samples = sorted(counts)
    return segment["kind"] == "transfer" and len(samples) > 1 and counts[samples[0]] > counts[samples[1]]


def _total(contacts: Sequence[Mapping[str, Any]]) -> Array:
    """Return the (6,) sum of wrenches about the middle of their points."""
    points = np.array([contact["point"] for contact in contacts])
    wrenches = np.array([contact["wrench"] for contact in contacts])
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
