"""Search the Manipulation State Graph until a sequence of holds can be moved along (paper B, V-B).

What the paper does not have: every edge of a sequence is checked all along, not only at its ends. An edge that fails is
deleted with its reason and the graph is searched again, so that no sequence jumps over poses at which the plate could
not be held.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import reduce
from operator import or_

import numpy as np

from planners.errors import PlanningFaultError
from planners.graph.passage import connected_to, passable_path
from planners.graph.rejections import Rejection, Rejections
from planners.graph.search import DEAD, UNKNOWN, GoalSearch, GraphPath
from planners.manipulation.graph.failures import (
    BlockedMotion,
    EdgeFailure,
    Failures,
    LoneTransitFailure,
    PairFailure,
    TransitFailure,
)
from planners.manipulation.graph.manipulation_graph import HandHold, ManipulationStateGraph
from planners.manipulation.graph.node_examiner import NodeExaminer, hands_of
from planners.manipulation.lift_reach import LiftReach, meeting
from planners.manipulation.lift_segment import LiftSegment
from planners.manipulation.motion.assignment import HoldSplit, NoAssignment, PostureAssigner
from planners.manipulation.motion.choreography import Choreographer, StuckStep
from planners.manipulation.motion.manipulation_sequence import HoldPhase, ManipulationSequence
from planners.manipulation.reach.hand_reach import Hand
from planners.manipulation.reach.reached_postures import ReachedPostures
from planners.manipulation.statics.hold_balance import HoldBalance
from planners.manipulation.statics.lift_torques import OVERTAXED
from planners.progress import Progress, Report

UNSTEADY = "A plate within the tolerances of mass and centre of mass is not held where the stated one is."
"""Why a node falls that balances the stated plate."""


@dataclass(frozen=True, eq=False)
class LiftRecord:
    """What is told while a lift is planned, and what is counted for its report."""

    progress: Progress
    rejections: Rejections = field(default_factory=Rejections)
    counts: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True, eq=False)
class Found:
    """A sequence that was found, and its motion."""

    path: GraphPath
    segments: tuple[LiftSegment, ...]


class NothingFound(Enum):
    """How a search ended that found nothing."""

    NO_PATH = "no path is left in the graph"
    NO_TRIES = "so many sequences could not be moved along"


class LiftSearch:
    """One graph of one lift, and its search with one share of all limits kept back."""

    def __init__(
        self,
        reach: LiftReach,
        balance: HoldBalance,
        rises: Sequence[tuple[float, ...]],
        failures: Failures,
        record: LiftRecord,
        *,
        full: bool,
    ) -> None:
        """Merge the graph of all holds, and apply all that is known to fail.

        Args:
            reach: of the hands.
            balance: who is asked whether holds bear the plate.
            rises: heights to which both hands have to carry the plate up from the end, the next where no plan ends so;
                at last none [m].
            failures: that are known.
            record: what happens is added.
            full: whether to examine all nodes before anything is searched.
        """
        self.reach, self.balance, self.failures, self.record = reach, balance, failures, record
        self.sampling, self.settings = reach.sampling, reach.sampling.settings
        first, *self._lower = [*rises, ()]
        self.rising = reach.rising(first, balance)
        """What goals have to do so that the lift can go on; None: nothing."""
        self.choreographer = Choreographer(
            self.sampling.workcell, reach.follower, balance, np.random.default_rng(self.sampling.scene.seed)
        )
        self._full = full
        self.paths: dict[int, GraphPath | None] = {}
        self.graph, self.examiner = self._merged(*self.sampling.holds)
        self._goal_search = self._searching(self.graph)
        self._cut_off = np.zeros(self.graph.graph.node_count, bool)
        """Nodes from which no goal can be come to: what fails only grows, so that it stays so."""

    def find(self, *, low: bool = True, thorough: bool = True) -> Found | NothingFound:
        """Search the graph until a sequence can be moved along, or nothing is left.

        Args:
            low: whether a plan may end where the lift cannot go on, if there is no other.
            thorough: whether all that can be come to is examined where there is no sequence, and not a cut alone.
        """
        asked: ManipulationStateGraph | None = None
        for _ in range(self.settings.sequences):
            if thorough or asked is self.graph or self.any_way() is not None:
                asked = self.graph
                path = self.best_path()
            else:
                path = None
            if path is None and low and self._lower:
                # Better a plan that ends low than none.
                self.rising = self.reach.rising(self._lower.pop(0), self.balance)
                self._merge(*self.sampling.holds, goals=False)
                continue
            if path is None:
                return NothingFound.NO_PATH
            sequence = ManipulationSequence.of(self.graph, path)
            known = self._known_to_fail()
            segments = self._realise(sequence)
            if segments is not None:
                return Found(path, segments)
            self._require_more_than(known)
        return NothingFound.NO_TRIES

    def any_way(self) -> GraphPath | None:
        """Return any way to a goal along which the plate is held; what fails on the way is forbidden to the search."""
        graph = self.graph
        while True:
            starts = [node for node in graph.starts if node not in graph.lost_starts]
            path = passable_path(graph.graph, graph.knowledge, starts, graph.goal, self.examiner)
            known = self._known_to_fail()
            if path is None or not self._falls(ManipulationSequence.of(graph, path)):
                return path
            self._require_more_than(known)

    def is_way(self, path: GraphPath) -> bool:
        """Tell whether the plate is held along a path of the graph of all holds, which was a way to a goal before."""
        return self._is_open(path) and not self._falls(ManipulationSequence.of(self.graph, path))

    def _is_open(self, path: GraphPath) -> bool:
        """Examine a way to a goal of the graph of all holds: whether it is one of now."""
        graph, knowledge = self.graph, self.graph.knowledge
        if path.nodes[0] in graph.lost_starts or knowledge.edge_dead[list(path.edges)].any():
            return False
        for node in path.nodes:
            if knowledge.status[node] == UNKNOWN:
                self.examiner(node)
            if knowledge.status[node] == DEAD:
                return False
        return bool(graph.goal[path.nodes[-1]])

    def _merge(self, grips: tuple[HandHold, ...], pushes: tuple[HandHold, ...], *, goals: bool) -> None:
        """Build another graph. What is known of nodes stays known; of goals too, if they still have to do the same."""
        self.graph, self.examiner = self._merged(grips, pushes, (self.graph, self.examiner), goals=goals)
        self._goal_search = self._searching(self.graph)
        self.paths = {}
        self._cut_off = np.zeros(self.graph.graph.node_count, bool)

    def _merged(
        self,
        grips: tuple[HandHold, ...],
        pushes: tuple[HandHold, ...],
        before: tuple[ManipulationStateGraph, NodeExaminer] | None = None,
        *,
        goals: bool = True,
    ) -> tuple[ManipulationStateGraph, NodeExaminer]:
        """Build the graph of these holds, and apply all that is known to fail, and of nodes of the graph before it."""
        progress = self.record.progress
        progress(Report("merge", 0, 1))
        graph = self.reach.graph(grips, pushes)
        self.failures.apply(graph)
        gravity = self.sampling.scene.cell.gravity
        examiner = NodeExaminer(
            graph,
            self.balance,
            self.reach.reached,
            self.record.rejections,
            self.settings.minimise,
            self.rising,
            gravity,
        )
        if before is not None:
            graph.learn_from(before[0], goals=goals)
            examiner.examined = before[1].examined
        self.record.counts["merges"] += 1
        if self._full:
            examiner.examine_all(lambda n, total: progress(Report("examine", n, total)))
        progress(Report("merge", 1, 1))
        return graph, examiner

    # Searching.

    def _searching(self, graph: ManipulationStateGraph) -> GoalSearch:
        by_force = self.settings.minimise == "force"
        return GoalSearch(graph.graph, graph.knowledge, graph.goal, self._examine, bottleneck=by_force)

    def best_path(self) -> GraphPath | None:
        """Select as the paper does: the cheapest path of every start, and of these the one of least force."""
        found: list[tuple[float, float, int, GraphPath]] = []
        for start in self.graph.starts:
            path = self._path_from(start)
            if path is not None:
                forces = [self.examiner.largest_force(node) for node in path.nodes]
                found.append((max(forces), sum(forces), start, path))
        return min(found, key=lambda entry: entry[:3])[3] if found else None

    def _path_from(self, start: int) -> GraphPath | None:
        """Return the cheapest path of a start; searched again only if something on the last one fell."""
        if start in self.graph.lost_starts or self._cut_off[start]:
            return None
        known = self.paths.get(start)
        if start in self.paths and (known is None or not self._fell(known)):
            return known
        self.record.counts["searches"] += 1
        self.paths[start] = self._goal_search.path_from(start)
        if self.paths[start] is None and self.graph.knowledge.status[start] != DEAD:
            # Edges lead both ways: what is joined to this start does not come to a goal either.
            self._cut_off |= connected_to(self.graph.graph, self.graph.knowledge, start)
        return self.paths[start]

    def _examine(self, node: int) -> None:
        """Examine a node, and tell now and then how many are settled, by examination or by another's proof."""
        self.examiner(node)
        if self.examiner.examined % 64 == 0:
            status = self.graph.knowledge.status
            self.record.progress(Report("search", int(np.count_nonzero(status)), len(status)))

    def _fell(self, path: GraphPath) -> bool:
        knowledge = self.graph.knowledge
        return bool(knowledge.edge_dead[list(path.edges)].any() or (knowledge.status[list(path.nodes)] == DEAD).any())

    # Turning a sequence into motion.

    def _realise(self, sequence: ManipulationSequence) -> tuple[LiftSegment, ...] | None:
        """Check a sequence all along and plan its motion; on failure forbid what failed."""
        self.record.counts["sequences"] += 1
        if self._falls(sequence):
            return None
        assigner = PostureAssigner(self.reach.follower, sequence, self.sampling.scene.start_positions, self.rising)
        problem = assigner.problem()
        if problem is not None:
            self._forbid(problem, sequence)
            return None
        stuck: list[tuple[StuckStep, dict[HoldPhase, int]]] = []
        for assignment in assigner.assignments():
            if len(stuck) >= self.settings.assignments:
                break
            self.record.progress(Report("motion", self.record.counts["assignments"], 0))
            self.record.counts["assignments"] += 1
            result = self.choreographer.realise(sequence, assignment)
            if not isinstance(result, StuckStep):
                return result
            stuck.append((result, assignment))
        if not stuck:
            self._forbid(assigner.pair_problem(), sequence)
        else:
            self._forbid_stuck(sequence, [each for each, _ in stuck])
        return None

    def _falls(self, sequence: ManipulationSequence) -> bool:
        """Ask whether the plate cannot be held or moved along a sequence, whatever the arms do; forbid what fails."""
        return self._blocked_on_the_way(sequence) or self._unsteady(sequence) or self._unbalanced_on_the_way(sequence)

    def _blocked_on_the_way(self, sequence: ManipulationSequence) -> bool:
        """Ask whether plate and cup keep clear of what stands in the cell, along every transfer of a sequence."""
        fell = False
        for number, _ in filter(None, sequence.motions):
            names = self.reach.follower.blocked(number)
            if names is not None:
                fell = True
                self.record.rejections.add(meeting(*names), self.failures.add(BlockedMotion(number), self.graph))
        return fell

    def _unsteady(self, sequence: ManipulationSequence) -> bool:
        """Ask at the poses of a sequence whether every plate within the tolerances, and every joint, is held there."""
        knowledge, fell = self.graph.knowledge, False
        for node in sequence.path.nodes:
            hands = hands_of(*self.graph.hold_of(node))
            refusal = self.balance.refusal_at(int(self.graph.node_pose[node]), hands)
            why = Rejection("balance", UNSTEADY) if refusal is not None else None
            if why is None and not self.examiner.bears_torques(node):
                why = Rejection("torque", OVERTAXED)
            if why is not None:
                fell = True
                knowledge.status[node] = DEAD
                self.record.rejections.add(why)
        if fell:
            self.examiner.forget_ruled_out()
        return fell

    def _known_to_fail(self) -> tuple[int, int, int, int]:
        """Count what is known to fail: a failed sequence must add to it, or it would be tried for ever."""
        knowledge = self.graph.knowledge
        dead = int(np.count_nonzero(knowledge.edge_dead)), int(np.count_nonzero(knowledge.status == DEAD))
        return (*dead, len(self.graph.lost_starts), self.record.counts["merges"])

    def _require_more_than(self, known: tuple[int, int, int, int]) -> None:
        """Refuse to go on where a sequence failed, and no more is known to fail than before."""
        if self._known_to_fail() == known:
            told = "; ".join(f"{reason} ({count})" for reason, count in self.record.rejections.counts().items())
            raise PlanningFaultError(f"a sequence failed, and nothing was forbidden by it; so far: {told}")

    def _unbalanced_on_the_way(self, sequence: ManipulationSequence) -> bool:
        """Ask for balance between the poses of every transfer of a sequence."""
        fell = False
        for place, step in enumerate(sequence.motions):
            if step is None:
                continue
            hands = hands_of(*self.graph.hold_of(sequence.path.nodes[place]))
            rejection = self.balance.along(step[0], hands)
            if rejection is not None:
                fell = True
                self.record.rejections.add(rejection, self.failures.add_unbalanced(step[0], self.graph))
        return fell

    def _forbid(self, problem: NoAssignment, sequence: ManipulationSequence) -> None:
        """Apply the failures found; where that takes it, tell holds apart by posture and merge anew."""
        killed = sum(self.failures.add(failure, self.graph) for failure in problem.failures)
        splits = problem.split if self.graph.graph.node_count <= self.settings.largest_split else ()
        edge = sequence.path.edges[-1] if problem.split and not splits else problem.edge
        if edge is not None:
            killed += self.failures.add(EdgeFailure.of(self.graph, edge), self.graph)
        self.record.rejections.add(problem.rejection, max(1, killed))
        if not splits:
            return
        grips, pushes = self.graph.grips, self.graph.pushes
        for split in splits:
            if split.hand == "grip":
                grips = _told_apart(grips, split, self.reach.reached)
            else:
                pushes = _told_apart(pushes, split, self.reach.reached)
        self.record.counts["splits"] += 1
        self._merge(grips, pushes, goals=True)

    def _forbid_stuck(self, sequence: ManipulationSequence, stuck: list[StuckStep]) -> None:
        """Forbid the change of hold (or the motion) at which most tries got stuck."""
        for each in stuck:
            self.record.rejections.add(each.rejection)
        places: Counter[tuple[Hand | None, int]] = Counter((each.hand, each.place) for each in stuck)
        (hand, place), _ = places.most_common(1)[0]
        grip, push = sequence.active("grip", place), sequence.active("push", place)
        moving = grip if hand == "grip" else push
        pose = sequence.poses[place]
        if hand is None or moving is None:
            # The plate could not move on, or an arm could not get back to where it started.
            self.failures.add(EdgeFailure.of(self.graph, sequence.path.edges[place]), self.graph)
        elif grip is not None and push is not None:
            failure = PairFailure(grip.hold, push.hold, pose=pose, changing=hand)
            self.failures.add(failure, self.graph)
            in_vain = self.failures.coming_in_vain(failure)
            if len(in_vain) >= self.settings.stuck_pairs:
                # The other hand is hardly what is in the way, and the rest of its holds would take all tries there are.
                postures = reduce(or_, (each.postures for each in in_vain))
                self.failures.add(TransitFailure(pose, hand, moving.hold.index, ~postures), self.graph)
        elif place == 0:
            self.failures.add(LoneTransitFailure(moving.hold, hand), self.graph)
        else:
            self.failures.add(TransitFailure(pose, hand, moving.hold.index, ~moving.hold.postures), self.graph)


def _told_apart(holds: tuple[HandHold, ...], split: HoldSplit, reached: ReachedPostures) -> tuple[HandHold, ...]:
    """Replace a hold by its parts, as far as they reach any pose."""
    index = split.hold.index
    anywhere = int(np.bitwise_or.reduce(reached.of_hold(split.hand, index)))
    parts = tuple(HandHold(index, part & anywhere) for part in split.parts if part & anywhere)
    return tuple(other for other in holds if other != split.hold) + parts
