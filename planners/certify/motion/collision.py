"""Collision over the continuous motion, by directions along which solids keep apart.

Points that go straight keep the gap between two solids, along a direction that does not turn, above the smaller of the
gaps at both ends: the gap is the least of what differences of points have along it, and each of these changes steadily.
So one direction proves all steps of a motion at whose ends the gap along it is larger than what points stray from
straight ways, which is of second order in the step. How fast the solids pass one another costs nothing; what remains is
looked at along directions of its own, between samples too, until it is proven or a penetration is found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.certify.finding import Finding
from planners.certify.motion.gap import gaps_along
from planners.certify.motion.segment_motion import SegmentMotion, chord_lengths, relative
from planners.certify.motion.solids import ConvexSolid, Frame, separation
from planners.certify.plan_view import NumberedSegment, PlanView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.verdicts import Check

_BLOCK = 16
"""Samples whose boxes are compared at once."""
_AT_REST = np.eye(4)[None]


def can_meet(a: ConvexSolid, b: ConvexSolid, static: frozenset[str]) -> bool:
    """Whether a pair of solids has to be looked at.

    Left out: solids of one arm at most one joint apart, hands counting as their flange (they can only turn about a
    common axis, and their hulls overlap there by design); the base links and the table and frame they are bolted to,
    which no motion changes; two static bodies; parts of one body; and the cable with anything but arms.
    """
    if a.arm is not None and b.arm is not None:
        return a.arm != b.arm or abs(a.frame.link - b.frame.link) > 1
    if a.arm is None and b.arm is None:
        if a.frame.owner == b.frame.owner or "cable" in (a.group, b.group):
            return False
        return not (a.frame.owner in static and b.frame.owner in static)
    robot, body = (a, b) if a.arm is not None else (b, a)
    return not (robot.frame.link == 0 and body.group in ("table", "frame"))


def pairs_of(solids: Sequence[ConvexSolid], static: frozenset[str]) -> list[tuple[int, int]]:
    """Return the index pairs (i < j) of the solids that can meet."""
    return [
        (i, j) for i in range(len(solids)) for j in range(i + 1, len(solids)) if can_meet(solids[i], solids[j], static)
    ]


@dataclass(frozen=True)
class TouchRule:
    """Which pairs may touch during one segment; no two parts of the robot may."""

    gripped: Set[tuple[str, str]]
    """Arm and body: its pads and fingers may touch it."""
    pushed: Set[tuple[str, str]]
    """Arm and body: its tip may touch it."""
    bodies: Set[frozenset[str]]
    """Pairs of bodies."""

    def allows(self, a: ConvexSolid, b: ConvexSolid) -> bool:
        """Whether the two may touch."""
        if a.arm is not None and b.arm is not None:
            return False
        if a.arm is None and b.arm is None:
            return frozenset({a.frame.owner, b.frame.owner}) in self.bodies
        part, body = (a, b) if a.arm is not None else (b, a)
        pair = part.frame.owner, body.frame.owner
        return (part.group in ("pad", "finger") and pair in self.gripped) or (
            part.group == "tip" and pair in self.pushed
        )


def holds_around(plan: PlanView, segment: NumberedSegment) -> list[NumberedSegment]:
    """Return the segments whose holds count: also the next while a hand comes, and the last while it leaves."""
    around = [segment]
    if segment.kind in ("grip", "approach") and segment.index + 1 < len(plan.segments):
        around.append(plan.segments[segment.index + 1])
    if segment.kind in ("release", "retreat") and segment.index > 0:
        around.append(plan.segments[segment.index - 1])
    return around


class PairMotion:
    """How two solids move relative to one another during a segment.

    Directions, ways and what strays from them are those of one frame: the first solid's where both are on one arm or
    may touch, else the world. Solids that move together then hardly move.
    """

    def __init__(self, motion: SegmentMotion, a: ConvexSolid, b: ConvexSolid, touching: bool) -> None:
        anchors = motion.anchor(a.frame), motion.anchor(b.frame)
        self._motion = motion
        self._one_arm = anchors[0] is not None and anchors[1] is not None and anchors[0][0] == anchors[1][0]
        self._relative = self._one_arm or touching
        if self._relative and self._second_is_the_base(anchors, a, b):
            a, b, anchors = b, a, anchors[::-1]
        self.a, self.b = a, b
        far = b.far
        if self._relative:
            poses = _AT_REST, relative(motion.poses(a.frame), motion.poses(b.frame))
            ways = chord_lengths(poses[1], b.centre, b.bound)
            ways = ways + motion.finger_travel(a.frame) + motion.finger_travel(b.frame)
            self._turn = np.zeros(1) if self._one_arm else motion.turn(a.frame)
            if self._one_arm:
                assert anchors[0] is not None
                bend = motion.stray(b.frame, far, anchors[0][1])
            else:
                # A point of b and the point of a that it is beside: both stray from their straight ways, and what is
                # between them turns with a.
                bend = motion.stray(b.frame, far)
                reach = np.linalg.norm(poses[1][:, :3, :3] @ b.centre + poses[1][:, :3, 3], axis=1).max()
                beside = float(reach + b.bound + ways.max(initial=0.0) + np.max(bend, initial=0.0))
                bend = motion.stray(a.frame, beside) + bend + self._turn * ways
            self._moves = bool(np.any(ways) or np.any(bend))
        else:
            poses = motion.poses(a.frame), motion.poses(b.frame)
            bend = motion.stray(a.frame, a.far) + motion.stray(b.frame, far)
            self._turn = np.zeros(1)
            self._moves = motion.moves(a.frame) or motion.moves(b.frame)
        self._poses = poses
        self._turn = np.broadcast_to(self._turn, (motion.samples - 1,))
        self._bend = np.broadcast_to(bend, (motion.samples - 1,))

    @property
    def moves(self) -> bool:
        """Whether the two move relative to one another at all."""
        return self._moves

    def _second_is_the_base(self, anchors: tuple[tuple[str, int] | None, ...], a: ConvexSolid, b: ConvexSolid) -> bool:
        if self._one_arm and anchors[0] is not None and anchors[1] is not None:
            return anchors[0][1] > anchors[1][1]
        return a.bound < b.bound

    def separation(self, interval: int, u: float) -> tuple[float, Array]:
        """Return the signed distance at a fraction of an interval [m], and the direction along which it is."""
        poses = [self._pose(solid.frame, interval, u) for solid in (self.a, self.b)]
        gap, direction = separation(self.a, poses[0], self.b, poses[1])
        return gap, poses[0][:3, :3].T @ direction if self._relative else direction

    def distance(self, interval: int, u: float) -> float:
        """Return the signed distance at a fraction of an interval; at a sample for u = 0 [m]."""
        return self.separation(interval, u)[0]

    def gaps(self, direction: Array, first: int, last: int) -> Array:
        """Return the gaps along a direction at a run of samples, both ends included: (last - first + 1,) [m]."""
        poses = [each if len(each) == 1 else each[first : last + 1] for each in self._poses]
        return self._along(direction, poses, last - first + 1)

    def kept(self, gaps: Array, first: int) -> Array:
        """Return what is left, between neighbouring samples, of (n + 1,) gaps from sample `first` on: (n,) [m]."""
        return np.minimum(gaps[:-1], gaps[1:]) - self._bend[first : first + len(gaps) - 1]

    def kept_within(self, direction: Array, interval: int, start: float, end: float) -> float:
        """Return what is left of the gap along a direction during a part of an interval [m]."""
        first, second = self._ends(interval, start, end)
        if self._relative:
            T_a_b = relative(first, second)
            gaps = self._along(direction, [_AT_REST, T_a_b], 2)
            twist = float(self._turn[interval]) * float(chord_lengths(T_a_b, self.b.centre, self.b.bound)[0])
        else:
            gaps, twist = self._along(direction, [first, second], 2), 0.0
        bend = float(self._bend[interval]) * (end - start) ** 2 + twist * (end - start)
        return float(gaps.min()) - bend - self._finger_travel(interval, start, end)

    def within(self, interval: int, start: float, end: float) -> float:
        """Return how much the two move and stray during a part of an interval [m]."""
        stray = 2 * float(self._bend[interval]) * (end - start) ** 2
        if not self._relative:
            way = sum(self._motion.way(solid, interval, start, end) for solid in (self.a, self.b))
            return stray + way
        T_a_b = relative(*self._ends(interval, start, end))
        way = float(chord_lengths(T_a_b, self.b.centre, self.b.bound)[0])
        return stray + way + self._finger_travel(interval, start, end)

    def _along(self, direction: Array, poses: Sequence[Array], count: int) -> Array:
        gaps = gaps_along(direction, self.a.points, poses[0], self.b.points, poses[1])
        return np.broadcast_to(gaps, (count,)) - self.a.radius - self.b.radius

    def _ends(self, interval: int, start: float, end: float) -> tuple[Array, Array]:
        first, second = (
            np.stack([self._pose(solid.frame, interval, u) for u in (start, end)]) for solid in (self.a, self.b)
        )
        return first, second

    def _finger_travel(self, interval: int, start: float, end: float) -> float:
        solids = (self.a, self.b)
        return sum(self._motion.finger_travel_between(solid.frame, interval, start, end) for solid in solids)

    def _pose(self, frame: Frame, interval: int, u: float) -> Array:
        if u == 1.0:
            interval, u = interval + 1, 0.0
        if u != 0.0:
            return self._motion.pose(frame, interval, u)
        poses = self._motion.poses(frame)
        return poses[interval if len(poses) > 1 else 0]


class _Moment(NamedTuple):
    """A moment between two samples at which a pair was looked at."""

    u: float
    """Fraction of the interval [1]."""
    clear: float
    """How clear the two are [m]."""
    direction: Array
    """Along which they are."""


class _NotProven(Exception):
    """A pair needs more distances than its motion is given."""


@dataclass(eq=False)
class _PairCheck:
    """Looks at one pair during one segment."""

    pair: PairMotion
    finding: Finding
    allowance: float
    """Penetration that is none [m]."""
    smallest_motion: float
    left: int
    """Distances that may still be computed."""
    where: Callable[[int, float], str]

    def clearance(self, interval: int, u: float) -> tuple[float, Array]:
        """Return how clear the two are at a moment [m], and the direction; the finding notes it.

        Raises:
            _NotProven: No distance is left.
        """
        if self.left <= 0:
            raise _NotProven
        self.left -= 1
        gap, direction = self.pair.separation(interval, u)
        self.finding.note(gap + self.allowance, lambda: self.where(interval, u))
        return gap + self.allowance, direction

    def is_clear(self, start: int, end: int) -> bool:
        """Prove a run of samples; False when a penetration was found (and noted)."""
        stretches = [(start, end)]
        while stretches:
            first, last = stretches.pop()
            middle = (first + last) // 2
            clear, direction = self.clearance(middle, 0.0)
            if clear < 0.0:
                return False
            gaps = self.pair.gaps(direction, first, last) + self.allowance
            least = int(np.argmin(gaps))
            # The distance may be smaller there than here: it is what the certificate tells.
            if 0.0 < gaps[least] < self.finding.margin and self.clearance(first + least, 0.0)[0] < 0.0:
                return False
            open_steps = ~(self.pair.kept(gaps, first) > 0.0)
            for a, b in _runs(open_steps):
                if b - a == 1:
                    if not self._is_clear_within(first + a):
                        return False
                elif b - a < last - first:
                    stretches.append((first + a, first + b))
                else:
                    stretches += [(middle, last), (first, middle)]
        return True

    def _is_clear_within(self, interval: int) -> bool:
        """Prove the motion between two neighbouring samples."""

        def looked_at(u: float) -> _Moment:
            return _Moment(u, *self.clearance(interval, u))

        stretches = [(looked_at(0.0), looked_at(1.0))]
        if min(moment.clear for moment in stretches[0]) < 0.0:
            return False
        while stretches:
            first, last = stretches.pop()
            span = interval, first.u, last.u
            kept = (self.pair.kept_within(moment.direction, *span) for moment in (first, last))
            # That a nan is not small keeps it from being proven.
            if any(k + self.allowance > 0.0 for k in kept) or self.pair.within(*span) < self.smallest_motion:
                continue
            middle = looked_at((first.u + last.u) / 2)
            if middle.clear < 0.0:
                return False
            stretches += [(middle, last), (first, middle)]
        return True


class CollisionCheck:
    """Looks at every pair in every segment."""

    def __init__(
        self,
        plan: PlanView,
        solids: Sequence[ConvexSolid],
        rule_of: Callable[[NumberedSegment], TouchRule],
        settings: CertifySettings,
    ) -> None:
        self._rule_of, self._solids, self._settings = rule_of, solids, settings
        static = frozenset(name for name, body in plan.bodies.items() if body.static)
        self._pairs = np.array(pairs_of(solids, static), dtype=int).reshape(-1, 2)
        self._free = Finding("collision", "m")
        self._touch = Finding("touch_depth", "m")
        self._given_up = False
        self._frames = tuple(dict.fromkeys(solid.frame for solid in solids))
        self._versions: dict[Frame, int] = {}
        self._seen: dict[tuple[int, int], tuple[int, int, bool]] = {}
        self._boxes: dict[int, tuple[int, Array, Array]] = {}

    def run(self, motions: Sequence[SegmentMotion]) -> list[Check]:
        """Return the two checks: pairs that must stay apart, and pairs that may touch."""
        for motion in motions:
            self._segment(motion)
        return [self._free.check(), self._touch.check()]

    def _segment(self, motion: SegmentMotion) -> None:
        rule = self._rule_of(motion.segment)
        moving = {frame: motion.moves(frame) for frame in self._frames}
        for frame, moves in moving.items():
            self._versions[frame] = self._versions.get(frame, 0) + moves
        near = self._near_blocks(motion, moving)
        for row in np.flatnonzero(near.any(axis=1)):
            if self._given_up:
                return
            i, j = self._pairs[row]
            a, b = self._solids[i], self._solids[j]
            touching = rule.allows(a, b)
            version = (self._versions[a.frame], self._versions[b.frame], touching)
            still = not moving[a.frame] and not moving[b.frame]
            if still and self._seen.get((i, j)) == version:
                continue
            self._seen[i, j] = version
            self._pair(motion, a, b, touching, None if still else near[row])

    def _pair(
        self, motion: SegmentMotion, a: ConvexSolid, b: ConvexSolid, touching: bool, near: NDArray[np.bool_] | None
    ) -> None:
        settings = self._settings
        finding = self._touch if touching else self._free
        pair = PairMotion(motion, a, b, touching)
        check = _PairCheck(
            pair=pair,
            finding=finding,
            allowance=settings.touch_depth if touching else 0.0,
            smallest_motion=settings.smallest_motion,
            left=settings.distances_per_step * (motion.samples - 1),
            where=lambda interval, u: self._where(motion, a, b, interval, u),
        )
        try:
            if near is None or not pair.moves:
                check.clearance(0, 0.0)
                return
            for start, end in _runs(np.repeat(near, _BLOCK)[: motion.samples - 1]):
                if not check.is_clear(start, end):
                    return
        except _NotProven:
            most = settings.distances_per_step
            place = self._where(motion, a, b, 0, 0.0)
            finding.note(-1.0, f"{place}: not proven with {most} distances a step; nothing else was looked at")
            self._given_up = True

    def _near_blocks(self, motion: SegmentMotion, moving: Mapping[Frame, bool]) -> NDArray[np.bool_]:
        """Return which pairs' boxes meet in which blocks of samples: (pairs, blocks)."""
        starts = np.arange(0, motion.samples - 1, _BLOCK)
        low = np.empty((len(self._solids), len(starts), 3))
        high = np.empty_like(low)
        swept = [index for index, solid in enumerate(self._solids) if moving[solid.frame]]
        if swept:
            low[swept], high[swept] = _swept_boxes(motion, [self._solids[index] for index in swept], starts)
        for index, solid in enumerate(self._solids):
            if not moving[solid.frame]:
                low[index], high[index] = self._box_at_rest(motion, index)
        first, second = self._pairs.T
        return np.all((low[first] <= high[second]) & (low[second] <= high[first]), axis=2)

    def _box_at_rest(self, motion: SegmentMotion, index: int) -> tuple[Array, Array]:
        """Return a box that holds a solid that does not move, as computed when it last moved: (3,) twice [m]."""
        frame = self._solids[index].frame
        version = self._versions[frame]
        if self._boxes.get(index, (-1,))[0] != version:
            points = self._solids[index].corners @ motion.poses(frame)[0, :3, :3].T + motion.poses(frame)[0, :3, 3]
            self._boxes[index] = version, points.min(axis=0), points.max(axis=0)
        return self._boxes[index][1:]

    def _where(self, motion: SegmentMotion, a: ConvexSolid, b: ConvexSolid, interval: int, u: float) -> str:
        time = motion.segment.time
        moment = time[interval] + (u * (time[interval + 1] - time[interval]) if u else 0.0)
        return f"{motion.segment.place()}, t = {moment:.4f} s: {a.name} and {b.name}"


def _swept_boxes(motion: SegmentMotion, solids: Sequence[ConvexSolid], starts: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return boxes that hold solids that move during blocks of samples, in the world: (solids, blocks, 3) twice [m]."""
    poses = np.stack([motion.poses(solid.frame) for solid in solids])
    corners = np.stack([solid.corners.T for solid in solids])[:, None]
    points = poses[:, :, :3, :3] @ corners + poses[:, :, :3, 3:]
    low, high = points.min(axis=3), points.max(axis=3)
    stray = np.empty((len(solids), motion.samples - 1, 1))
    for row, solid in zip(stray[:, :, 0], solids, strict=True):
        row[:] = motion.stray(solid.frame, solid.far) + motion.finger_travel(solid.frame)
    return (
        np.minimum.reduceat(np.minimum(low[:, :-1], low[:, 1:]) - stray, starts, axis=1),
        np.maximum.reduceat(np.maximum(high[:, :-1], high[:, 1:]) + stray, starts, axis=1),
    )


def _runs(steps: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield the runs of steps that are marked, as the numbers of their first and last samples."""
    if not steps.any():
        return
    edges = np.diff(np.concatenate([[0], steps.astype(int), [0]]))
    for first, last in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        yield int(first), int(last)
