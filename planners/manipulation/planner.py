"""Plan a plate lift: build the Manipulation State Graph, search it, and turn the sequence found into checked motion.

Paper B, sections IV and V. What the paper does not have: every edge of a sequence is checked all along, not only at
its ends. An edge that fails is deleted with its reason and the graph is searched again, so that no sequence jumps
over poses at which the plate could not be held.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from planners.balance.capacity import LiftCapacity
from planners.balance.contacts import GripContacts, PushContact
from planners.errors import PlanningFaultError
from planners.geometry.polyhedron import Prism
from planners.geometry.pose import Array
from planners.graph.passage import passable_path
from planners.graph.rejections import Rejection, Rejections
from planners.graph.search import DEAD, UNKNOWN, GraphPath, cheapest_path
from planners.manipulation.contacts.dense_contact_states import DenseContactStateGraph
from planners.manipulation.graph.failures import (
    BlockedMotion,
    EdgeFailure,
    Failures,
    Hand,
    LoneTransitFailure,
    PairFailure,
    TransitFailure,
)
from planners.manipulation.graph.manipulation_graph import HandHold, ManipulationStateGraph, build_graph, edge_count
from planners.manipulation.graph.node_examiner import NodeExaminer, hands_of
from planners.manipulation.graph.rising_reach import RisingReach
from planners.manipulation.groundwork import (
    balance_program,
    grips_of,
    jaw_of,
    keeping_back,
    pair_reach,
    posture_queries,
    pushes_of,
    tolerant_program,
)
from planners.manipulation.holds.grips import least_opening
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.lift_report import LiftReport
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.motion.assignment import HoldSplit, NoAssignment, PostureAssigner
from planners.manipulation.motion.choreography import Choreographer, Stuck
from planners.manipulation.motion.manipulation_sequence import HoldPhase, ManipulationSequence
from planners.manipulation.motion.posture_follower import PostureFollower
from planners.manipulation.reach.lift_workcell import LiftWorkcell
from planners.manipulation.statics.hold_balance import BalancePrograms, HoldBalance
from planners.manipulation.statics.lift_torques import OVERTAXED
from planners.progress import Progress
from planners.scene.arm_span import ArmSpan, OutOfReach, out_of_reach
from planners.scene.scene import PlateLiftScene
from planners.segment import Segment

ALL_POSTURES = (1 << 64) - 1
UNSTEADY = "A plate within the tolerances of mass and centre of mass is not held where the stated one is."
"""Why a node falls that balances the stated plate."""

NO_WAY = "No sequence of holds leads from the support into the air."
"""What is said where nobody asks for the causes."""


class PlateLiftPlanner:
    """All that is known about one plate lift while it is planned."""

    def __init__(self, scene: PlateLiftScene, settings: LiftSettings, progress: Progress) -> None:
        """Sample poses and holds; nothing is solved yet."""
        self.scene, self.settings, self.progress = scene, settings, progress
        self.rejections = Rejections()
        self.reserve = settings.reserve
        """Share of every limit that is kept back in the search [1]."""
        self.workcell = LiftWorkcell(scene, scene.cell.gripper_arms[0], scene.cell.pusher_arms[0])
        self.prism = Prism.from_outline(scene.plate.outline, scene.plate.height)
        self.poses = DenseContactStateGraph.build(self.prism, scene.plate.com, scene.T_world_plate, settings.sampling)
        self.grips = grips_of(self.workcell, self.prism, settings)
        self.pushes = pushes_of(self.workcell, self.prism, settings)
        self.stated = balance_program(scene)
        """Program (5) for the plate as stated, with nothing kept back."""
        self.balance = self._hold_balance(settings.reserve)
        self.counts: Counter[str] = Counter()
        self.fits = True
        """Whether the graph fits into memory."""
        self._whole: ManipulationStateGraph | None = None
        self._risings: dict[tuple[float, ...], RisingReach] = {}
        self._way: GraphPath | None = None

    # Stage by stage.

    def plan(self, *, explained: bool = True) -> LiftPlan:
        """Plan the lift with this sampling, and the reserve of the settings; for `explained` see `search`."""
        capacity = self.capacity()
        report = LiftReport(self)
        if not capacity.suffices:
            return report.too_heavy(capacity)
        if jaw_of(self.workcell).width_max < least_opening(self.prism, self.scene.friction.grip):
            return report.too_thick()
        beyond = self._out_of_reach()
        if beyond is not None:
            return report.out_of_reach(beyond)
        self.find_reach()
        edges = edge_count(self.poses, self._all_holds(), (self.grip_postures, self.push_postures))
        self.fits = edges <= self.settings.largest_graph
        if not self.fits:
            return report.too_large(edges)
        self._merge(*self._all_holds())
        return self.search(explained=explained)

    def capacity(self) -> LiftCapacity:
        """Bound what robot and lifter can carry together off the support, at whatever tilt, with nothing kept back."""
        return self.stated.capacity(0.5 * math.pi)

    def plan_keeping(self, reserve: float, *, low: bool = True, explained: bool = True) -> LiftPlan:
        """Search again with another share of every limit kept back; what does not depend on it stays known.

        Args:
            reserve: [1].
            low: whether a plan may end where the lift cannot go on, if there is no other.
            explained: see `search`.
        """
        self._keep_back(reserve)
        self._weigh()
        self._merge(*self._all_holds())
        if not low and not explained and self._way_left() is None:
            return LiftReport(self).not_found(NO_WAY)
        return self.search(low=low, explained=explained)

    def may_keep(self, reserve: float, *, low: bool) -> bool:
        """Ask whether a plan could keep a share of every limit back: False proves that `plan_keeping` finds none.

        Poses, holds and transfers of the plate have to leave a way; the motion of the arms is not asked for.

        Args:
            reserve: [1].
            low: as for `plan_keeping`.
        """
        self._keep_back(reserve)
        self._weigh(() if low else self.settings.rises[:1])
        self._merge(*self._all_holds(), full=False)
        # What was a way with another reserve often is one with this.
        known = self._way
        if known is not None and self._is_open(known) and not self._falls(ManipulationSequence.of(self.graph, known)):
            return True
        found = self._way_left()
        self._way = found or known
        return found is not None

    def _way_left(self) -> GraphPath | None:
        """Return any way to a goal along which the plate is held; what fails on the way is forbidden to the search."""
        graph = self.graph
        while True:
            starts = [node for node in graph.starts if node not in graph.lost_starts]
            path = passable_path(graph.graph, graph.knowledge, starts, graph.goal, self.examiner)
            known = self._known_to_fail()
            if path is None or not self._falls(ManipulationSequence.of(graph, path)):
                return path
            self._require_more_than(known)

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

    def _keep_back(self, reserve: float) -> None:
        self.reserve = reserve
        self.balance = self.balance.keeping(keeping_back(self.stated, reserve=reserve), reserve)

    def _out_of_reach(self) -> OutOfReach | None:
        """Prove that neither hand reaches the plate where it lies, if it is so: nothing else could move it first."""
        plate = self.scene.plate
        spans = [ArmSpan.of(arm) for arm in self.scene.cell.arms.values()]
        radius = float(np.linalg.norm(plate.solid.surface()[0], axis=1).max())
        return out_of_reach(spans, plate.T_world_body[:3, 3], radius)

    def build(self) -> None:
        """Find the hands' reach and merge the graph, whatever its size."""
        self.find_reach()
        self._merge(*self._all_holds())

    def plan_as_stated(self) -> LiftPlan:
        """Search for a plan that holds the plate as stated, whatever its tolerances, with nothing kept back."""
        self.reserve = 0.0
        self.balance = HoldBalance(
            BalancePrograms(self.stated, self.stated, 0.0), self.poses, self.balance.grips, self.balance.pushes
        )
        self._weigh()
        self._merge(*self._all_holds())
        return self.search()

    def find_reach(self) -> None:
        """Find out which hand reaches which pose in which postures, and what follows from it."""
        self._whole, self._risings, self._way = None, {}, None
        self.pair = pair_reach(self.workcell, self.grips, self.pushes, self.settings.pushes.rolls)
        plates = np.array([pose.T_world_plate for pose in self.poses.poses])
        self.grip_postures, self.push_postures = self.pair.postures(
            plates, lambda done: self.progress("reach", done, len(plates))
        )
        self.lifted = self.workcell.plate_query(self.workcell.holding, self.workcell.lifted, hands=[])
        self._forbid_blocked_poses(plates)
        reach: dict[Hand, NDArray[np.uint64]] = {"grip": self.grip_postures, "push": self.push_postures}
        queries = posture_queries(self.workcell, self.lifted)
        self.follower = PostureFollower(self.poses, self.pair, queries, (self.grips, self.pushes), reach)
        self.failures = Failures(self.balance)
        self._weigh()

    def _weigh(self, rises: tuple[tuple[float, ...], ...] | None = None) -> None:
        """Let everything that asks for forces ask the balance program of now; `rises` other than the settings'."""
        first, *self._rises = [*(self.settings.rises if rises is None else rises), ()]
        self.follower.rising = self._rise(first)
        self.failures = self.failures.of_reach(self.balance)
        self.choreographer = Choreographer(
            self.workcell, self.follower, self.balance, np.random.default_rng(self.scene.seed)
        )

    def _rise(self, heights: tuple[float, ...]) -> RisingReach | None:
        """Return what goals have to do; none where no height is asked for."""
        if not heights:
            return None
        kept = keeping_back(self.stated, self.settings.cup_reserve, self.reserve)
        known = self._risings.get(heights)
        if known is None:
            known = self._risings[heights] = RisingReach(self.balance, self.pair, self.lifted, heights, kept)
        return known.keeping(self.balance, kept)

    def _hold_balance(self, reserve: float) -> HoldBalance:
        return HoldBalance(
            BalancePrograms(
                keeping_back(self.stated, reserve=reserve), tolerant_program(self.scene, self.stated), reserve
            ),
            self.poses,
            [GripContacts(grip.points[0], grip.normals[0]) for grip in self.grips],
            [PushContact(push.point, push.normal) for push in self.pushes],
        )

    def search(self, *, low: bool = True, explained: bool = True) -> LiftPlan:
        """Search the graph until a sequence can be moved along, or nothing is left.

        Args:
            low: see `plan_keeping`.
            explained: whether to look for the causes where nothing is found; that takes balances of its own.
        """
        report = LiftReport(self)
        for _ in range(self.settings.sequences):
            path = self._best_path()
            if path is None and low and self._rises:
                # Better a plan that ends low than none.
                self.follower.rising = self._rise(self._rises.pop(0))
                self._merge(*self._all_holds())
                continue
            if path is None:
                return report.no_path() if explained else report.not_found(NO_WAY)
            sequence = ManipulationSequence.of(self.graph, path)
            known = self._known_to_fail()
            segments = self._realise(sequence)
            if segments is not None:
                return report.solved(path, segments)
            self._require_more_than(known)
        return report.not_found(f"No sequence could be moved along in {self.settings.sequences} tries.")

    @property
    def rises(self) -> bool:
        """Whether the plan that was found ends where the lift can go on."""
        return self.follower.rising is not None

    # Building.

    def _all_holds(self) -> tuple[tuple[HandHold, ...], tuple[HandHold, ...]]:
        """Return all grips and pushes, in any posture."""
        return (
            tuple(HandHold(grip.index, ALL_POSTURES) for grip in self.grips),
            tuple(HandHold(push.index, ALL_POSTURES) for push in self.pushes),
        )

    def _forbid_blocked_poses(self, T_world_plates: Array) -> None:
        """Take all holds from the poses at which plate or cup meet something that stands in the cell."""
        for names in self.lifted.meetings(T_world_plates):
            self.rejections.add(_meeting(*names))
        blocked = self.lifted.first_collisions(T_world_plates) >= 0
        self.grip_postures[blocked] = 0
        self.push_postures[blocked] = 0

    def _merge(self, grips: tuple[HandHold, ...], pushes: tuple[HandHold, ...], *, full: bool | None = None) -> None:
        """Build the graph of these holds, and apply all that is known to fail.

        Args:
            grips: of the graph.
            pushes: likewise.
            full: whether to examine all nodes; as the settings say if left out.
        """
        self.progress("merge", 0, 1)
        # The graph of all holds is asked for again and again.
        known = self._whole
        if known is None or (known.grips, known.pushes) != (grips, pushes):
            # Two of the largest would not fit into memory.
            self._whole = None
            postures = self.grip_postures, self.push_postures
            known = build_graph(self.poses, grips, pushes, *postures, self.settings.costs)
            if (grips, pushes) == self._all_holds():
                self._whole = known
        self.graph = known.unexamined()
        self.failures.apply(self.graph)
        self.examiner = NodeExaminer(
            self.graph, self.balance, self.pair, self.grip_postures, self.push_postures, self.rejections,
            self.settings.minimise, self.follower.rising, self.scene.cell.gravity,
        )  # fmt: skip
        self.counts["merges"] += 1
        if self.settings.full if full is None else full:
            self.examiner.examine_all(lambda n, total: self.progress("examine", n, total))
        self.paths: dict[int, GraphPath | None] = {}
        self.progress("merge", 1, 1)

    # Searching.

    def _best_path(self) -> GraphPath | None:
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
        if start in self.graph.lost_starts:
            return None
        known = self.paths.get(start)
        if start in self.paths and (known is None or not self._fell(known)):
            return known
        self.counts["searches"] += 1
        heuristic = self.graph.heuristic if self.settings.minimise == "cost" else np.zeros_like(self.graph.heuristic)
        self.paths[start] = cheapest_path(
            self.graph.graph, self.graph.knowledge, start, self.graph.goal, heuristic, self._examine,
            bottleneck=self.settings.minimise == "force",
        )  # fmt: skip
        return self.paths[start]

    def _examine(self, node: int) -> None:
        """Examine a node, and tell now and then how many are settled, by examination or by another's proof."""
        self.examiner(node)
        if self.examiner.examined % 64 == 0:
            status = self.graph.knowledge.status
            self.progress("search", int(np.count_nonzero(status)), len(status))

    def _fell(self, path: GraphPath) -> bool:
        knowledge = self.graph.knowledge
        return bool(knowledge.edge_dead[list(path.edges)].any() or (knowledge.status[list(path.nodes)] == DEAD).any())

    # Turning a sequence into motion.

    def _realise(self, sequence: ManipulationSequence) -> tuple[Segment, ...] | None:
        """Check a sequence all along and plan its motion; on failure forbid what failed."""
        self.counts["sequences"] += 1
        if self._falls(sequence):
            return None
        assigner = PostureAssigner(self.follower, sequence, self.scene.start_positions)
        problem = assigner.problem()
        if problem is not None:
            self._forbid(problem, sequence)
            return None
        stuck: list[tuple[Stuck, dict[HoldPhase, int]]] = []
        for assignment in assigner.assignments():
            if len(stuck) >= self.settings.assignments:
                break
            self.progress("motion", self.counts["assignments"], 0)
            self.counts["assignments"] += 1
            result = self.choreographer.realise(sequence, assignment)
            if not isinstance(result, Stuck):
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
            names = self.follower.blocked(number)
            if names is not None:
                fell = True
                self.rejections.add(_meeting(*names), self.failures.add(BlockedMotion(number), self.graph))
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
                self.rejections.add(why)
        if fell:
            self.examiner.forget_ruled_out()
        return fell

    def _known_to_fail(self) -> tuple[int, int, int, int]:
        """Count what is known to fail: a failed sequence must add to it, or it would be tried for ever."""
        knowledge = self.graph.knowledge
        dead = int(np.count_nonzero(knowledge.edge_dead)), int(np.count_nonzero(knowledge.status == DEAD))
        return (*dead, len(self.graph.lost_starts), self.counts["merges"])

    def _require_more_than(self, known: tuple[int, int, int, int]) -> None:
        """Refuse to go on where a sequence failed, and no more is known to fail than before."""
        if self._known_to_fail() == known:
            told = "; ".join(f"{reason} ({count})" for reason, count in self.rejections.counts().items())
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
                self.rejections.add(rejection, self.failures.add_unbalanced(step[0], self.graph))
        return fell

    def _forbid(self, problem: NoAssignment, sequence: ManipulationSequence) -> None:
        """Apply the failures found; where that takes it, tell holds apart by posture and merge anew."""
        killed = sum(self.failures.add(failure, self.graph) for failure in problem.failures)
        splits = problem.split if self.graph.graph.node_count <= self.settings.largest_split else ()
        edge = sequence.path.edges[-1] if problem.split and not splits else problem.edge
        if edge is not None:
            killed += self.failures.add(EdgeFailure.of(self.graph, edge), self.graph)
        self.rejections.add(problem.rejection, max(1, killed))
        if not splits:
            return
        grips, pushes = self.graph.grips, self.graph.pushes
        for split in splits:
            if split.hand == "grip":
                grips = _told_apart(grips, split, self.grip_postures)
            else:
                pushes = _told_apart(pushes, split, self.push_postures)
        self.counts["splits"] += 1
        self._merge(grips, pushes)

    def _forbid_stuck(self, sequence: ManipulationSequence, stuck: list[Stuck]) -> None:
        """Forbid the change of hold (or the motion) at which most tries got stuck."""
        for each in stuck:
            self.rejections.add(each.rejection)
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
        elif place == 0:
            self.failures.add(LoneTransitFailure(moving.hold, hand), self.graph)
        else:
            self.failures.add(TransitFailure(pose, hand, moving.hold.index, ~moving.hold.postures), self.graph)


def _told_apart(holds: tuple[HandHold, ...], split: HoldSplit, reach: NDArray[np.uint64]) -> tuple[HandHold, ...]:
    """Replace a hold by its parts, as far as they reach any pose."""
    index = split.hold.index
    anywhere = int(np.bitwise_or.reduce(reach[:, index]))
    parts = tuple(HandHold(index, part & anywhere) for part in split.parts if part & anywhere)
    return tuple(other for other in holds if other != split.hold) + parts


def _meeting(one: str, other: str) -> Rejection:
    body, obstacle = (one, other) if one in ("plate", "cup") else (other, one)
    return Rejection("clearance", f"the {body} would touch {obstacle}")
