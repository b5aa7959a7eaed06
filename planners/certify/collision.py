"""Collision over the continuous motion, by conservative advancement.

Two solids a distance d apart stay apart for as long as together they cannot move farther than d. So a stretch of
motion is clear when the distances at its two ends add up to more than both solids can move in it; otherwise it is cut
in two, between samples too, until it is proven or a penetration is found.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from planners.certify.certificate import Check, Finding
from planners.certify.document_view import PlanView, SegmentView
from planners.certify.motion import SegmentMotion, chord_lengths, relative
from planners.certify.pairs import TouchRule, pairs_of
from planners.certify.settings import CertifySettings
from planners.certify.solids import Frame, Solid, signed_distance
from planners.geometry.pose import Array

_BLOCK = 16
"""Samples whose boxes are compared at once."""


class PairMotion:
    """How far two solids can move relative to one another during a segment."""

    def __init__(self, motion: SegmentMotion, a: Solid, b: Solid, touching: bool) -> None:
        anchors = motion.anchor(a.frame), motion.anchor(b.frame)
        self._motion = motion
        self._one_arm = anchors[0] is not None and anchors[1] is not None and anchors[0][0] == anchors[1][0]
        self._relative = self._one_arm or touching
        if self._relative and self._second_is_the_base(anchors, a, b):
            a, b, anchors = b, a, anchors[::-1]
        self.a, self.b = a, b
        if self._relative:
            T_a_b = relative(motion.poses(a.frame), motion.poses(b.frame))
            ways = chord_lengths(T_a_b, b.centre, b.bound)
            ways = ways + motion.finger_travel(a.frame) + motion.finger_travel(b.frame)
            far = float(np.linalg.norm(b.centre)) + b.bound
            if self._one_arm:
                assert anchors[0] is not None
                self._stray = motion.stray(b.frame, far, anchors[0][1])
            else:
                # A point of b and the point of a that it is beside: both stray from their straight ways.
                reach = np.linalg.norm(T_a_b[:, :3, :3] @ b.centre + T_a_b[:, :3, 3], axis=1).max()
                beside = float(reach + b.bound + ways.max(initial=0.0))
                self._stray = motion.stray(a.frame, beside) + motion.stray(b.frame, far)
        else:
            ways = motion.ways(a) + motion.ways(b)
            self._stray = sum(
                (motion.stray(s.frame, float(np.linalg.norm(s.centre)) + s.bound) for s in (a, b)), np.zeros(1)
            )
        self._stray = np.broadcast_to(self._stray, (motion.samples - 1,))
        self._way = np.concatenate([[0.0], np.cumsum(np.broadcast_to(ways, (motion.samples - 1,)))])

    def _second_is_the_base(self, anchors: tuple[tuple[str, int] | None, ...], a: Solid, b: Solid) -> bool:
        if self._one_arm and anchors[0] is not None and anchors[1] is not None:
            return anchors[0][1] > anchors[1][1]
        return a.bound < b.bound

    def between(self, start: int, end: int) -> float:
        """Return how much the two move and stray between two samples [m]."""
        return float(self._way[end] - self._way[start] + 2 * self._stray[start:end].max())

    def within(self, interval: int, start: float, end: float) -> float:
        """Return the same for a part of the interval after a sample [m]."""
        motion, stray = (self._motion, 2 * float(self._stray[interval]) * (end - start) ** 2)
        if not self._relative:
            return stray + motion.way(self.a, interval, start, end) + motion.way(self.b, interval, start, end)
        poses = [np.stack([motion.pose(solid.frame, interval, u) for u in (start, end)]) for solid in (self.a, self.b)]
        way = float(chord_lengths(relative(*poses), self.b.centre, self.b.bound)[0])
        travel = sum(motion.finger_travel_between(s.frame, interval, start, end) for s in (self.a, self.b))
        return stray + way + travel

    def distance(self, interval: int, u: float) -> float:
        """Return the signed distance at a moment of an interval; at a sample for u = 0 [m]."""
        if u == 0.0:
            poses = [self._at_sample(solid.frame, interval) for solid in (self.a, self.b)]
        else:
            poses = [self._motion.pose(solid.frame, interval, u) for solid in (self.a, self.b)]
        return signed_distance(self.a, poses[0], self.b, poses[1])

    def _at_sample(self, frame: Frame, sample: int) -> Array:
        poses = self._motion.poses(frame)
        return poses[sample if len(poses) > 1 else 0]


class CollisionCheck:
    """Looks at every pair in every segment."""

    def __init__(
        self,
        plan: PlanView,
        solids: Sequence[Solid],
        rule_of: Callable[[SegmentView], TouchRule],
        settings: CertifySettings,
    ) -> None:
        self._rule_of, self._solids, self._settings = rule_of, solids, settings
        static = frozenset(name for name, body in plan.bodies.items() if body.static)
        self._pairs = np.array(pairs_of(solids, static), dtype=int).reshape(-1, 2)
        self._free = Finding("collision", "m")
        self._touch = Finding("touch_depth", "m")
        self._left = settings.distance_budget
        self._versions: dict[Frame, int] = {}
        self._seen: dict[tuple[int, int], tuple[int, int, bool]] = {}

    def run(self, motions: Sequence[SegmentMotion]) -> list[Check]:
        """Return the two checks: pairs that must stay apart, and pairs that may touch."""
        for motion in motions:
            self._segment(motion)
        return [self._free.check(), self._touch.check()]

    def _segment(self, motion: SegmentMotion) -> None:
        rule = self._rule_of(motion.segment)
        moving = {frame: motion.moves(frame) for frame in {solid.frame for solid in self._solids}}
        for frame, moves in moving.items():
            self._versions[frame] = self._versions.get(frame, 0) + moves
        near = self._near_blocks(motion)
        for row in np.flatnonzero(near.any(axis=1)):
            i, j = self._pairs[row]
            a, b = self._solids[i], self._solids[j]
            touching = rule.allows(a, b)
            version = (self._versions[a.frame], self._versions[b.frame], touching)
            still = not moving[a.frame] and not moving[b.frame]
            if still and self._seen.get((i, j)) == version:
                continue
            self._seen[i, j] = version
            self._pair(motion, a, b, touching, None if still else near[row])

    def _pair(self, motion: SegmentMotion, a: Solid, b: Solid, touching: bool, near: Array | None) -> None:
        finding = self._touch if touching else self._free
        allowance = self._settings.touch_depth if touching else 0.0
        pair = PairMotion(motion, a, b, touching)
        rigid = pair.between(0, motion.samples - 1) == 0.0
        clearances: dict[tuple[int, float], float] = {}

        def clearance(interval: int, u: float) -> float:
            if u == 1.0:
                interval, u = interval + 1, 0.0
            key = (interval, u)
            if key not in clearances:
                self._left -= 1
                clearances[key] = pair.distance(interval, u) + allowance
                finding.note(clearances[key], lambda: self._where(motion, a, b, interval, u))
            return clearances[key]

        if near is None or rigid:
            clearance(0, 0.0)
            return
        for start, end in _runs(near, motion.samples - 1):
            if not self._clear(pair, clearance, start, end):
                return
        if self._left <= 0:
            finding.note(
                -1.0,
                f"{self._where(motion, a, b, 0, 0.0)}: not proven within {self._settings.distance_budget} distances",
            )

    def _clear(self, pair: PairMotion, clearance: Callable[[int, float], float], start: int, end: int) -> bool:
        """Prove a run of samples; False when a penetration was found (and noted)."""
        stretches = [(start, end)]
        while stretches and self._left > 0:
            first, last = stretches.pop()
            at_ends = clearance(first, 0.0), clearance(last, 0.0)
            if min(at_ends) < 0.0:
                return False
            moved = pair.between(first, last)
            if sum(at_ends) > moved or moved < self._settings.smallest_motion:
                continue
            if last - first > 1:
                middle = (first + last) // 2
                stretches += [(middle, last), (first, middle)]
            elif not self._clear_within(pair, clearance, first):
                return False
        return True

    def _clear_within(self, pair: PairMotion, clearance: Callable[[int, float], float], interval: int) -> bool:
        """Prove the motion between two neighbouring samples."""
        stretches = [(0.5, 1.0), (0.0, 0.5)]
        while stretches and self._left > 0:
            start, end = stretches.pop()
            at_ends = clearance(interval, start), clearance(interval, end)
            if min(at_ends) < 0.0:
                return False
            moved = pair.within(interval, start, end)
            if sum(at_ends) <= moved and moved >= self._settings.smallest_motion:
                middle = (start + end) / 2
                stretches += [(middle, end), (start, middle)]
        return True

    def _near_blocks(self, motion: SegmentMotion) -> Array:
        """Return which pairs' boxes meet in which blocks of samples: (pairs, blocks)."""
        starts = np.arange(0, motion.samples - 1, _BLOCK)
        low = np.empty((len(self._solids), len(starts), 3))
        high = np.empty_like(low)
        for index, solid in enumerate(self._solids):
            low[index], high[index] = _swept_boxes(motion, solid, starts)
        first, second = self._pairs.T
        return np.all((low[first] <= high[second]) & (low[second] <= high[first]), axis=2)

    def _where(self, motion: SegmentMotion, a: Solid, b: Solid, interval: int, u: float) -> str:
        time = motion.segment.time
        moment = time[interval] + (u * (time[interval + 1] - time[interval]) if u else 0.0)
        return f"{motion.segment.place()}, t = {moment:.4f} s: {a.name} and {b.name}"


def _swept_boxes(motion: SegmentMotion, solid: Solid, starts: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return boxes that hold the solid during blocks of samples, in the world: (blocks, 3) twice [m]."""
    poses = motion.poses(solid.frame)
    if not motion.moves(solid.frame):
        poses = poses[:1]
    points = poses[:, :3, :3] @ solid.corners.T + poses[:, :3, 3:]
    low, high = points.min(axis=2), points.max(axis=2)
    if len(poses) == 1:
        shape = (len(starts), 3)
        return np.broadcast_to(low, shape), np.broadcast_to(high, shape)
    stray = motion.stray(solid.frame, float(np.linalg.norm(solid.centre)) + solid.bound)
    stray = np.broadcast_to(stray + motion.finger_travel(solid.frame), (motion.samples - 1,))[:, None]
    return (
        np.minimum.reduceat(np.minimum(low[:-1], low[1:]) - stray, starts),
        np.maximum.reduceat(np.maximum(high[:-1], high[1:]) + stray, starts),
    )


def _runs(near: Array, last: int) -> list[tuple[int, int]]:
    """Join neighbouring blocks into runs of samples (first, last)."""
    edges = np.diff(np.concatenate([[0], near.astype(int), [0]]))
    firsts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(int(f) * _BLOCK, min(int(e) * _BLOCK, last)) for f, e in zip(firsts, ends, strict=True)]
