"""What a plan document says at a moment: joints, grippers, bodies and contacts, between the samples too."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from planners.geometry.pose import Array


@dataclass(frozen=True, eq=False)
class Touch:
    """One contact force at a moment, in world axes."""

    by: str
    """An arm, the cup, or the name of a body."""
    body: str
    """Which the force acts on."""
    kind: str
    """As in a plan document: soft_finger, point, environment or suction; or measured, of a simulated hand."""
    finger: int | None
    point: Array
    """(3,) [m]."""
    normal: Array
    """(3,) into the body."""
    force: Array
    """(3,) that `by` exerts on `body` [N]."""
    mu: float
    suction_force: float | None
    """What the cup holds with, for suction [N]."""
    limit: float | None
    """[N]"""

    @property
    def place(self) -> tuple[str, str, str, int | None]:
        """What it has in common with itself at another moment."""
        return self.by, self.body, self.kind, self.finger


def by_hand(touches: Iterable[Touch]) -> list[Touch]:
    """Put one force in place of those of a hand's fingers on a body, midway between them.

    That is what the hand bears, without its squeeze.
    """
    result, fingers = list[Touch](), defaultdict[tuple[str, str], list[Touch]](list)
    for touch in touches:
        if touch.kind == "soft_finger":
            fingers[touch.by, touch.body].append(touch)
        else:
            result.append(touch)
    for pair in fingers.values():
        point = np.mean([touch.point for touch in pair], axis=0)
        result.append(replace(pair[0], finger=None, point=point, force=np.sum([touch.force for touch in pair], axis=0)))
    return result


@dataclass(frozen=True, eq=False)
class ContactSet:
    """All contacts of one sample."""

    time: float
    """[s]"""
    touches: tuple[Touch, ...]


@dataclass(frozen=True, eq=False)
class Moment:
    """Where everything is at one time."""

    time: float
    """[s]"""
    segment: int | None
    """Which segment of the plan runs, the last one after its end; None in a plan without segments."""
    positions: Array
    """(12,) [rad], left arm first."""
    widths: dict[str, float]
    """Opening of each gripper by arm [m]."""
    body_poses: dict[str, Array]
    """(7,) `[x, y, z, w, x, y, z]` of every body in the world, by name."""
    touches: tuple[Touch, ...]


class Timeline:
    """A plan document, to be asked for any time in [0, `duration`]; times outside are taken to the nearer end.

    Joints follow the cubic Hermite curve through positions and velocities of the samples, as a plan document states.
    Bodies move straight and turn evenly between samples. A contact is drawn between two sets of one segment where
    both list it.
    """

    def __init__(self, document: Mapping[str, Any], rest_positions: Array) -> None:
        """Read a document.

        Args:
            document: a plan document.
            rest_positions: (12,) where the joints are when there are no segments [rad].
        """
        self._rest = np.asarray(rest_positions, dtype=float)
        self._bodies = {name: np.array(body["pose"]) for name, body in document["bodies"].items()}
        self._segments = [_SegmentSamples(segment) for segment in document["segments"]]

    @property
    def duration(self) -> float:
        """When the last segment ends [s]."""
        return self._segments[-1].end if self._segments else 0.0

    @cached_property
    def starts(self) -> tuple[float, ...]:
        """When each segment starts [s]."""
        return tuple(segment.start for segment in self._segments)

    @cached_property
    def contact_sets(self) -> tuple[ContactSet, ...]:
        """Every contact set in order of time; where two segments meet there are two."""
        return tuple(contact_set for segment in self._segments for contact_set in segment.sets)

    def at(self, time: float) -> Moment:
        """Return where everything is at `time` [s]."""
        time = float(min(max(time, 0.0), self.duration))
        if not self._segments:
            return Moment(time, None, self._rest, {}, dict(self._bodies), ())
        index = bisect_right(self.starts, time) - 1
        segment = self._segments[index]
        sample, fraction = segment.locate(time)
        return Moment(
            time,
            index,
            segment.joint_positions(sample, fraction),
            segment.gripper_widths(sample, fraction),
            self._body_poses(index, sample, fraction),
            segment.touches(time),
        )

    def _body_poses(self, index: int, sample: int, fraction: float) -> dict[str, Array]:
        here = self._segments[index].body_poses
        moving = {name: between_poses(rows[sample], rows[sample + 1], fraction) for name, rows in here.items()}
        return {**self._rest_poses[index], **moving}

    @cached_property
    def _rest_poses(self) -> list[dict[str, Array]]:
        """Where bodies are that do not move in a segment: where an earlier one left them."""
        poses, before = dict(self._bodies), []
        for segment in self._segments:
            before.append(poses)
            poses = {**poses, **{name: rows[-1] for name, rows in segment.body_poses.items()}}
        return before


class _SegmentSamples:
    """The arrays of one segment."""

    def __init__(self, segment: Mapping[str, Any]) -> None:
        self.time = np.array(segment["time"], dtype=float)
        self.start, self.end = float(self.time[0]), float(self.time[-1])
        self.positions = np.array(segment["positions"], dtype=float)
        self.velocities = np.array(segment["velocities"], dtype=float)
        self.widths = {arm: np.array(widths, dtype=float) for arm, widths in segment["gripper_width"].items()}
        self.body_poses = {name: np.array(rows, dtype=float) for name, rows in segment["body_poses"].items()}
        self.sets = _contact_sets(segment["contacts"], self.time)

    def locate(self, time: float) -> tuple[int, float]:
        """Return the sample at or before `time`, but the last, and how far `time` is on the way to the next."""
        sample = int(np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2))
        step = self.time[sample + 1] - self.time[sample]
        return sample, float(np.clip((time - self.time[sample]) / step, 0.0, 1.0))

    def joint_positions(self, sample: int, s: float) -> Array:
        """Return the cubic Hermite value (12,) at the fraction `s` of a step [rad]."""
        step = self.time[sample + 1] - self.time[sample]
        p0, p1 = self.positions[sample], self.positions[sample + 1]
        m0, m1 = step * self.velocities[sample], step * self.velocities[sample + 1]
        return (
            (2 * s**3 - 3 * s**2 + 1) * p0
            + (s**3 - 2 * s**2 + s) * m0
            + (3 * s**2 - 2 * s**3) * p1
            + (s**3 - s**2) * m1
        )

    def gripper_widths(self, sample: int, s: float) -> dict[str, float]:
        return {arm: float((1 - s) * widths[sample] + s * widths[sample + 1]) for arm, widths in self.widths.items()}

    def touches(self, time: float) -> tuple[Touch, ...]:
        """Return the contacts at `time`: those of the set before it, on their way to the set after it."""
        times = [contact_set.time for contact_set in self.sets]
        before = bisect_right(times, time) - 1
        if before < 0:
            return ()
        if before + 1 == len(times):
            return self.sets[before].touches
        a, b = self.sets[before], self.sets[before + 1]
        s = (time - a.time) / (b.time - a.time)
        if [touch.place for touch in a.touches] != [touch.place for touch in b.touches]:
            return a.touches
        return tuple(_between_touches(*pair, s) for pair in zip(a.touches, b.touches, strict=True))


def _contact_sets(contacts: Sequence[Mapping[str, Any]], time: Array) -> tuple[ContactSet, ...]:
    real = sorted((c for c in contacts if c["kind"] != "inertia"), key=lambda contact: contact["sample"])
    return tuple(
        ContactSet(float(time[sample]), tuple(_touch(contact) for contact in group))
        for sample, group in groupby(real, key=lambda contact: contact["sample"])
    )


def _touch(contact: Mapping[str, Any]) -> Touch:
    return Touch(
        by=contact["by"],
        body=contact["body"],
        kind=contact["kind"],
        finger=contact["finger"],
        point=np.array(contact["point"], dtype=float),
        normal=np.array(contact["normal"], dtype=float),
        force=np.array(contact["wrench"][:3], dtype=float),
        mu=float(contact["mu"]),
        suction_force=contact.get("suction_force"),
        limit=contact.get("limit"),
    )


def _between_touches(a: Touch, b: Touch, s: float) -> Touch:
    normal = (1 - s) * a.normal + s * b.normal
    suction = None
    if a.suction_force is not None and b.suction_force is not None:
        suction = (1 - s) * a.suction_force + s * b.suction_force
    return replace(
        a,
        point=(1 - s) * a.point + s * b.point,
        normal=normal / np.linalg.norm(normal),
        force=(1 - s) * a.force + s * b.force,
        suction_force=suction,
    )


def between_poses(a: Array, b: Array, s: float) -> Array:
    """Return the pose (7,) at the fraction `s`: straight for the position, along the great arc for the quaternion."""
    q0, q1 = a[3:], b[3:]
    cosine = float(q0 @ q1)
    if cosine < 0.0:
        q1, cosine = -q1, -cosine
    angle = float(np.arccos(min(cosine, 1.0)))
    if angle < 1e-6:
        quaternion = (1 - s) * q0 + s * q1
    else:
        quaternion = (np.sin((1 - s) * angle) * q0 + np.sin(s * angle) * q1) / np.sin(angle)
    return np.concatenate([(1 - s) * a[:3] + s * b[:3], quaternion / np.linalg.norm(quaternion)])
