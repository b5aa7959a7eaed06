"""Which postures of an arm hold the plate at which poses, alone and along a motion.

A *posture* is one rigid pose of the hand on the plate (a flip of the gripper, a roll of the stick) together with one
branch of the arm's inverse kinematics: bit `8 v + branch` of a set for hand pose v. Along a motion of the plate a
posture is kept, so joints move continuously if and only if the branch does.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.cell.arm import Arm
from planners.collision.kernel import CollisionKernel, first_collision, make_scratch, set_frame
from planners.collision.model import CollisionQuery
from planners.geometry.pose import Array, Transform
from planners.hands.workcell import ArmKernel
from planners.kinematics.forward import link_frames
from planners.kinematics.inverse import BRANCHES, follow_branch, inverse_kinematics, multiply, within_limits
from planners.kinematics.joint_torque import torques_at_rest
from planners.kinematics.windings import wrap

CONTINUITY = 0.25
"""Largest joint step between neighbouring samples of a motion that still counts as continuous [rad]."""
ALL_POSTURES = (1 << 64) - 1
"""The set of all postures of a hold."""
_BLOCK = 8
"""Poses that a thread looks at in one go."""
_MOST_PLACES = 2048
"""So many poses of holds are remembered with their joint axes, the last that were asked for: some kilobytes each."""
Hand = Literal["grip", "push"]
"""Which of the two hands."""


class PlateKernel(NamedTuple):
    """A `PlateQuery` for compiled code, which moves the plate in it."""

    collisions: CollisionKernel
    plate_frame: int


class HoldKernel(NamedTuple):
    """One hold of one hand for compiled code."""

    arm: ArmKernel
    T_plate_flange: Array
    """(hand poses, 4, 4)"""
    postures: np.uint64
    """Those that are asked for, as a bit set."""


class _JointAxes(NamedTuple):
    """The joints of a hold's postures at one pose of the plate: of those whose branch reaches it within the limits."""

    postures: NDArray[np.int64]
    """(n,) rising."""
    positions: Array
    """(n, 6) [rad]"""
    points: Array
    """(n, 6, 3) on each joint's axis, in the world [m]."""
    directions: Array
    """(n, 6, 3) of each joint's axis, in the world."""


@dataclass(slots=True)
class _Place:
    """A hold at a pose of the plate, and what is known of its postures there."""

    axes: _JointAxes
    free: int = 0
    """Bit set of those that are free of collision."""
    touching: int = 0
    """Bit set of those that are not."""


class Closeness(IntEnum):
    """How near to holding the plate a posture is that does not, the nearest first."""

    TOUCHING = 0
    """The arm reaches it, and something is in the way."""
    TOUCHING_ITSELF = 1
    BEYOND_LIMITS = 2
    NOWHERE = 3


class Hindrance(NamedTuple):
    """What keeps a hand from a hold."""

    closeness: Closeness
    reason: str


@dataclass(frozen=True, eq=False)
class PlateQuery:
    """A collision query in which the plate is put at many poses: its compiled form, and the number of the plate."""

    query: CollisionQuery
    plate_frame: int

    def kernel(self) -> PlateKernel:
        """Return a copy of the compiled query that one thread may move the plate in."""
        return PlateKernel(self.query.kernel_copy(), self.plate_frame)

    @cached_property
    def own_kernel(self) -> PlateKernel:
        """A copy for whoever asks thousands of times, one pose after the other: not for two threads at once."""
        return self.kernel()

    def first_collisions(self, T_world_plates: Array, q: Array | None = None) -> NDArray[np.int64]:
        """Return for each plate pose (n, 4, 4) the first pair within its margin, or -1: (n,).

        The arms are at q (12,); at zero where the query does not look at arms.
        """
        positions = np.zeros(12) if q is None else q
        return _collisions_at(self.kernel(), np.ascontiguousarray(T_world_plates), positions)

    def meetings(self, T_world_plates: Array) -> Iterator[tuple[str, str]]:
        """Yield the names of bodies that meet, one pair for each plate pose (n, 4, 4) that is not free."""
        return (self.query.pair_names(int(pair)) for pair in self.first_collisions(T_world_plates) if pair >= 0)


@dataclass(frozen=True, eq=False)
class HandReach:
    """One hand and all its holds on the plate."""

    arm: Arm
    first_joint: int
    """Of the arm among all twelve."""
    T_plate_flange: Array
    """(holds, hand poses, 4, 4)"""
    alone: PlateQuery
    """This arm against everything but the other arm."""
    hand_only: PlateQuery
    """The same, of its hand only: the first thing asked, once for all branches."""
    start_positions: Array
    """(12,) where idle arms stand [rad]."""

    @cached_property
    def kernel(self) -> ArmKernel:
        """The arm for compiled code."""
        return ArmKernel.of(self.arm, self.first_joint)

    @property
    def joints(self) -> slice:
        """Those of the arm among all twelve."""
        return slice(self.first_joint, self.first_joint + 6)

    def asked(self, hold: int, postures: int) -> HoldKernel:
        """Return a hold for compiled code, with the postures that are asked for, as a bit set."""
        return HoldKernel(self.kernel, self.T_plate_flange[hold], np.uint64(postures))

    @property
    def hold_count(self) -> int:
        """Number of holds."""
        return len(self.T_plate_flange)

    def postures(
        self,
        T_world_plates: Array,
        holds: slice | NDArray[np.intp] = slice(None),
        among: NDArray[np.uint64] | None = None,
        *,
        any_one: bool = False,
    ) -> NDArray[np.uint64]:
        """Return the (poses, holds) sets of postures that reach each pose and are free of collision there.

        Args:
            T_world_plates: (poses, 4, 4).
            holds: which of the holds; all if left out.
            among: (poses, holds) sets of those that are asked for; all if left out.
            any_one: whether one posture of each set is enough.
        """
        T_plate_flange = self.T_plate_flange[holds]
        shape = len(T_world_plates), len(T_plate_flange)
        result = np.full(shape, ALL_POSTURES, np.uint64) if among is None else among.copy()
        q = self.start_positions.copy()
        queries = self.alone.kernel(), self.hand_only.kernel()
        _reach(self.kernel, queries, T_world_plates, T_plate_flange, q, any_one, result)
        return result

    def hindrance(self, T_world_plate: Transform, hold: int) -> Hindrance | None:
        """Say why no posture of a hold reaches a plate pose, by the postures that come closest to it; None if one does.

        Slow: for explanations.
        """
        arm, found = self.arm, Counter[Hindrance]()
        for posture in range(BRANCHES * self.T_plate_flange.shape[1]):
            q = self.start_positions.copy()
            q[self.joints] = self.follow(T_world_plate[None], hold, posture)[0]
            if not np.isfinite(q).all():
                found[Hindrance(Closeness.NOWHERE, f"the {arm.name} arm does not reach so far")] += 1
            elif not within_limits(q[self.joints], arm.position_min, arm.position_max):
                reason = f"a joint of the {arm.name} arm would be beyond its limits"
                found[Hindrance(Closeness.BEYOND_LIMITS, reason)] += 1
            else:
                pair = int(self.alone.first_collisions(T_world_plate[None], q)[0])
                if pair < 0:
                    return None
                found[self._touching(pair)] += 1
        return min(found, key=lambda each: (each.closeness, -found[each]))

    def _touching(self, pair: int) -> Hindrance:
        names = self.alone.query.pair_names(pair)
        if all(name.startswith(f"{self.arm.name}_") for name in names):
            reason = f"the {self.arm.name} arm would touch itself, {names[0]} and {names[1]}"
            return Hindrance(Closeness.TOUCHING_ITSELF, reason)
        return Hindrance(Closeness.TOUCHING, "{} would touch {}".format(*names))

    def track(
        self,
        T_world_plates: Array,
        hold: int,
        postures: int,
        query: PlateQuery,
        T_world_carriers: Array | None = None,
    ) -> int:
        """Return those of `postures` that pass through all samples, continuous and free of collision.

        Args:
            T_world_plates: (n, 4, 4) where the plate is.
            hold: which hold.
            postures: bit set.
            query: what counts as a collision; idle arms stand at the start positions.
            T_world_carriers: (n, 4, 4) where the plate would be if it went with the hand; for approaches, in which
                the hand moves and the plate does not. Left out: where the plate is.
        """
        carriers = T_world_plates if T_world_carriers is None else T_world_carriers
        q = self.start_positions.copy()
        return int(_track(self.asked(hold, postures), query.kernel(), T_world_plates, carriers, q))

    def follow(self, T_world_plates: Array, hold: int, posture: int, reference: Array | None = None) -> Array:
        """Return the (n, 6) joint positions of one posture at the plate poses (n, 4, 4).

        Whole turns are chosen so that each row is nearest to the row before or, if given, to the same row of
        `reference` (n, 6). NaN where the branch does not reach; joint limits are not looked at.
        """
        return self.follow_flange(T_world_plates @ self.T_plate_flange[hold, posture // BRANCHES], posture, reference)

    def follow_flange(self, T_world_flanges: Array, posture: int, reference: Array | None = None) -> Array:
        """Return the (n, 6) joint positions at which the flange is at (n, 4, 4), in the branch of a posture."""
        near = np.empty((0, 6)) if reference is None else np.ascontiguousarray(reference)
        return follow_branch(
            self.arm.dh,
            self.kernel.T_base_world,
            np.ascontiguousarray(T_world_flanges),
            posture % BRANCHES,
            near,
        )

    def least_load(
        self, T_world_plate: Transform, hold: int, postures: int, wrench: Array, point: Array, known: int = 0
    ) -> float:
        """Return the least torque load of the postures in the set that reach a pose and are free of collision [Nm].

        It is the sum of |J^T F| over the joints for the hand's contact wrenches; infinite if there is no such posture.
        A hold is asked for with many wrenches at a pose, one for each hold of the other hand: where its joints are, and
        which postures touch something, is remembered. Not for two threads at once.

        Args:
            T_world_plate: (4, 4).
            hold: which hold.
            postures: bit set.
            wrench: (6,) that the hand exerts on the plate, world axes, torque about `point`.
            point: (3,) in the world.
            known: bit set of postures that are known to reach the pose and to be free.
        """
        place = self._place(T_world_plate, hold)
        place.free |= known
        while True:
            # To weigh all postures is cheaper than to look for collisions.
            row, load = _least_loaded(place.axes, np.uint64(postures & ~place.touching), wrench, point)
            if row < 0 or place.free >> int(place.axes.postures[row]) & 1:
                return load
            self._look_for_collisions(place, row, T_world_plate)

    @cached_property
    def _places(self) -> OrderedDict[tuple[bytes, int], _Place]:
        return OrderedDict()

    def _place(self, T_world_plate: Transform, hold: int) -> _Place:
        """Return a hold at a plate pose (4, 4), with what is known of it."""
        key, places = (T_world_plate.tobytes(), hold), self._places
        place = places.get(key)
        if place is None:
            arrays = _joint_axes(self.kernel, self.arm.T_world_base, self.T_plate_flange[hold], T_world_plate)
            place = places[key] = _Place(_JointAxes(*arrays))
            if len(places) > _MOST_PLACES:
                places.popitem(last=False)
        else:
            places.move_to_end(key)
        return place

    def _look_for_collisions(self, place: _Place, row: int, T_world_plate: Transform) -> None:
        """Find out whether a posture of a place, by its row there, is free of collision."""
        posture, q = int(place.axes.postures[row]), self.start_positions.copy()
        q[self.joints] = place.axes.positions[row]
        if _collisions_at(self.alone.own_kernel, T_world_plate[None], q)[0] < 0:
            place.free |= 1 << posture
            return
        place.touching |= 1 << posture
        if _collisions_at(self.hand_only.own_kernel, T_world_plate[None], q)[0] >= 0:
            # The hand stands where it does whichever branch the arm is in.
            place.touching |= 255 << posture // BRANCHES * BRANCHES

    def torque_shares(
        self, T_world_plates: Array, hold: int, postures: int, wrenches: Array, points: Array, gravity: Array
    ) -> Array:
        """Return (64, 6) which part of each joint's largest torque postures use at most, at rest; NaN for others [1].

        Arm and hand are held against gravity, and the hand exerts its contact wrenches; see `planners.kinematics.
        joint_torque`. Infinite where the posture's branch does not reach a pose.

        Args:
            T_world_plates: (n, 4, 4) where the plate is.
            hold: which hold.
            postures: bit set.
            wrenches: (n, 6) that the hand exerts on the plate there, world axes, torque about `points`.
            points: (n, 3) in the world.
            gravity: (3,) in the world [m/s^2].
        """
        forces = np.ascontiguousarray(wrenches), np.ascontiguousarray(points)
        weighed, most = self.arm.weighed(gravity), self.arm.torque_max
        return _torque_shares(self.asked(hold, postures), weighed, most, np.ascontiguousarray(T_world_plates), *forces)

    def within_torque(
        self,
        T_world_plates: Array,
        hold: int,
        postures: int,
        wrenches: Array,
        points: Array,
        gravity: Array,
        margin: float,
    ) -> int:
        """Return those of `postures` that use no more than 1 - `margin` of any joint's largest torque at all the poses.

        Arguments as of `torque_shares`.
        """
        shares = self.torque_shares(T_world_plates, hold, postures, wrenches, points, gravity).max(axis=1)
        return sum(1 << bit for bit in bits(postures) if shares[bit] <= 1.0 - margin)


@dataclass(frozen=True, eq=False)
class PairReach:
    """Both hands at once: which postures of one hand go with which of the other. Not for two threads at once."""

    first: HandReach
    second: HandReach
    between: PlateQuery
    """The two arms against one another."""

    def some_postures(
        self, T_world_plates: Array, done: Callable[[int], None]
    ) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
        """Return (poses, holds) sets of both hands: of each that `HandReach.postures` has, one posture if there is any.

        Args:
            T_world_plates: (poses, 4, 4).
            done: told the number of poses dealt with, now and then.
        """
        blocks = [T_world_plates[first : first + _BLOCK] for first in range(0, len(T_world_plates), _BLOCK)]
        # The compiled part lets go of the interpreter, so that two threads use two cores.
        threads = ThreadPoolExecutor(2)
        try:
            hands = (self.first, self.second)
            found = [[threads.submit(hand.postures, block, any_one=True) for hand in hands] for block in blocks]
            sets = []
            for number, both in enumerate(found, start=1):
                sets.append([future.result() for future in both])
                done(min(number * _BLOCK, len(T_world_plates)))
        finally:
            threads.shutdown(cancel_futures=True)
        first, second = (np.concatenate(column) for column in zip(*sets, strict=True))
        return first, second

    def compatible(
        self, T_world_plates: Array, holds: tuple[int, int], postures: tuple[int, int]
    ) -> tuple[int, int] | None:
        """Return the first pair of postures that keeps the arms apart at all the poses, or None.

        Args:
            T_world_plates: (n, 4, 4); the postures must reach them all.
            holds: of the first and the second hand.
            postures: bit sets.
        """
        one, two = self.first.asked(holds[0], postures[0]), self.second.asked(holds[1], postures[1])
        found = _compatible(one, two, T_world_plates, self.between.own_kernel)
        return None if found < 0 else (int(found) // 64, int(found) % 64)


def bits(postures: int) -> list[int]:
    """List the members of a bit set."""
    return [bit for bit in range(64) if postures >> bit & 1]


@njit(cache=True, nogil=True)
def _collisions_at(placed, T_world_plates, q):
    kernel, frame = placed
    scratch = make_scratch(kernel)
    result = np.empty(T_world_plates.shape[0], np.int64)
    for p in range(T_world_plates.shape[0]):
        set_frame(kernel, frame, T_world_plates[p])
        result[p] = first_collision(kernel, q, scratch)
    return result


@njit(cache=True, nogil=True)
def _reach(arm, queries, T_world_plates, T_plate_flange, q, any_one, sets):
    """Leave in `sets` the postures that reach; of each hold that has any, no more than the first if `any_one`."""
    dh, T_base_world, lo, hi, first_joint = arm
    (kernel, frame), (hand, hand_frame) = queries
    scratch, hand_scratch = make_scratch(kernel), make_scratch(hand)
    T_base_plate, T_base_flange, solutions = np.empty((4, 4)), np.empty((4, 4)), np.empty((8, 6))
    for p in range(T_world_plates.shape[0]):
        set_frame(kernel, frame, T_world_plates[p])
        set_frame(hand, hand_frame, T_world_plates[p])
        multiply(T_base_world, T_world_plates[p], T_base_plate)
        for h in range(T_plate_flange.shape[0]):
            asked, found = sets[p, h], np.uint64(0)
            for v in range(T_plate_flange.shape[1]):
                if any_one and found:
                    break
                branches = np.int64((asked >> np.uint64(8 * v)) & np.uint64(255))
                if branches == 0:
                    continue
                multiply(T_base_plate, T_plate_flange[h, v], T_base_flange)
                valid = inverse_kinematics(dh, T_base_flange, 0.0, solutions) & branches
                hand_checked = False
                for branch in range(8):
                    if not (valid >> branch) & 1 or not within_limits(solutions[branch], lo, hi):
                        continue
                    q[first_joint : first_joint + 6] = solutions[branch]
                    if not hand_checked:
                        if first_collision(hand, q, hand_scratch) >= 0:
                            break
                        hand_checked = True
                    if first_collision(kernel, q, scratch) < 0:
                        found |= np.uint64(1) << np.uint64(8 * v + branch)
                        if any_one:
                            break
            sets[p, h] = found


@njit(cache=True, nogil=True)
def _track(hold, placed, T_world_plates, T_world_carriers, q):
    (dh, T_base_world, lo, hi, first_joint), T_plate_flange, postures = hold
    kernel, frame = placed
    scratch = make_scratch(kernel)
    T_base_plate, T_base_flange, solutions = np.empty((4, 4)), np.empty((4, 4)), np.empty((8, 6))
    last = np.empty((64, 6))
    left = postures
    for p in range(T_world_plates.shape[0]):
        set_frame(kernel, frame, T_world_plates[p])
        multiply(T_base_world, T_world_carriers[p], T_base_plate)
        for v in range(T_plate_flange.shape[0]):
            if (left >> np.uint64(8 * v)) & np.uint64(255) == 0:
                continue
            multiply(T_base_plate, T_plate_flange[v], T_base_flange)
            valid = inverse_kinematics(dh, T_base_flange, 0.0, solutions)
            for branch in range(8):
                bit = np.uint64(8 * v + branch)
                if not (left >> bit) & np.uint64(1):
                    continue
                good = bool((valid >> branch) & 1) and within_limits(solutions[branch], lo, hi)
                if good and p > 0:
                    for i in range(6):
                        good = good and abs(wrap(solutions[branch, i] - last[bit, i])) <= CONTINUITY
                if good:
                    last[bit] = solutions[branch]
                    q[first_joint : first_joint + 6] = solutions[branch]
                    good = first_collision(kernel, q, scratch) < 0
                if not good:
                    left &= ~(np.uint64(1) << bit)
        if left == 0:
            break
    return left


@njit(cache=True, nogil=True)
def _joint_axes(arm, T_world_base, T_plate_flange, T_world_plate):
    """Return the fields of the `_JointAxes` of a hold, with hand poses (v, 4, 4), at a plate pose (4, 4)."""
    dh, T_base_world, lo, hi, _ = arm
    most, count = 8 * T_plate_flange.shape[0], 0
    postures, positions = np.empty(most, np.int64), np.empty((most, 6))
    points, directions = np.empty((most, 6, 3)), np.empty((most, 6, 3))
    solutions, frames = np.empty((8, 6)), np.empty((7, 4, 4))
    T_base_plate, T_base_flange = np.empty((4, 4)), np.empty((4, 4))
    multiply(T_base_world, T_world_plate, T_base_plate)
    for v in range(T_plate_flange.shape[0]):
        multiply(T_base_plate, T_plate_flange[v], T_base_flange)
        branches = inverse_kinematics(dh, T_base_flange, 0.0, solutions)
        for branch in range(8):
            if (branches >> branch) & 1 and within_limits(solutions[branch], lo, hi):
                link_frames(dh, T_world_base, solutions[branch], frames)
                postures[count] = 8 * v + branch
                positions[count] = solutions[branch]
                for i in range(6):
                    points[count, i] = frames[i, :3, 3]
                    directions[count, i] = frames[i, :3, 2]
                count += 1
    return postures[:count].copy(), positions[:count].copy(), points[:count].copy(), directions[:count].copy()


@njit(cache=True, nogil=True)
def _least_loaded(axes, asked, wrench, point):
    """Return the row of the least loaded of the postures that are asked for, -1 if there is none, and its load."""
    postures, _, points, directions = axes
    found, least = -1, np.inf
    for row in range(len(postures)):
        if not (asked >> np.uint64(postures[row])) & np.uint64(1):
            continue
        load = 0.0
        for i in range(6):
            # The wrench's torque about a point of the joint's axis, along the axis.
            x, y, z = point[0] - points[row, i, 0], point[1] - points[row, i, 1], point[2] - points[row, i, 2]
            torque = directions[row, i, 0] * (wrench[3] + y * wrench[2] - z * wrench[1])
            torque += directions[row, i, 1] * (wrench[4] + z * wrench[0] - x * wrench[2])
            torque += directions[row, i, 2] * (wrench[5] + x * wrench[1] - y * wrench[0])
            load += abs(torque)
        if load < least:
            found, least = row, load
    return found, least


@njit(cache=True, nogil=True)
def _torque_shares(hold, weighed, torque_max, T_world_plates, wrenches, points):
    (_, T_base_world, _, _, _), T_plate_flange, postures = hold
    result = np.full((64, 6), np.nan)
    T_base_plate, T_base_flange, solutions = np.empty((4, 4)), np.empty((4, 4)), np.empty((8, 6))
    frames, torques = np.empty((7, 4, 4)), np.empty(6)
    for p in range(T_world_plates.shape[0]):
        multiply(T_base_world, T_world_plates[p], T_base_plate)
        for v in range(T_plate_flange.shape[0]):
            if (postures >> np.uint64(8 * v)) & np.uint64(255) == 0:
                continue
            multiply(T_base_plate, T_plate_flange[v], T_base_flange)
            valid = inverse_kinematics(weighed.dh, T_base_flange, 0.0, solutions)
            for branch in range(8):
                bit = 8 * v + branch
                if not (postures >> np.uint64(bit)) & np.uint64(1):
                    continue
                torques[:] = np.inf
                if (valid >> branch) & 1:
                    link_frames(weighed.dh, weighed.T_world_base, solutions[branch], frames)
                    torques_at_rest(weighed, frames, wrenches[p], points[p], torques)
                for i in range(6):
                    share = abs(torques[i]) / torque_max[i]
                    if p == 0 or share > result[bit, i]:
                        result[bit, i] = share
    return result


@njit(cache=True, nogil=True)
def _compatible(one, two, T_world_plates, placed):
    """Number 64 a + b of the first pair of postures whose arms stay apart at all poses, -1 if there is none."""
    (dh_a, T_base_a, _, _, joint_a), flange_a, postures_a = one
    (dh_b, T_base_b, _, _, joint_b), flange_b, postures_b = two
    kernel, frame = placed
    scratch = make_scratch(kernel)
    q = np.zeros(12)
    T_plate, T_flange = np.empty((4, 4)), np.empty((4, 4))
    in_a, in_b = np.empty((8, 6)), np.empty((8, 6))
    for a in range(64):
        if not (postures_a >> np.uint64(a)) & np.uint64(1):
            continue
        for b in range(64):
            if not (postures_b >> np.uint64(b)) & np.uint64(1):
                continue
            good = True
            for p in range(T_world_plates.shape[0]):
                multiply(T_base_a, T_world_plates[p], T_plate)
                multiply(T_plate, flange_a[a // 8], T_flange)
                inverse_kinematics(dh_a, T_flange, 0.0, in_a)
                multiply(T_base_b, T_world_plates[p], T_plate)
                multiply(T_plate, flange_b[b // 8], T_flange)
                inverse_kinematics(dh_b, T_flange, 0.0, in_b)
                q[joint_a : joint_a + 6] = in_a[a % 8]
                q[joint_b : joint_b + 6] = in_b[b % 8]
                set_frame(kernel, frame, T_world_plates[p])
                if first_collision(kernel, q, scratch) >= 0:
                    good = False
                    break
            if good:
                return 64 * a + b
    return -1
