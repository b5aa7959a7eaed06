"""Examine nodes of the Manipulation State Graph: can both hands be there at once, and can they bear the plate?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planners.balance.balanced import Balanced, Unbalanced, UnbalanceReason
from planners.geometry.pose import Array, Transform
from planners.geometry.wrench import rotated
from planners.graph.rejections import Rejection, Rejections
from planners.graph.search import ALIVE, DEAD, UNKNOWN, whole
from planners.manipulation.graph.manipulation_graph import HandHold, ManipulationStateGraph
from planners.manipulation.graph.rising_reach import RisingReach
from planners.manipulation.reach.hand_reach import Hand
from planners.manipulation.reach.reached_postures import ReachedPostures
from planners.manipulation.statics.hold_balance import HandPair, HoldBalance, describe
from planners.manipulation.statics.lift_torques import TORQUE_RESERVE

Objective = Literal["cost", "force"]
STANDARD_GRAVITY = np.array([0.0, 0.0, -9.81])
_LOAD_STEP = 1e-6
"""Loads by their weight are rounded to this: the solver's last digits must not decide between paths."""


class NodeExaminer:
    """Examines the nodes of one graph, on demand, and writes what it finds into the graph's knowledge.

    The load of a node is, for `minimise="cost"`, the least joint torque of its postures, the node's part of eq. (10);
    for `minimise="force"`, the largest contact normal of its hands.
    """

    def __init__(
        self,
        graph: ManipulationStateGraph,
        balance: HoldBalance,
        reached: ReachedPostures,
        rejections: Rejections,
        minimise: Objective,
        rising: RisingReach | None = None,
        gravity: Array | None = None,
    ) -> None:
        self.graph, self.balance, self.reached, self.pair = graph, balance, reached, reached.pair
        self.rejections, self.minimise, self.rising = rejections, minimise, rising
        self.gravity = STANDARD_GRAVITY if gravity is None else gravity
        self.examined = 0
        self._grip_row = _rows(graph.grips)[graph.node_grip]
        self._push_row = _rows(graph.pushes)[graph.node_push]
        self.forget_ruled_out()

    def __call__(self, node: int) -> None:
        """Examine one node."""
        self.examined += 1
        knowledge = self.graph.knowledge
        pose = int(self.graph.node_pose[node])
        grip, push = self.graph.hold_of(node)
        if grip is not None and push is not None and not self._arms_apart(pose, grip, push):
            knowledge.status[node] = DEAD
            self.rejections.add(Rejection("reach", "the two arms would touch in every pair of postures"))
            return
        answer = self.balance.at(pose, hands_of(grip, push))
        if isinstance(answer, Unbalanced):
            self.rejections.add(describe(answer))
            self.forget_ruled_out()
            knowledge.status[node] = DEAD
            return
        load = answer.f_plus_gp if self.minimise == "force" else self._torque(pose, grip, push, answer)
        knowledge.load[node] = whole(round(self.graph.load_weight * load / _LOAD_STEP) * _LOAD_STEP)
        knowledge.status[node] = ALIVE
        if self.rising is not None and self.graph.goal[node] and grip is not None and push is not None:
            self.graph.goal[node] = self.rising.bears(pose, grip, push)

    def largest_force(self, node: int) -> float:
        """Return the largest contact normal of the hands at an examined node [N]."""
        answer = self.balance.at(int(self.graph.node_pose[node]), hands_of(*self.graph.hold_of(node)))
        return answer.f_plus_gp if isinstance(answer, Balanced) else float("inf")

    def examine_all(self, done: Callable[[int, int], None]) -> None:
        """Examine every node that is still unknown; `done` is told how many of how many."""
        knowledge = self.graph.knowledge
        count = self.graph.graph.node_count
        for node in range(count):
            if knowledge.status[node] == UNKNOWN:
                self(node)
            if node % 256 == 0:
                done(node, count)

    def postures(self, hand: Hand, pose: int, hold: HandHold) -> int:
        """Return the postures of a hold that reach a pose, as a bit set."""
        return self.reached.at(hand, pose, hold.index) & hold.postures

    def _arms_apart(self, pose: int, grip: HandHold, push: HandHold) -> bool:
        where, holds = self.graph.poses.poses[pose].T_world_plate[None], (grip.index, push.index)
        # Mostly those that are known suffice.
        some = (
            self.reached.known("grip", pose, grip.index) & grip.postures,
            self.reached.known("push", pose, push.index) & push.postures,
        )
        if self.pair.compatible(where, holds, some) is not None:
            return True
        allowed = self.postures("grip", pose, grip), self.postures("push", pose, push)
        return allowed != some and self.pair.compatible(where, holds, allowed) is not None

    def bears_torques(self, node: int) -> bool:
        """Whether each hand at an examined node has a posture whose joints bear arm, hand and contact wrenches."""
        pose, hands = int(self.graph.node_pose[node]), self.graph.hold_of(node)
        answer = self.balance.at(pose, hands_of(*hands))
        assert isinstance(answer, Balanced)
        return all(
            self.reached.hand(hand).within_torque(
                T_world_plate[None], hold.index, self.postures(hand, pose, hold), wrench[None], com[None],
                self.gravity, TORQUE_RESERVE,
            )
            for T_world_plate, com, hand, hold, wrench in self._exerting(pose, *hands, answer)
        )  # fmt: skip

    def _torque(self, pose: int, grip: HandHold | None, push: HandHold | None, answer: Balanced) -> float:
        """Least joint torque that the hands' contact wrenches ask for, tau = J^T F, over the postures [Nm]."""
        total = 0.0
        for T_world_plate, com, hand, hold, wrench in self._exerting(pose, grip, push, answer):
            known = self.reached.known(hand, pose, hold.index)
            reach = self.reached.hand(hand)
            total += reach.least_load(T_world_plate, hold.index, hold.postures, wrench, com, known)
        return total

    def _exerting(
        self, pose: int, grip: HandHold | None, push: HandHold | None, answer: Balanced
    ) -> Iterator[tuple[Transform, Array, Hand, HandHold, Array]]:
        """Yield of each hand: plate (4, 4), its centre of mass (3,), hand, hold, and the wrench (6,) about that centre.

        All in world axes [m, N, Nm].
        """
        T_world_plate = self.graph.poses.poses[pose].T_world_plate
        com = T_world_plate[:3, :3] @ self.balance.balance.com + T_world_plate[:3, 3]
        wrenches = rotated(T_world_plate[:3, :3], answer.hand_wrenches)
        if grip is not None:
            yield T_world_plate, com, "grip", grip, wrenches[0]
        if push is not None:
            yield T_world_plate, com, "push", push, wrenches[1]

    def forget_ruled_out(self) -> None:
        """Mark the nodes that proofs of imbalance have ruled out since."""
        knowledge = self.graph.knowledge
        ruled_out = self.balance.ruled_out[self.graph.node_pose, self._grip_row, self._push_row]
        fallen = ruled_out & (knowledge.status == UNKNOWN)
        self.rejections.add(Rejection("balance", UnbalanceReason.PROVEN.value), int(fallen.sum()))
        knowledge.status[fallen] = DEAD


def hands_of(grip: HandHold | None, push: HandHold | None) -> HandPair:
    """Return the numbers of the holds that the hands are in, postures aside."""
    return (None if grip is None else grip.index, None if push is None else push.index)


def _rows(holds: tuple[HandHold, ...]) -> NDArray[np.int64]:
    """Return the rows (1 + holds,) that hold numbers (0: absent) have in the balance tables."""
    return np.array([0, *(hold.index + 1 for hold in holds)])
