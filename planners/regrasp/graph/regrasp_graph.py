"""The regrasp graph of one object: initial grasps, handovers, suction grasps, handovers, goal grasps.

Paper A, Fig. 4, for both rounds of Fig. 2 at once: the first brings the tool onto the suction pose, the second brings
tool and object to the goal. A node is a grasp of the tool by one arm. An edge within an arm carries the tool
(transfer), an edge between the arms hands it over. Deciding both rounds at once rates a grasp at the suction pose by
the handovers before and after it, so that the first round does not walk into a dead end of the second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.errors import LiftwrightError
from planners.geometry.pose import Array

ROUNDS = 2
"""Tool to object, and both to the goal."""


class RegraspGraphError(LiftwrightError):
    """Layers that do not fit together, or an edge that the graph does not have."""


@dataclass(frozen=True)
class Pick:
    """The tool is held in an initial grasp: taken from its rest, or held already."""

    node: int


@dataclass(frozen=True)
class Transfer:
    """The tool goes to the end of a round within one grasp."""

    round: int
    """0 or 1."""
    node: int
    after_handover: bool
    """Whether it comes from a handover, and not from where the round began."""
    end: int
    """Which end of the round: always 0 in the first, the number of the goal pose in the second."""


@dataclass(frozen=True)
class Handover:
    """The tool goes to a handover and changes hands there."""

    round: int
    number: int
    """How many handovers come before it in its round."""
    giver: int
    receiver: int


Edge = Pick | Transfer | Handover


@dataclass(frozen=True)
class Sequence:
    """A way from an initial grasp to a goal grasp."""

    edges: tuple[Edge, ...]
    """A `Pick`, then handovers and a transfer of the first round, then those of the second."""
    goal: int
    """Number of the goal pose."""
    cost: float

    @property
    def handovers(self) -> int:
        """Number of handovers in both rounds."""
        return sum(isinstance(edge, Handover) for edge in self.edges)

    @property
    def last(self) -> int:
        """The goal node."""
        edge = self.edges[-1]
        assert isinstance(edge, Transfer)
        return edge.node


@dataclass(frozen=True, eq=False)
class RoundLayers:
    """What one round may do. Nodes are the left arm's n grasps, then the right arm's; `inf` means "not possible"."""

    direct: Array
    """(ends, 2 n) cost of going from the round's beginning to each of its ends within a grasp."""
    departing: Array
    """(2 n,) cost of going from the round's beginning to a handover."""
    arriving: Array
    """(ends, 2 n) cost of going from a handover to each end."""
    handovers: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    """(n, n) whether the left arm's grasp [row] can be handed to the right arm's [column]; and right to left."""


class LayeredRegraspGraph:
    """Layers and edges, and the best sequence among the edges that are left."""

    def __init__(self, start: NDArray[np.bool_], rounds: tuple[RoundLayers, RoundLayers], most_handovers: int) -> None:
        """Put the layers together.

        Args:
            start: (2 n,) the initial grasps.
            rounds: what the two rounds may do; the first has one end.
            most_handovers: in one round.

        Raises:
            RegraspGraphError: the layers have different numbers of grasps.
        """
        self.grasps = start.size // 2
        self.most_handovers = most_handovers
        for layers in rounds:
            _check(layers, self.grasps)
        self._start = np.where(start, 0.0, np.inf)
        self._direct = [layers.direct.copy() for layers in rounds]
        self._departing = [layers.departing for layers in rounds]
        self._arriving = [layers.arriving.copy() for layers in rounds]
        # One matrix for each handover of a round: the same two grasps may fail coming from here, and not from there.
        self._handovers = [
            [(layers.handovers[0].copy(), layers.handovers[1].copy()) for _ in range(most_handovers)]
            for layers in rounds
        ]

    @property
    def edge_count(self) -> int:
        """Number of edges that are left, each handover and each transfer counted once."""
        transfers = sum(int(np.isfinite(each).sum()) for each in (*self._direct, *self._arriving))
        handovers = sum(int(matrix.sum()) for steps in self._handovers for pair in steps[:1] for matrix in pair)
        return transfers + handovers

    def delete(self, edge: Edge) -> None:
        """Take an edge out: no sequence uses it again. A graph with fewer handovers may not have it."""
        if isinstance(edge, Pick):
            self._start[edge.node] = np.inf
            return
        if isinstance(edge, Transfer):
            costs = self._arriving if edge.after_handover else self._direct
            costs[edge.round][edge.end, edge.node] = np.inf
            return
        if edge.number >= self.most_handovers:
            return
        arm, giver = divmod(edge.giver, self.grasps)
        self._handovers[edge.round][edge.number][arm][giver, edge.receiver % self.grasps] = False

    def best(self, handovers: int | None = None) -> Sequence | None:
        """Return the cheapest sequence with this many handovers; or with as few as possible, if None."""
        counts = range(ROUNDS * self.most_handovers + 1) if handovers is None else (handovers,)
        first = [self._start]
        for number in range(min(self.most_handovers, max(counts))):
            first.append(self._handed(first[number], 0, number))
        for count in counts:
            found = [self._cheapest(first, before, count - before) for before in range(count + 1)]
            sequences = [sequence for sequence in found if sequence is not None]
            if sequences:
                return min(sequences, key=lambda sequence: sequence.cost)
        return None

    def _cheapest(self, first: list[Array], before: int, after: int) -> Sequence | None:
        """Return the cheapest sequence with `before` handovers in the first round and `after` in the second."""
        if max(before, after) > self.most_handovers:
            return None
        at_suction = first[before] + self._end_costs(0, before)[0]
        second = [at_suction]
        for number in range(after):
            second.append(self._handed(second[number], 1, number))
        at_goal = second[after] + self._end_costs(1, after)
        goal, node = divmod(int(np.argmin(at_goal)), at_goal.shape[1])
        cost = float(at_goal[goal, node])
        if not np.isfinite(cost):
            return None
        edges_after, node_at_suction = self._traced(second, 1, node, goal)
        edges_before, start = self._traced(first[: before + 1], 0, node_at_suction, 0)
        return Sequence((Pick(start), *edges_before, *edges_after), goal, cost)

    def _end_costs(self, part: int, handovers: int) -> Array:
        return self._arriving[part] if handovers else self._direct[part]

    def _handed(self, costs: Array, part: int, number: int) -> Array:
        """Costs (2 n,) of holding each grasp after one more handover, from those (2 n,) before it."""
        n = self.grasps
        giving = costs + self._departing[part] if number == 0 else costs
        left_to_right, right_to_left = self._handovers[part][number]
        return np.concatenate([_least(giving[n:], right_to_left), _least(giving[:n], left_to_right)])

    def _traced(self, costs: list[Array], part: int, node: int, end: int) -> tuple[list[Edge], int]:
        """Walk back from a node at a round's end; `costs` are those after 0, 1, … handovers."""
        handovers = len(costs) - 1
        edges: list[Edge] = [Transfer(part, node, handovers > 0, end)]
        for number in range(handovers - 1, -1, -1):
            giver = self._giver(costs[number], part, number, node)
            edges.insert(0, Handover(part, number, giver, node))
            node = giver
        return edges, node

    def _giver(self, costs: Array, part: int, number: int, receiver: int) -> int:
        n = self.grasps
        arm = 1 - receiver // n
        giving = costs + self._departing[part] if number == 0 else costs
        possible = self._handovers[part][number][arm][:, receiver % n]
        return arm * n + int(np.argmin(np.where(possible, giving[arm * n : (arm + 1) * n], np.inf)))


def _least(costs: Array, possible: NDArray[np.bool_]) -> Array:
    """Least cost (n,) over the rows of `possible` (n, n) that are true in each column."""
    rows = np.flatnonzero(np.isfinite(costs))
    if not rows.size:
        return np.full(possible.shape[1], np.inf)
    return np.where(possible[rows], costs[rows, None], np.inf).min(axis=0)


def _check(layers: RoundLayers, n: int) -> None:
    shapes = [layers.direct.shape[1:], layers.arriving.shape[1:], layers.departing.shape]
    if any(shape != (2 * n,) for shape in shapes) or any(matrix.shape != (n, n) for matrix in layers.handovers):
        raise RegraspGraphError(f"the layers of a round do not have {2 * n} nodes like the initial layer")
