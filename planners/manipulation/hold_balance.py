"""Which holds can balance the plate where, and along which motions: program (5) asked as seldom as possible.

Poses that differ by height or place alone share their answers, and every proof of imbalance is tested against all
poses, grips and pushes at once (`planners.balance.certificates`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.balance.balanced import Balanced, Unbalanced, UnbalanceReason
from planners.balance.certificates import TwistTable
from planners.balance.contacts import GripContacts, PushContact
from planners.balance.solver import Balance
from planners.geometry.pose import Array, Transform
from planners.graph.rejections import Rejection
from planners.manipulation.dense_contacts import DenseContactStateGraph, PlateMotion

HandPair = tuple[int | None, int | None]
"""Numbers of a grip and of a push, None for a hand that is absent."""


@dataclass(frozen=True)
class MotionSampling:
    """Where between the ends of a motion of the plate its balance is asked for."""

    rotation_step: float = math.radians(2.0)
    """[rad]"""
    com_step: float = 0.010
    """Way of the centre of mass [m]."""
    end: float = 1e-3
    """How close to the ends, where a contact was just given up [part of the motion]."""

    def parameters(self, motion: PlateMotion) -> Array:
        """Return rising parameters strictly between 0 and 1."""
        length = motion.length
        steps = max(length.rotation / self.rotation_step, length.com_travel / self.com_step)
        return np.linspace(self.end, 1.0 - self.end, max(2, math.ceil(steps)) + 1)


@dataclass(frozen=True, eq=False)
class _MotionSamples:
    """The in-between poses of one motion, and what proofs have ruled out on it."""

    rotations: Array
    points: Array
    table: TwistTable
    impossible: NDArray[np.bool_]
    """(1 + grips, 1 + pushes)"""
    possible: set[HandPair]


class HoldBalance:
    """Answers of the balance program for all poses and holds of one plate lift."""

    def __init__(
        self,
        balance: Balance,
        poses: DenseContactStateGraph,
        grips: Sequence[GripContacts],
        pushes: Sequence[PushContact],
        sampling: MotionSampling | None = None,
    ) -> None:
        """List poses and holds; nothing is solved yet."""
        self.balance = balance
        self.poses = poses
        self.grips, self.pushes = tuple(grips), tuple(pushes)
        self.sampling = sampling or MotionSampling()
        self.solved = 0
        self.ruled_out = np.zeros((len(poses.poses), 1 + len(grips), 1 + len(pushes)), bool)
        self._rotations = np.array([pose.T_world_plate[:3, :3] for pose in poses.poses])
        self._table = TwistTable(
            balance, self._rotations, [pose.contact_points for pose in poses.poses], self.grips, self.pushes
        )
        self._alike = _first_alike(poses)
        self._answers: dict[tuple[int, HandPair], Balanced | Unbalanced] = {}
        self._motions: dict[int, _MotionSamples] = {}

    def at(self, pose: int, hands: HandPair) -> Balanced | Unbalanced:
        """Solve (5) at a pose of the graph. An answer "unbalanced" is remembered for all nodes it holds for."""
        key = (self._alike[pose], hands)
        answer = self._answers.get(key)
        if answer is None:
            where = self.poses.poses[pose]
            answer = self.solve(where.T_world_plate, where.contact_points, hands)
            self._answers[key] = answer
            if isinstance(answer, Unbalanced) and answer.proof is not None:
                self.ruled_out |= self._table.infeasible(answer.proof)
        return answer

    def solve(self, T_world_plate: Transform, contact_points: Array, hands: HandPair) -> Balanced | Unbalanced:
        """Solve (5) at any pose, without remembering."""
        self.solved += 1
        grip = None if hands[0] is None else self.grips[hands[0]]
        push = None if hands[1] is None else self.pushes[hands[1]]
        return self.balance.solve(T_world_plate[:3, :3], contact_points, grip, push)

    def along(self, motion_number: int, hands: HandPair) -> Rejection | None:
        """Say why the plate cannot be held all along a motion of the graph, or None if it can."""
        samples = self._samples(motion_number)
        row = (0 if hands[0] is None else hands[0] + 1, 0 if hands[1] is None else hands[1] + 1)
        if samples.impossible[row]:
            return Rejection("transfer", "the plate cannot be held between two poses that can be held")
        if hands in samples.possible:
            return None
        # From the middle outwards: that is where holds fail most.
        for k in sorted(range(len(samples.rotations)), key=lambda i: abs(2 * i - len(samples.rotations) + 1)):
            self.solved += 1
            grip = None if hands[0] is None else self.grips[hands[0]]
            push = None if hands[1] is None else self.pushes[hands[1]]
            answer = self.balance.solve(samples.rotations[k], samples.points, grip, push)
            if isinstance(answer, Unbalanced):
                samples.impossible[row] = True
                if answer.proof is not None:
                    samples.impossible[:] |= samples.table.infeasible(answer.proof).any(axis=0)
                return Rejection(
                    "transfer",
                    "the plate cannot be held between two poses that can be held",
                    where=f"motion {motion_number}",
                    needed=answer.shortage,
                    available=0.0 if answer.shortage is not None else None,
                    unit="N" if answer.shortage is not None else None,
                )
        samples.possible.add(hands)
        return None

    def impossible_holds(self, motion_number: int) -> NDArray[np.bool_]:
        """Return the (1 + grips, 1 + pushes) holds that are known not to bear the plate along a motion."""
        return self._samples(motion_number).impossible

    def _samples(self, motion_number: int) -> _MotionSamples:
        known = self._motions.get(motion_number)
        if known is None:
            i, j = self.poses.edges[motion_number]
            motion = self.poses.motion_between(int(i), int(j))
            rotations = motion.poses(self.sampling.parameters(motion))[:, :3, :3]
            table = TwistTable(
                self.balance, rotations, [motion.contact_points] * len(rotations), self.grips, self.pushes
            )
            impossible = np.zeros((1 + len(self.grips), 1 + len(self.pushes)), bool)
            known = _MotionSamples(rotations, motion.contact_points, table, impossible, set())
            self._motions[motion_number] = known
        return known


def describe(answer: Unbalanced) -> Rejection:
    """Put an unbalanced pose as a rejection."""
    if answer.reason is UnbalanceReason.WITHIN_TOLERANCE or answer.shortage is None:
        return Rejection("balance", answer.reason.value)
    return Rejection("balance", answer.reason.value, needed=answer.shortage, available=0.0, unit="N")


def _first_alike(poses: DenseContactStateGraph) -> list[int]:
    """For each pose the first with the same contact and tilt: heights and places do not matter to balance."""
    first: dict[tuple[object, float, float], int] = {}
    return [
        first.setdefault((pose.contact, round(float(pose.tilt[0]), 9), round(float(pose.tilt[1]), 9)), number)
        for number, pose in enumerate(poses.poses)
    ]
