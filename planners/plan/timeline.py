"""A plan at any time, between its samples too: joints, grippers, bodies and contact forces."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from operator import itemgetter

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from planners.geometry.pose import Array
from planners.plan.contacts import BearingContact, InertiaEntry
from planners.plan.scenery import JOINT_NAMES, BodyDocument
from planners.plan.segment import Segment


@dataclass(frozen=True, eq=False)
class ContactForce:
    """What one contact exerts at a moment, in world axes."""

    by: str
    """An arm, the cup, the tool, or the name of a body."""
    body: str
    """Which the force acts on."""
    kind: str
    """As in a plan: soft_finger, point, environment or suction; or measured, of a simulated hand."""
    finger: int | None
    point: Array
    """(3,) [m]."""
    normal: Array
    """(3,) unit vector into the body."""
    wrench: Array
    """(6,) that `by` exerts on `body`: force [N], and torque about `point` [Nm]."""
    mu: float
    """Friction coefficient [1]."""

    @property
    def force(self) -> Array:
        """(3,) that `by` exerts on `body` [N]."""
        return self.wrench[:3]

    @classmethod
    def of(cls, contact: BearingContact) -> ContactForce:
        """Return what a contact of a plan exerts."""
        return cls(
            contact.by,
            contact.body,
            contact.kind,
            contact.finger,
            contact.point,
            contact.normal,
            contact.wrench,
            contact.mu,
        )

    def is_at(self, other: ContactForce) -> bool:
        """Tell whether it is the same contact at another moment."""
        mine, theirs = ((each.by, each.body, each.kind, each.finger) for each in (self, other))
        return mine == theirs

    def between(self, other: ContactForce, fraction: float) -> ContactForce:
        """Return what it exerts on its way to another moment; `fraction` runs from 0 to 1."""
        normal = mix(self.normal, other.normal, fraction)
        return replace(
            self,
            point=mix(self.point, other.point, fraction),
            normal=normal / np.linalg.norm(normal),
            wrench=mix(self.wrench, other.wrench, fraction),
        )


@dataclass(frozen=True, eq=False)
class ContactSet:
    """All contacts of one sample."""

    time: float
    """[s]"""
    contacts: tuple[BearingContact, ...]


@dataclass(frozen=True, eq=False)
class Moment:
    """Where everything is at one time."""

    time: float
    """[s]"""
    segment: int | None
    """Which segment of the plan runs, the last one after its end; None in a plan without segments."""
    positions: Array
    """(12,) [rad], left arm first; NaN in a plan without segments whose task leaves the start to the cell."""
    widths: dict[str, float]
    """Opening of each gripper by arm [m]."""
    body_poses: dict[str, Array]
    """(7,) `[x, y, z, w, x, y, z]` of every body in the world, by name."""
    contacts: tuple[ContactForce, ...]


class Timeline:
    """What is where at any time in [0, `duration`]; times outside are taken to the nearer end.

    Joints follow the cubic Hermite curve through positions and velocities of the samples, as a plan document states.
    Bodies move straight and turn evenly between samples (slerp). What a contact exerts runs straight between two sets
    of one segment that list the same contacts; else the earlier set counts.
    """

    def __init__(
        self, segments: Sequence[Segment], bodies: Mapping[str, BodyDocument], start_positions: Sequence[float] | None
    ) -> None:
        """Take segments of one plan in order, its bodies as they are at the start, and the task's start positions.

        `start_positions` (12,) [rad] count without segments only; None: the cell's home, which a plan does not state.
        """
        self._start = np.full(len(JOINT_NAMES), np.nan) if start_positions is None else np.array(start_positions)
        self._bodies = {name: body.pose for name, body in bodies.items()}
        self._segments = [_SegmentCurves(segment) for segment in segments]
        self._starts = [float(segment.time[0]) for segment in segments]
        self.duration = segments[-1].end if segments else 0.0
        """When the last segment ends [s]."""

    @cached_property
    def contact_sets(self) -> tuple[ContactSet, ...]:
        """Every contact set in order of time; where two segments meet there are two."""
        return tuple(contact_set for segment in self._segments for contact_set in segment.contact_sets)

    def at(self, time: float) -> Moment:
        """Return where everything is at `time` [s]."""
        time = float(min(max(time, 0.0), self.duration))
        if not self._segments:
            return Moment(time, None, self._start, {}, dict(self._bodies), ())
        index = max(bisect_right(self._starts, time) - 1, 0)
        segment = self._segments[index]
        sample, fraction = locate(segment.time, time)
        return Moment(
            time,
            index,
            segment.joint_positions(sample, fraction),
            segment.gripper_widths(sample, fraction),
            {**self._resting[index], **segment.body_poses(sample, fraction)},
            segment.contact_forces(time),
        )

    @cached_property
    def _resting(self) -> list[dict[str, Array]]:
        """By segment: where bodies are that do not move in it, as an earlier one left them."""
        poses, before = dict(self._bodies), []
        for segment in self._segments:
            before.append(poses)
            poses = {**poses, **{name: track.poses[-1] for name, track in segment.tracks.items()}}
        return before


class PoseTrack:
    """Poses of one body by sample, read between the samples too."""

    def __init__(self, poses: Array) -> None:
        """Take poses (n, 7) `[x, y, z, w, x, y, z]`."""
        self.poses = poses

    @cached_property
    def _turns(self) -> Slerp:
        return Slerp(np.arange(len(self.poses)), Rotation.from_quat(self.poses[:, 3:], scalar_first=True))

    def at(self, sample: int, fraction: float) -> Array:
        """Return the pose (7,) at a fraction of the way from one sample to the next: straight, and turning evenly."""
        following = min(sample + 1, len(self.poses) - 1)
        a, b = self.poses[sample], self.poses[following]
        if fraction == 0.0 or np.array_equal(a, b):
            return a
        quaternion = self._turns(sample + fraction).as_quat(scalar_first=True)
        return np.concatenate([mix(a[:3], b[:3], fraction), quaternion])


class _SegmentCurves:
    """One segment, read between its samples."""

    def __init__(self, segment: Segment) -> None:
        self._segment = segment
        self.time = segment.time
        self.tracks = {name: PoseTrack(poses) for name, poses in segment.body_poses.items()}

    def joint_positions(self, sample: int, s: float) -> Array:
        """Return the cubic Hermite value (12,) at the fraction `s` of a step [rad]."""
        time, positions, velocities = self._segment.time, self._segment.positions, self._segment.velocities
        step = time[sample + 1] - time[sample]
        p0, p1 = positions[sample], positions[sample + 1]
        m0, m1 = step * velocities[sample], step * velocities[sample + 1]
        return (
            (2 * s**3 - 3 * s**2 + 1) * p0
            + (s**3 - 2 * s**2 + s) * m0
            + (3 * s**2 - 2 * s**3) * p1
            + (s**3 - s**2) * m1
        )

    def gripper_widths(self, sample: int, s: float) -> dict[str, float]:
        return {
            arm: float(mix(widths[sample], widths[sample + 1], s))
            for arm, widths in self._segment.gripper_width.items()
        }

    def body_poses(self, sample: int, s: float) -> dict[str, Array]:
        return {name: track.at(sample, s) for name, track in self.tracks.items()}

    @cached_property
    def contact_sets(self) -> tuple[ContactSet, ...]:
        borne = [contact for contact in self._segment.contacts if not isinstance(contact, InertiaEntry)]
        by_sample = groupby(sorted(borne, key=lambda contact: contact.sample), key=lambda contact: contact.sample)
        return tuple(ContactSet(float(self._segment.time[sample]), tuple(group)) for sample, group in by_sample)

    @cached_property
    def _forces(self) -> list[tuple[float, tuple[ContactForce, ...]]]:
        """Time and forces of each contact set."""
        return [(each.time, tuple(map(ContactForce.of, each.contacts))) for each in self.contact_sets]

    def contact_forces(self, time: float) -> tuple[ContactForce, ...]:
        """Return what contacts exert at `time`: those of the set before it, on their way to the set after it."""
        before = bisect_right(self._forces, time, key=itemgetter(0)) - 1
        if before < 0:
            return ()
        begin, earlier = self._forces[before]
        if before + 1 == len(self._forces):
            return earlier
        end, later = self._forces[before + 1]
        if len(earlier) != len(later) or not all(map(ContactForce.is_at, earlier, later)):
            return earlier
        s = (time - begin) / (end - begin)
        return tuple(a.between(b, s) for a, b in zip(earlier, later, strict=True))


def locate(times: Array, time: float) -> tuple[int, float]:
    """Return the sample at or before a time, but the last of several, and how far the time is on the way to the next.

    Args:
        times: (n,) of the samples, rising [s].
        time: [s]; one before the first sample or after the last is taken to that.

    Returns:
        The sample, from 0, and a fraction, 0 to 1.
    """
    sample = max(min(int(np.searchsorted(times, time, side="right")) - 1, len(times) - 2), 0)
    step = times[min(sample + 1, len(times) - 1)] - times[sample]
    return sample, float(np.clip((time - times[sample]) / step, 0.0, 1.0)) if step > 0.0 else 0.0


def mix(a: Array, b: Array, fraction: float) -> Array:
    """Return what is at a fraction, 0 to 1, of the straight way from `a` to `b`."""
    return (1.0 - fraction) * a + fraction * b
