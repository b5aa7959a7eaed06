"""The paper's own method as it is written, timed on a random sample of nodes and extrapolated to all of them.

Every node, a plate pose with a hold, is examined by itself: inverse kinematics by iteration for each pose of each
hand, collisions of each solution and of each pair of solutions, and, if all that is feasible, the cone program stated
anew in cvxpy and solved. In favour of the paper, collisions are asked of our compiled kernel.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from planners.collision.kernel import first_collision, make_scratch, set_frame
from planners.manipulation.graph.node_examiner import hands_of
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.reach.hand_reach import HandReach, PlateQuery
from planners.manipulation.statics.hold_balance import HandPair
from tests.benchmarks.iterative_ik import iterate
from tests.benchmarks.tasks import SOLVABLE, Note, cpu_seconds, planner_of
from tests.kinematics.arm_oracle import PinocchioArm
from tests.support.balance_statement import Plate, state_balance


@dataclass(frozen=True)
class PaperMethodFigures:
    """One task; CPU seconds."""

    name: str
    nodes: int
    """Poses times holds."""
    sampled: int
    """Nodes whose reach was examined to time it."""
    reach_seconds: float
    """RV1 of all nodes, extrapolated from the sample."""
    reach_error: float
    """Standard error of that."""
    reached: int
    """Nodes that need a cone program: both hands can be there. The share that keeps the arms apart is sampled."""
    programs: int
    """Cone programs that were solved to time them."""
    cone_seconds: float
    """RV2 of all nodes, extrapolated."""
    cone_error: float

    @property
    def total(self) -> float:
        """Both examinations of all nodes."""
        return self.reach_seconds + self.cone_seconds


def measure(
    note: Note, names: Sequence[str] = SOLVABLE, sample: int = 400, programs: int = 60
) -> list[PaperMethodFigures]:
    """Time the reach of `sample` nodes of each task, and the cone programs of at most `programs` nodes."""
    return [_task(name, note, sample, programs) for name in names]


def _task(name: str, note: Note, sample: int, programs: int) -> PaperMethodFigures:
    note(f"the paper's method on {sample} nodes of {name}")
    planner = planner_of(name)
    planner.begin()
    examination, rng = NodeExamination(planner), np.random.default_rng(0)
    holds = all_holds(len(planner.sampling.grips), len(planner.sampling.pushes))
    poses = len(planner.sampling.poses.poses)
    nodes = [(int(rng.integers(poses)), holds[rng.integers(len(holds))]) for _ in range(sample)]
    reach = np.array([cpu_seconds(lambda node=node: examination.reachable(*node)) for node in nodes])
    candidates = planner.search.graph.graph.node_count
    drawn = [_node(planner, int(number)) for number in rng.choice(candidates, programs, replace=False)]
    apart = [node for node in drawn if _arms_apart(planner, *node)]
    cones = np.array([cpu_seconds(lambda node=node: examination.balanced(*node)) for node in apart])
    total, reached = poses * len(holds), round(candidates * len(apart) / len(drawn))
    return PaperMethodFigures(
        name=name,
        nodes=total,
        sampled=sample,
        reach_seconds=total * float(reach.mean()),
        reach_error=total * float(reach.std()) / math.sqrt(sample),
        reached=reached,
        programs=len(apart),
        cone_seconds=reached * float(cones.mean()),
        cone_error=reached * float(cones.std()) / math.sqrt(len(cones)),
    )


def _node(planner: PlateLiftPlanner, number: int) -> tuple[int, HandPair]:
    """Return pose and hold of a node that each hand reaches by itself."""
    graph = planner.search.graph
    return int(graph.node_pose[number]), hands_of(*graph.hold_of(number))


def _arms_apart(planner: PlateLiftPlanner, pose: int, hold: HandPair) -> bool:
    grip, push = hold
    if grip is None or push is None:
        return True
    where = planner.sampling.poses.poses[pose].T_world_plate[None]
    postures = int(planner.reach.reached.grip[pose, grip]), int(planner.reach.reached.push[pose, push])
    return planner.reach.pair.compatible(where, (grip, push), postures) is not None


def all_holds(grips: int, pushes: int) -> list[HandPair]:
    """List every grip, every push and every pair."""
    alone: list[HandPair] = [(grip, None) for grip in range(grips)] + [(None, push) for push in range(pushes)]
    return alone + [(grip, push) for grip in range(grips) for push in range(pushes)]


class NodeExamination:
    """Examines one node at a time and remembers nothing."""

    def __init__(self, planner: PlateLiftPlanner) -> None:
        scene, pair = planner.scene, planner.reach.pair
        self.planner, self.hands = planner, (pair.first, pair.second)
        self.arms = [PinocchioArm(hand.arm.dh) for hand in self.hands]
        self.alone = [FreeCheck(hand.alone) for hand in self.hands]
        self.between = FreeCheck(pair.between)
        program = planner.sampling.stated
        self.plate = Plate(
            scene.plate.mass, scene.plate.com, program.cup, program.friction, program.limits, scene.lifter_model
        )

    def reachable(self, pose: int, hold: HandPair) -> bool:
        """RV1: whether both hands can be there, free of collision; the first hand that cannot ends it."""
        T_world_plate = self.planner.sampling.poses.poses[pose].T_world_plate
        grip, push = hold
        if grip is None or push is None:
            k, index = (1, push) if grip is None else (0, grip)
            return next(self._solutions(k, index, T_world_plate), None) is not None
        of_grip = list(self._solutions(0, grip, T_world_plate))
        of_push = self._solutions(1, push, T_world_plate) if of_grip else ()
        return any(self._apart(pair, T_world_plate) for pair in product(of_grip, of_push))

    def balanced(self, pose: int, hold: HandPair) -> bool:
        """RV2: whether the plate can be held, the program being stated anew."""
        where, balance = self.planner.sampling.poses.poses[pose], self.planner.balance
        grip = None if hold[0] is None else balance.grips[hold[0]]
        push = None if hold[1] is None else balance.pushes[hold[1]]
        statement = state_balance(self.plate, where.T_world_plate[:3, :3], where.contact_points, grip, push)
        statement.problem.solve(solver="CLARABEL")
        return statement.is_feasible

    def _solutions(self, k: int, index: int, T_world_plate: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the free joint positions of one hold of a hand, one at most for each pose of the hand."""
        hand: HandReach = self.hands[k]
        q = self.planner.scene.start_positions.copy()
        home = q[self._joints(k)].copy()
        for T_plate_flange in hand.T_plate_flange[index]:
            T_base_flange = np.linalg.inv(hand.arm.T_world_base) @ T_world_plate @ T_plate_flange
            solution = iterate(self.arms[k], T_base_flange, home)
            if solution is None:
                continue
            q[self._joints(k)] = solution
            if self.alone[k].free(q, T_world_plate):
                yield solution

    def _apart(self, solutions: tuple[np.ndarray, np.ndarray], T_world_plate: np.ndarray) -> bool:
        q = np.empty(12)
        q[self._joints(0)], q[self._joints(1)] = solutions
        return self.between.free(q, T_world_plate)

    def _joints(self, k: int) -> slice:
        first = self.hands[k].first_joint
        return slice(first, first + 6)


class FreeCheck:
    """Asks the compiled kernel for one configuration with the plate at one pose."""

    def __init__(self, query: PlateQuery) -> None:
        self.kernel, self.frame = query.kernel()
        self.scratch: Any = make_scratch(self.kernel)

    def free(self, q: np.ndarray, T_world_plate: np.ndarray) -> bool:
        set_frame(self.kernel, self.frame, T_world_plate)
        return first_collision(self.kernel, q, self.scratch) < 0
