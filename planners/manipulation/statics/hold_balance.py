"""Which holds can balance the plate where, and along which motions: program (5) asked as seldom as possible.

Poses that differ by height or place alone share their answers, and every proof of imbalance is tested against all
poses, grips and pushes at once (`planners.balance.proofs`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from planners.balance.balanced import Balanced, Unbalanced, UnbalanceProof
from planners.balance.cone_program import ConeProgram
from planners.balance.contacts import GripContacts, PushContact
from planners.balance.proofs import TwistTable
from planners.balance.solver import Balance
from planners.cell.cell import Cell
from planners.cell.cell_size import resized
from planners.geometry.pose import Array, Transform
from planners.graph.rejections import Rejection
from planners.manipulation.contacts.dense_contact_states import DenseContactStateGraph, PlateMotion

_TELLING = 1e-3
"""Share of all nodes that a proof rules out for the first time, for others to be tested with it [1]."""

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

    @classmethod
    def of(cls, cell: Cell) -> Self:
        """Return that of a cell: here it is of one of size 1."""
        return resized(cls(), cell.size, "com_step")

    def parameters(self, motion: PlateMotion) -> Array:
        """Return rising parameters (m,) strictly between 0 and 1."""
        length = motion.length
        steps = max(length.rotation / self.rotation_step, length.com_travel / self.com_step)
        return np.linspace(self.end, 1.0 - self.end, max(2, math.ceil(steps)) + 1)


@dataclass(frozen=True, eq=False)
class _MotionSamples:
    """The in-between poses of one motion, and what proofs have ruled out on it."""

    rotations: Array
    points: Array
    impossible: NDArray[np.bool_]
    """(1 + grips, 1 + pushes)"""
    possible: set[HandPair]


class BalancePrograms(NamedTuple):
    """What is asked of every way to hold the plate."""

    stated: Balance
    """(5) for the plate as stated, with the reserve kept back."""
    tolerant: Balance
    """(5) for all plates within the tolerances, with nothing kept back."""
    reserve: float
    """[1]"""


class HoldBalance:
    """Answers of the balance program for all poses and holds of one plate lift."""

    def __init__(
        self,
        programs: BalancePrograms,
        poses: DenseContactStateGraph,
        grips: Sequence[GripContacts],
        pushes: Sequence[PushContact],
        sampling: MotionSampling | None = None,
    ) -> None:
        """List poses and holds; nothing is solved yet.

        Args:
            programs: what is asked.
            poses: of the plate.
            grips: the gripper's contacts, by number.
            pushes: the stick's, likewise.
            sampling: where balance is asked for along motions.
        """
        self.balance, self.tolerant, self.reserve = programs
        self.poses = poses
        self.grips, self.pushes = tuple(grips), tuple(pushes)
        self.sampling = sampling or MotionSampling()
        self.solved = 0
        self.ruled_out = np.zeros((len(poses.poses), 1 + len(grips), 1 + len(pushes)), bool)
        self.telling_proofs: list[UnbalanceProof] = []
        """Those that ruled out many nodes, and so may do for other poses and holds too."""
        self._rotations = np.array([pose.T_world_plate[:3, :3] for pose in poses.poses])
        self._tables = self._twist_tables(self._rotations, [pose.contact_points for pose in poses.poses])
        self._alike = _first_alike(poses)
        self._answers: dict[tuple[int, HandPair], Balanced | Unbalanced] = {}
        self._refusals: dict[tuple[int, HandPair], Unbalanced | None] = {}
        self._motions: dict[int, _MotionSamples] = {}
        self._steady_motions: set[tuple[int, HandPair]] = set()
        self._tolerance_proofs: list[UnbalanceProof] = []
        self._tolerance_proofs_known = 0
        self._by_reserve: dict[float, HoldBalance] = {self.reserve: self}

    def keeping(self, stated: Balance, reserve: float) -> HoldBalance:
        """Return the answers for another reserve; those that do not depend on it stay known.

        What cannot be held with one reserve cannot be held with any larger one, and what can be, with any smaller one.

        Args:
            stated: (5) for the plate as stated, with that reserve kept back.
            reserve: [1].
        """
        other = self._by_reserve.get(reserve)
        if other is None:
            programs = BalancePrograms(stated, self.tolerant, reserve)
            other = HoldBalance(programs, self.poses, self.grips, self.pushes, self.sampling)
            other._refusals, other._steady_motions = self._refusals, self._steady_motions
            other._tolerance_proofs = self._tolerance_proofs
            other._by_reserve = self._by_reserve
            self._by_reserve[reserve] = other
        other.solved = self.solved
        other._learn()
        return other

    def _learn(self) -> None:
        """Take over what the answers for other reserves prove."""
        for proof in self._tolerance_proofs[self._tolerance_proofs_known :]:
            self._rule_out(proof)
        self._tolerance_proofs_known = len(self._tolerance_proofs)
        for other in self._by_reserve.values():
            if other.reserve < self.reserve:
                self.ruled_out |= other.ruled_out
            for motion, known in other._motions.items():
                if other.reserve < self.reserve:
                    self._samples(motion).impossible[known.impossible] = True
                elif other.reserve > self.reserve:
                    self._samples(motion).possible.update(known.possible)

    def at(self, pose: int, hands: HandPair) -> Balanced | Unbalanced:
        """Solve (5) at a pose of the graph. An answer "unbalanced" is remembered for all nodes it holds for."""
        key = (self._alike[pose], hands)
        answer = self._answers.get(key)
        if answer is None:
            where = self.poses.poses[pose]
            answer = self.solve(where.T_world_plate, where.contact_points, hands)
            self._answers[key] = answer
            if isinstance(answer, Unbalanced) and answer.proof is not None:
                self._rule_out(answer.proof)
        return answer

    def refusal_at(self, pose: int, hands: HandPair) -> Unbalanced | None:
        """Say why not every plate within the tolerances is held at a pose of the graph, or None if all are.

        Remembered for all nodes it holds for, as the answers of `at` are.
        """
        key = (self._alike[pose], hands)
        if key not in self._refusals:
            where = self.poses.poses[pose]
            refusal = self.refusal(where.T_world_plate, where.contact_points, hands)
            self._refusals[key] = refusal
            if refusal is not None and refusal.proof is not None:
                self._rule_out(refusal.proof)
                self._tolerance_proofs.append(refusal.proof)
        return self._refusals[key]

    def solve(self, T_world_plate: Transform, contact_points: Array, hands: HandPair) -> Balanced | Unbalanced:
        """Solve (5) at any pose (4, 4), with contact points (k, 3) in the plate frame [m], without remembering."""
        self.solved += 1
        return self.balance.solve(T_world_plate[:3, :3], contact_points, *self._contacts(hands))

    def refusal(self, T_world_plate: Transform, contact_points: Array, hands: HandPair) -> Unbalanced | None:
        """Say why not every plate within the tolerances is held, or None if all are; arguments as of `solve`."""
        self.solved += 1
        return self.tolerant.refusal(T_world_plate[:3, :3], contact_points, *self._contacts(hands))

    def program(self, T_world_plate: Transform, contact_points: Array, hands: HandPair) -> ConeProgram:
        """Return (5) in numbers, for whoever relaxes its limits; arguments as of `solve`."""
        return self.balance.program(T_world_plate[:3, :3], contact_points, *self._contacts(hands))

    def learn(self, proofs: Iterable[UnbalanceProof]) -> None:
        """Test proofs that were found for other poses or holds: a motion that proves imbalance there may do so here."""
        for proof in proofs:
            self._rule_out(proof)

    def _rule_out(self, proof: UnbalanceProof) -> None:
        """Test a proof against all nodes, by what either program allows: one says no where the other does not."""
        known = np.count_nonzero(self.ruled_out)
        for table in self._tables:
            self.ruled_out |= table.infeasible(proof)
        if np.count_nonzero(self.ruled_out) - known >= _TELLING * self.ruled_out.size:
            self.telling_proofs.append(proof)

    def _twist_tables(self, rotations: Array, points: Sequence[Array]) -> tuple[TwistTable, ...]:
        """Return tables of both programs for poses (n, 3, 3), each with contact points (k, 3) [m, plate frame]."""
        return tuple(
            TwistTable(program, rotations, points, self.grips, self.pushes) for program in (self.balance, self.tolerant)
        )

    def _contacts(self, hands: HandPair) -> tuple[GripContacts | None, PushContact | None]:
        return (None if hands[0] is None else self.grips[hands[0]], None if hands[1] is None else self.pushes[hands[1]])

    def along(self, motion_number: int, hands: HandPair) -> Rejection | None:
        """Say why the plate cannot be held all along a motion of the graph, or None if it can."""
        samples = self._samples(motion_number)
        row = (0 if hands[0] is None else hands[0] + 1, 0 if hands[1] is None else hands[1] + 1)
        if samples.impossible[row]:
            return Rejection("transfer", "the plate cannot be held between two poses that can be held")
        if hands in samples.possible:
            return None
        # From the middle outwards: that is where holds fail most. The plate as stated is asked for first, everywhere:
        # one program, where all plates within the tolerances take several.
        outwards = sorted(range(len(samples.rotations)), key=lambda i: abs(2 * i - len(samples.rotations) + 1))
        contacts = self._contacts(hands)
        asked: list[Callable[[Array], Unbalanced | None]] = [partial(self._refusal_as_stated, samples.points, contacts)]
        if (motion_number, hands) not in self._steady_motions:
            asked.append(lambda rotation: self.tolerant.refusal(rotation, samples.points, *contacts))
        for ask in asked:
            for k in outwards:
                self.solved += 1
                answer = ask(samples.rotations[k])
                if answer is not None:
                    samples.impossible[row] = True
                    if answer.proof is not None:
                        for table in self._twist_tables(samples.rotations, [samples.points] * len(outwards)):
                            samples.impossible[:] |= table.infeasible(answer.proof).any(axis=0)
                    reason = "the plate cannot be held between two poses that can be held"
                    return Rejection("transfer", reason, where=f"motion {motion_number}")
        samples.possible.add(hands)
        self._steady_motions.add((motion_number, hands))
        return None

    def _refusal_as_stated(
        self, points: Array, contacts: tuple[GripContacts | None, PushContact | None], rotation: Array
    ) -> Unbalanced | None:
        """Say why the plate as stated is not held with the reserve kept, or None if it is.

        It is turned by `rotation` (3, 3) and has contact points (k, 3) in the plate frame [m].
        """
        answer = self.balance.solve(rotation, points, *contacts)
        return answer if isinstance(answer, Unbalanced) else None

    def unbalanced_motions(self) -> set[int]:
        """Return the motions along which some holds are known not to bear the plate."""
        return {motion for motion, known in self._motions.items() if known.impossible.any()}

    def impossible_holds(self, motion_number: int) -> NDArray[np.bool_]:
        """Return the (1 + grips, 1 + pushes) holds that are known not to bear the plate along a motion."""
        return self._samples(motion_number).impossible

    def _samples(self, motion_number: int) -> _MotionSamples:
        known = self._motions.get(motion_number)
        if known is None:
            i, j = self.poses.edges[motion_number]
            motion = self.poses.motion_between(int(i), int(j))
            rotations = motion.poses(self.sampling.parameters(motion))[:, :3, :3]
            impossible = np.zeros((1 + len(self.grips), 1 + len(self.pushes)), bool)
            known = _MotionSamples(rotations, motion.contact_points, impossible, set())
            self._motions[motion_number] = known
        return known


def describe(answer: Unbalanced) -> Rejection:
    """Put an unbalanced pose as a rejection, without figures.

    A search meets many poses, and does not know which of them decides: the one that misses by least is not.
    """
    return Rejection("balance", answer.reason.value)


def _first_alike(poses: DenseContactStateGraph) -> list[int]:
    """For each pose the first with the same contact and tilt: heights and places do not matter to balance."""
    first: dict[tuple[object, float, float], int] = {}
    return [
        first.setdefault((pose.contact, round(float(pose.tilt[0]), 9), round(float(pose.tilt[1]), 9)), number)
        for number, pose in enumerate(poses.poses)
    ]
