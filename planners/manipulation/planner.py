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
from planners.geometry.polyhedron import Prism
from planners.geometry.pose import Array
from planners.graph.rejections import Rejection, Rejections
from planners.graph.search import DEAD, GraphPath, cheapest_path
from planners.manipulation.assignment import HoldSplit, NoAssignment, PostureAssigner
from planners.manipulation.choreography import Choreographer, Stuck
from planners.manipulation.dense_contacts import DenseContactStateGraph
from planners.manipulation.engagements import Engagement, Itinerary, PostureFollower
from planners.manipulation.examiner import NodeExaminer, hands_of
from planners.manipulation.failures import (
    BlockedMotion,
    EdgeFailure,
    Failures,
    Hand,
    LoneTransitFailure,
    PairFailure,
    TransitFailure,
)
from planners.manipulation.graph import HandHold, build_graph, edge_count
from planners.manipulation.grips import least_opening
from planners.manipulation.groundwork import balance_program, grips_of, jaw_of, pair_reach, posture_queries, pushes_of
from planners.manipulation.hold_balance import HoldBalance
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.lift_report import LiftReport
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.rising import RisingReach
from planners.manipulation.workcell import LiftWorkcell
from planners.progress import Progress
from planners.scene.scene import PlateLiftScene
from planners.segment import Segment

ALL_POSTURES = (1 << 64) - 1


class PlateLiftPlanner:
    """All that is known about one plate lift while it is planned."""

    def __init__(self, scene: PlateLiftScene, settings: LiftSettings, progress: Progress) -> None:
        """Sample poses and holds; nothing is solved yet."""
        self.scene, self.settings, self.progress = scene, settings, progress
        self.rejections = Rejections()
        self.workcell = LiftWorkcell(scene, scene.cell.gripper_arms[0], scene.cell.pusher_arms[0])
        self.prism = Prism.from_outline(scene.plate.outline, scene.plate.height)
        self.poses = DenseContactStateGraph.build(self.prism, scene.plate.com, scene.T_world_plate, settings.sampling)
        self.grips = grips_of(self.workcell, self.prism, settings)
        self.pushes = pushes_of(self.workcell, self.prism, settings)
        self.balance_program = balance_program(scene)
        self.balance = HoldBalance(
            self.balance_program,
            self.poses,
            [GripContacts(grip.points[0], grip.normals[0]) for grip in self.grips],
            [PushContact(push.point, push.normal) for push in self.pushes],
        )
        self.counts: Counter[str] = Counter()

    # Stage by stage.

    def plan(self) -> LiftPlan:
        """Plan the lift."""
        capacity = self.capacity()
        report = LiftReport(self)
        if not capacity.suffices:
            return report.too_heavy(capacity)
        if jaw_of(self.workcell).width_max < least_opening(self.prism, self.scene.friction.grip):
            return report.too_thick()
        self.find_reach()
        edges = edge_count(self.poses, self._all_holds(), (self.grip_postures, self.push_postures))
        if edges > self.settings.largest_graph:
            return report.too_large(edges)
        self._merge(*self._all_holds())
        return self.search()

    def capacity(self) -> LiftCapacity:
        """Bound what robot and lifter can carry together off the support, at whatever tilt."""
        return self.balance_program.capacity(0.5 * math.pi)

    def build(self) -> None:
        """Find the hands' reach and merge the graph, whatever its size."""
        self.find_reach()
        self._merge(*self._all_holds())

    def find_reach(self) -> None:
        """Find out which hand reaches which pose in which postures, and what follows from it."""
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
        self.follower.rising = RisingReach(
            self.balance, self.pair, self.lifted, self.settings.rise_heights,
            balance_program(self.scene, self.settings.cup_reserve),
        )  # fmt: skip
        self.failures = Failures(self.balance)
        self.choreographer = Choreographer(
            self.workcell, self.follower, self.balance, np.random.default_rng(self.scene.seed)
        )

    def search(self) -> LiftPlan:
        """Search the graph until a sequence can be moved along, or nothing is left."""
        report = LiftReport(self)
        for _ in range(self.settings.sequences):
            path = self._best_path()
            if path is None and self.follower.rising is not None:
                # Better a plan that ends low than none.
                self.follower.rising = None
                self._merge(*self._all_holds())
                continue
            if path is None:
                return report.no_path()
            itinerary = Itinerary.of(self.graph, path)
            segments = self._realise(itinerary)
            if segments is not None:
                return report.solved(path, segments)
        return report.not_found(f"No sequence could be moved along in {self.settings.sequences} tries.")

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

    def _merge(self, grips: tuple[HandHold, ...], pushes: tuple[HandHold, ...]) -> None:
        """Build the graph of these holds, and apply all that is known to fail."""
        self.progress("merge", 0, 1)
        self.graph = build_graph(self.poses, grips, pushes, self.grip_postures, self.push_postures, self.settings.costs)
        self.failures.apply(self.graph)
        self.examiner = NodeExaminer(
            self.graph, self.balance, self.pair, self.grip_postures, self.push_postures, self.rejections,
            self.settings.minimise, self.follower.rising,
        )  # fmt: skip
        self.counts["merges"] += 1
        if self.settings.full:
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

    def _realise(self, itinerary: Itinerary) -> tuple[Segment, ...] | None:
        """Check a sequence all along and plan its motion; on failure forbid what failed."""
        self.counts["sequences"] += 1
        if self._blocked_on_the_way(itinerary) or self._unbalanced_on_the_way(itinerary):
            return None
        assigner = PostureAssigner(self.follower, itinerary, self.scene.start_positions)
        problem = assigner.problem()
        if problem is not None:
            self._forbid(problem, itinerary)
            return None
        stuck: list[tuple[Stuck, dict[Engagement, int]]] = []
        for assignment in assigner.assignments():
            if len(stuck) >= self.settings.assignments:
                break
            self.progress("motion", self.counts["assignments"], 0)
            self.counts["assignments"] += 1
            result = self.choreographer.realise(itinerary, assignment)
            if not isinstance(result, Stuck):
                return result
            stuck.append((result, assignment))
        if not stuck:
            self._forbid(assigner.pair_problem(), itinerary)
        else:
            self._forbid_stuck(itinerary, [each for each, _ in stuck])
        return None

    def _blocked_on_the_way(self, itinerary: Itinerary) -> bool:
        """Ask whether plate and cup keep clear of what stands in the cell, along every transfer of a sequence."""
        fell = False
        for number, _ in filter(None, itinerary.motions):
            names = self.follower.blocked(number)
            if names is not None:
                fell = True
                self.rejections.add(_meeting(*names), self.failures.add(BlockedMotion(number), self.graph))
        return fell

    def _unbalanced_on_the_way(self, itinerary: Itinerary) -> bool:
        """Ask for balance between the poses of every transfer of a sequence."""
        fell = False
        for place, step in enumerate(itinerary.motions):
            if step is None:
                continue
            hands = hands_of(*self.graph.hold_of(itinerary.path.nodes[place]))
            rejection = self.balance.along(step[0], hands)
            if rejection is not None:
                fell = True
                self.rejections.add(rejection, self.failures.add_unbalanced(step[0], self.graph))
        return fell

    def _forbid(self, problem: NoAssignment, itinerary: Itinerary) -> None:
        """Apply the failures found; where that takes it, tell holds apart by posture and merge anew."""
        killed = sum(self.failures.add(failure, self.graph) for failure in problem.failures)
        splits = problem.split if self.graph.graph.node_count <= self.settings.largest_split else ()
        edge = itinerary.path.edges[-1] if problem.split and not splits else problem.edge
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

    def _forbid_stuck(self, itinerary: Itinerary, stuck: list[Stuck]) -> None:
        """Forbid the change of hold (or the motion) at which most tries got stuck."""
        for each in stuck:
            self.rejections.add(each.rejection)
        places: Counter[tuple[Hand | None, int]] = Counter((each.hand, each.place) for each in stuck)
        (hand, place), _ = places.most_common(1)[0]
        grip, push = itinerary.active("grip", place), itinerary.active("push", place)
        moving = grip if hand == "grip" else push
        pose = itinerary.poses[place]
        if hand is None or moving is None:
            # The plate could not move on, or an arm could not get back to where it started.
            self.failures.add(EdgeFailure.of(self.graph, itinerary.path.edges[place]), self.graph)
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
