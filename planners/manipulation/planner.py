"""Plan a plate lift: build the Manipulation State Graph, search it, and turn the sequence found into checked motion.

Paper B, sections IV and V. What the paper does not have: every edge of a sequence is checked all along, not only at
its ends. An edge that fails is deleted with its reason and the graph is searched again, so that no sequence jumps
over poses at which the plate could not be held.
"""

from __future__ import annotations

import math
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planners.balance.capacity import LiftCapacity
from planners.balance.contacts import Cup, Friction, GripContacts, HandForceLimit, PushContact
from planners.balance.solver import Balance
from planners.geometry.polyhedron import Prism
from planners.geometry.pose import Array
from planners.graph.rejections import Rejection, Rejections
from planners.graph.search import ALIVE, DEAD, UNKNOWN, GraphPath, cheapest_path
from planners.manipulation.assignment import HoldSplit, NoAssignment, PostureAssigner
from planners.manipulation.choreography import Choreographer, Stuck
from planners.manipulation.costs import TransitionCost
from planners.manipulation.dense_contacts import ContactSampling, DenseContactStateGraph
from planners.manipulation.engagements import Engagement, Itinerary, PostureFollower, PostureQueries
from planners.manipulation.examiner import NodeExaminer, Objective, hands_of
from planners.manipulation.failures import (
    BlockedMotion,
    EdgeFailure,
    Failures,
    Hand,
    LoneTransitFailure,
    PairFailure,
    TransitFailure,
)
from planners.manipulation.graph import HandHold, build_graph
from planners.manipulation.grips import CupFootprint, Grip, GripSampling, Jaw, generate_grips, given_grips
from planners.manipulation.hold_balance import HoldBalance
from planners.manipulation.pushes import Push, PushSampling, generate_pushes, given_pushes
from planners.manipulation.reach import HandReach, PairReach, PlateQuery
from planners.manipulation.workcell import LiftWorkcell
from planners.progress import Progress
from planners.scene.hand import Gripper, Pusher
from planners.scene.scene import PlateLiftScene
from planners.segment import Segment

ALL_POSTURES = (1 << 64) - 1


@dataclass(frozen=True)
class LiftSettings:
    """Budgets and choices of a plate lift's planning. Budgets count tries, never seconds."""

    minimise: Objective = "cost"
    """Eqs. (6), (9), (10), or the largest contact normal."""
    full: bool = False
    """Examine the whole graph before the search, as the paper does; the sequence found is the same."""
    sampling: ContactSampling = field(default_factory=ContactSampling)
    grips: GripSampling = field(default_factory=GripSampling)
    pushes: PushSampling = field(default_factory=PushSampling)
    costs: TransitionCost = field(default_factory=TransitionCost)
    assignments: int = 6
    """Choices of postures whose motion is tried before a sequence is given up."""
    sequences: int = 400
    """Sequences that are checked before the planner gives up."""
    largest_graph: int = 400_000
    """Nodes above which no hold is split by its postures: then an edge of the sequence is given up instead."""


class LiftOutcome(Enum):
    """How planning ended. The value is its name in the plan document."""

    SOLVED = "solved"
    INFEASIBLE = "infeasible"
    """Proven: no plan exists."""
    NOT_FOUND = "not_found"
    """No plan among the poses and holds that were tried."""


@dataclass(frozen=True)
class SequenceStep:
    """One node of the sequence found, for reports."""

    pose: int
    contact: str
    hands: tuple[int | None, int | None]
    force: float
    """Largest contact normal of the hands [N]."""


@dataclass(frozen=True, eq=False)
class LiftPlan:
    """What came out of planning a plate lift, and what it cost."""

    outcome: LiftOutcome
    segments: tuple[Segment, ...]
    steps: tuple[SequenceStep, ...]
    causes: tuple[Rejection, ...]
    summary: str
    rejections: Rejections
    graph: dict[str, int]
    search: dict[str, int | float | None]


class PlateLiftPlanner:
    """All that is known about one plate lift while it is planned."""

    def __init__(self, scene: PlateLiftScene, settings: LiftSettings, progress: Progress) -> None:
        """Sample poses and holds; nothing is solved yet."""
        self.scene, self.settings, self.progress = scene, settings, progress
        self.rejections = Rejections()
        self.workcell = LiftWorkcell(scene, scene.cell.gripper_arms[0], scene.cell.pusher_arms[0])
        self.prism = Prism.from_outline(scene.plate.outline, scene.plate.height)
        self.poses = DenseContactStateGraph.build(self.prism, scene.plate.com, scene.T_world_plate, settings.sampling)
        self.grips, self.pushes = self._holds()
        self.balance_program = _balance(scene)
        self.balance = HoldBalance(
            self.balance_program,
            self.poses,
            [GripContacts(grip.points[0], grip.normals[0]) for grip in self.grips],
            [PushContact(push.point, push.normal) for push in self.pushes],
        )
        self.counts: Counter[str] = Counter()
        self.stages: dict[str, float] = {}

    # Stage by stage.

    def plan(self) -> LiftPlan:
        """Plan the lift."""
        capacity = self.capacity()
        if not capacity.suffices:
            return self._too_heavy(capacity)
        if self.jaw.width_max < self.prism.height:
            return self._too_thick()
        self.build()
        return self.search()

    def capacity(self) -> LiftCapacity:
        """Bound what robot and lifter can carry together off the support."""
        return self.balance_program.capacity(max(self.settings.sampling.lifted_tilts[:2]))

    def build(self) -> None:
        """Find out which hand reaches which pose in which postures, and merge the graph."""
        self.pair = self._reach()
        plates = np.array([pose.T_world_plate for pose in self.poses.poses])
        # The compiled part lets go of the interpreter, so that two threads use two cores.
        with ThreadPoolExecutor(1) as beside:
            pushes = beside.submit(self.pair.second.postures, plates, lambda done: None)
            self.grip_postures = self.pair.first.postures(plates, lambda n: self.progress("reach", n, 2 * len(plates)))
            self.push_postures = pushes.result()
        self.progress("reach", 2 * len(plates), 2 * len(plates))
        self.lifted = self.workcell.plate_query(self.workcell.holding, self.workcell.lifted, hands=[])
        self._forbid_blocked_poses(plates)
        self.follower = self._follower()
        self.failures = Failures(self.balance)
        self.choreographer = Choreographer(
            self.workcell, self.follower, self.balance, np.random.default_rng(self.scene.seed)
        )
        self._merge(
            tuple(HandHold(grip.index, ALL_POSTURES) for grip in self.grips),
            tuple(HandHold(push.index, ALL_POSTURES) for push in self.pushes),
        )

    def search(self) -> LiftPlan:
        """Search the graph until a sequence can be moved along, or nothing is left."""
        for _ in range(self.settings.sequences):
            path = self._best_path()
            if path is None:
                return self._no_path()
            itinerary = Itinerary.of(self.graph, path)
            segments = self._realise(itinerary)
            if segments is not None:
                return self._solved(path, segments)
        return self._failed(
            LiftOutcome.NOT_FOUND, f"No sequence could be moved along in {self.settings.sequences} tries."
        )

    # Building.

    def _holds(self) -> tuple[tuple[Grip, ...], tuple[Push, ...]]:
        scene = self.scene
        gripper, pusher = (scene.cell.arms[name].hand for name in (self.workcell.gripper, self.workcell.pusher))
        assert isinstance(gripper, Gripper)
        assert isinstance(pusher, Pusher)
        self.jaw = Jaw(gripper.width_max, (float(gripper.pad_size[0]), float(gripper.pad_size[2])))
        cup = CupFootprint((float(scene.cup.position[0]), float(scene.cup.position[1])), scene.cup.radius)
        if scene.given_grips is None:
            grips = generate_grips(self.prism, self.jaw, cup=cup, sampling=self.settings.grips)
        else:
            grips = given_grips(scene.given_grips, self.prism)
        if scene.given_pushes is None:
            pushes = generate_pushes(self.prism, pusher.tip_radius, self.settings.pushes)
        else:
            pushes = given_pushes(scene.given_pushes, pusher.tip_radius, self.settings.pushes.rolls)
        return grips, pushes

    def _reach(self) -> PairReach:
        cell = self.workcell
        gripper, pusher = cell.arm(cell.gripper), cell.arm(cell.pusher)
        assert isinstance(gripper.hand, Gripper)
        assert isinstance(pusher.hand, Pusher)
        T_tcp_flange = {
            cell.gripper: np.linalg.inv(gripper.hand.T_flange_tcp(cell.grip_width)),
            cell.pusher: np.linalg.inv(pusher.hand.T_flange_tcp),
        }
        hands = []
        for name, holds, count in (
            (cell.gripper, self.grips, 2),
            (cell.pusher, self.pushes, self.settings.pushes.rolls),
        ):
            T_plate_flange = (
                np.array([hold.T_plate_tcp for hold in holds]).reshape(-1, count, 4, 4) @ T_tcp_flange[name]
            )
            hands.append(
                HandReach(
                    arm=cell.arm(name),
                    first_joint=cell.joints(name).start,
                    T_plate_flange=np.ascontiguousarray(T_plate_flange),
                    alone=cell.plate_query(cell.holding, cell.without_other(name), hands=[name]),
                    hand_only=cell.plate_query(cell.holding, cell.hand_without_other(name), hands=[name]),
                    start_positions=self.scene.start_positions,
                )
            )
        between = cell.plate_query(cell.holding, cell.between_arms, hands=[cell.gripper, cell.pusher])
        return PairReach(hands[0], hands[1], between)

    def _forbid_blocked_poses(self, T_world_plates: Array) -> None:
        """Take all holds from the poses at which plate or cup meet something that stands in the cell."""
        for names in self.lifted.meetings(T_world_plates):
            self.rejections.add(_meeting(*names))
        blocked = self.lifted.first_collisions(T_world_plates) >= 0
        self.grip_postures[blocked] = 0
        self.push_postures[blocked] = 0

    def _follower(self) -> PostureFollower:
        cell = self.workcell
        with_idle: dict[Hand, PlateQuery] = {
            "grip": cell.plate_query(cell.holding, cell.with_idle(cell.gripper), hands=[cell.gripper]),
            "push": cell.plate_query(cell.open, cell.with_idle(cell.pusher), hands=[cell.pusher]),
        }
        opened: dict[Hand, PlateQuery] = {
            "grip": cell.plate_query(cell.open, cell.without_other(cell.gripper), hands=[cell.gripper]),
            "push": cell.plate_query(cell.open, cell.without_other(cell.pusher), hands=[cell.pusher]),
        }
        reach: dict[Hand, NDArray[np.uint64]] = {"grip": self.grip_postures, "push": self.push_postures}
        queries = PostureQueries(with_idle, opened, self.lifted)
        return PostureFollower(self.poses, self.pair, queries, (self.grips, self.pushes), reach)

    def _merge(self, grips: tuple[HandHold, ...], pushes: tuple[HandHold, ...]) -> None:
        """Build the graph of these holds, and apply all that is known to fail."""
        self.progress("merge", 0, 1)
        self.graph = build_graph(self.poses, grips, pushes, self.grip_postures, self.push_postures, self.settings.costs)
        self.failures.apply(self.graph)
        self.examiner = NodeExaminer(
            self.graph, self.balance, self.pair, self.grip_postures, self.push_postures, self.rejections,
            self.settings.minimise,
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
        splits = problem.split if self.graph.graph.node_count <= self.settings.largest_graph else ()
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

    # Results.

    def _solved(self, path: GraphPath, segments: tuple[Segment, ...]) -> LiftPlan:
        steps = tuple(self._step(node) for node in path.nodes)
        contacts = [steps[0].contact]
        contacts += [b.contact for a, b in pairwise(steps) if a.contact != b.contact]
        force = max(step.force for step in steps)
        summary = f"The plate is lifted over {' - '.join(contacts)}; the hands bear at most {force:.2f} N on a contact."
        return LiftPlan(
            LiftOutcome.SOLVED, segments, steps, (), summary, self.rejections, self.graph_figures(),
            self.search_figures(path, len(contacts) - 1),
        )  # fmt: skip

    def _step(self, node: int) -> SequenceStep:
        pose = self.poses.poses[int(self.graph.node_pose[node])]
        element = (
            pose.contact.element
            if pose.contact.index in (None, 0) and pose.contact.element != "edge"
            else (f"{pose.contact.element} {pose.contact.index}")
        )
        return SequenceStep(
            int(self.graph.node_pose[node]),
            "no contact" if pose.contact.element == "none" else element,
            hands_of(*self.graph.hold_of(node)),
            self.examiner.largest_force(node),
        )

    def _too_heavy(self, capacity: LiftCapacity) -> LiftPlan:
        cause = Rejection(
            "capacity",
            f"The plate is too heavy: the cup can carry at most {capacity.cup:.1f} N, the gripper "
            f"{capacity.gripper:.1f} N and the stick {capacity.pusher:.1f} N of its weight",
            needed=capacity.needed,
            available=capacity.available,
            unit="N",
        )
        self.rejections.add(cause)
        summary = (
            f"Robot and vacuum lifter together can carry at most {capacity.available:.1f} N; "
            f"the plate weighs {capacity.needed:.1f} N."
        )
        return LiftPlan(
            LiftOutcome.INFEASIBLE, (), (), (cause,), summary, self.rejections, self._sampling_figures(), {}
        )

    def _too_thick(self) -> LiftPlan:
        reason = "The gripper does not open wide enough for the plate"
        cause = Rejection("capacity", reason, needed=self.prism.height, available=self.jaw.width_max, unit="m")
        self.rejections.add(cause)
        summary = (
            f"The plate is {1e3 * self.prism.height:.1f} mm thick; the gripper opens {1e3 * self.jaw.width_max:.1f} mm."
        )
        return LiftPlan(
            LiftOutcome.INFEASIBLE, (), (), (cause,), summary, self.rejections, self._sampling_figures(), {}
        )

    def _no_path(self) -> LiftPlan:
        """Say why nothing was found: which layer of the graph is empty, or what fell most."""
        alive = self.graph.knowledge.status != DEAD
        starts = [n for n in self.graph.starts if alive[n] and n not in self.graph.lost_starts]
        if not self.grips:
            summary = "The gripper finds no place to hold the plate: it is too small, or the cup is in the way."
        elif not starts:
            summary = "No hand can come to the plate where it rests."
            self._explain_starts()
        elif not (self.graph.goal & alive).any():
            summary = "No grip and push together can hold the plate off its support."
        else:
            summary = f"No sequence of holds leads from the support into the air: {self._farthest()}."
        return self._failed(LiftOutcome.NOT_FOUND, summary)

    def _farthest(self) -> str:
        """Say how far the plate can be raised from rest, by the edges that are left."""
        reached = self.graph.reachable()
        tilts = np.array([float(np.linalg.norm(pose.tilt)) for pose in self.poses.poses])
        pose = self.poses.poses[max(self.graph.node_pose[reached], key=tilts.__getitem__)]
        tilt = math.degrees(float(np.linalg.norm(pose.tilt)))
        return f"it gets no farther than a tilt of {tilt:.0f}° on its {pose.contact.element} {pose.contact.index}"

    def _explain_starts(self) -> None:
        """Count what keeps each hand off the plate at rest."""
        T_world_plate = self.poses.poses[self.poses.flat].T_world_plate
        for hand in (self.pair.first, self.pair.second):
            for reason, count in hand.hindrances(T_world_plate).items():
                self.rejections.add(Rejection("reach", reason, where="the plate at rest"), count)

    def _failed(self, outcome: LiftOutcome, summary: str) -> LiftPlan:
        causes = tuple(
            replace(rejection, reason=f"{rejection.reason} ({count} times)")
            for rejection, count in self.rejections.most_common(6)
        )
        return LiftPlan(
            outcome, (), (), causes, summary, self.rejections, self.graph_figures(), self.search_figures(None, 0)
        )

    def _sampling_figures(self) -> dict[str, int]:
        return {
            "poses": len(self.poses.poses),
            "pose_edges": len(self.poses.edges),
            "grips": len(self.grips),
            "pushes": len(self.pushes),
        }

    def graph_figures(self) -> dict[str, int]:
        """Return the sizes of what was built."""
        status = self.graph.knowledge.status
        return {
            **self._sampling_figures(),
            "nodes": self.graph.graph.node_count,
            "edges": self.graph.graph.edge_count,
            "alive": int((status == ALIVE).sum()),
            "dead": int((status == DEAD).sum()),
            "unexamined": int((status == UNKNOWN).sum()),
            "starts": len(self.graph.starts),
            "goals": int((self.graph.goal & (status == ALIVE)).sum()),
        }

    def search_figures(self, path: GraphPath | None, contact_changes: int) -> dict[str, int | float | None]:
        """Return what the search did and found."""
        return {
            **{name: self.counts[name] for name in ("searches", "sequences", "assignments", "splits")},
            "examined": self.examiner.examined,
            "balances_solved": self.balance.solved,
            "motion_queries": self.choreographer.motion_queries,
            "length": None if path is None else len(path.nodes),
            "cost": None if path is None else path.cost,
            "contact_changes": contact_changes,
            "max_force": None if path is None else max(self.examiner.largest_force(node) for node in path.nodes),
        }


def _told_apart(holds: tuple[HandHold, ...], split: HoldSplit, reach: NDArray[np.uint64]) -> tuple[HandHold, ...]:
    """Replace a hold by its parts, as far as they reach any pose."""
    index = split.hold.index
    anywhere = int(np.bitwise_or.reduce(reach[:, index]))
    parts = tuple(HandHold(index, part & anywhere) for part in split.parts if part & anywhere)
    return tuple(other for other in holds if other != split.hold) + parts


def _meeting(one: str, other: str) -> Rejection:
    body, obstacle = (one, other) if one in ("plate", "cup") else (other, one)
    return Rejection("clearance", f"the {body} would touch {obstacle}")


def _balance(scene: PlateLiftScene) -> Balance:
    """State the balance program of a scene."""
    cup, friction, limit = scene.cup, scene.friction, scene.hand_force_limit
    return Balance(
        scene.plate.mass or 0.0,
        scene.plate.com,
        Cup(cup.T_plate_cup, cup.radius, cup.max_force, cup.mu, cup.kappa),
        Friction(friction.grip, friction.push, friction.environment, friction.eps),
        HandForceLimit(limit.normal, limit.net),
        scene.lifter_model,
        float(-scene.cell.gravity[2]),
    )
