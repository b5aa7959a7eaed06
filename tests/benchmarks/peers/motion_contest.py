"""Free motion of either arm round a tilted plate: ours, OMPL with coal, and mplib, on the queries of the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from planners.cell.cell import Cell, load_cell
from planners.geometry.pose import Array
from planners.motion.joint_metric import JointMetric
from planners.motion.query import MotionQuery, MotionSettings
from tests.benchmarks.bench_collision import PinocchioScene
from tests.benchmarks.bench_motion import (
    JOINTS,
    MARGIN,
    PLATE_SIZE,
    Answer,
    motion_queries,
    motion_scene,
    plate_pose,
    timed_answer,
)
from tests.benchmarks.peers.contest import Contest, Entry, NotMeasured, Peer, answers_of, tried
from tests.benchmarks.peers.mplib_scene import BoxObstacle, MplibQuery, NoInterpreter, ask_mplib
from tests.benchmarks.tasks import Note

CELL = "dual_ur3e_lift"
ORACLE_STEP = 0.005
"""Between configurations of a path at which coal is asked whether it is free [rad of the joint that turns most]."""
SECONDS = 5.0
"""That a peer may search."""
PLAINMP = NotMeasured(
    "plainmp",
    "the registry has no wheel of it, and its source distribution (0.3.6) is built against the C++ headers and CMake "
    "files of OMPL: Eigen and Boost come as wheels, but OMPL's own wheel has no headers and its sources are not there",
)
TEXT = (
    "A start to any of the postures and windings that reach a pose. Others get the 24 nearest goals that are free, the "
    "nearest first, which is not in their time. Ours tries straight lines, then OMPL's RRT-Connect with one compiled "
    "check of a whole edge, then shortcuts; it gives up after 1,000 iterations. *OMPL with coal* is `SimpleSetup` with "
    "RRT-Connect and its simplifier, its state validity a Python function that asks coal by pinocchio's broad phase, "
    "with the same 3 mm of clearance, every 0.05 rad. *mplib* has the cell's URDF and SRDF with convex meshes and the "
    "plate as a box, RRT-Connect and simplifier in C++ with the range of its `plan_qpos`. It cannot be asked for "
    "clearance, so that the plate is 3 mm larger all round, nor how densely it looks at a motion; its time law is left "
    "out. Each may search for 5 s. Solved: coal finds no contact on the path every 0.005 rad, and it ends at one of "
    "the goals within the joints' limits. Length: of the path, in rad of the slowest joint. *Straight*: a straight "
    "line to one of the six nearest goals is free; *search*: none is."
)


@dataclass(frozen=True, eq=False)
class MotionCases:
    """The queries with our answers."""

    cell: Cell
    arms: Sequence[str]
    """Of each query."""
    answers: Sequence[Answer]

    @classmethod
    def draw(cls, problems: int) -> MotionCases:
        """Answer as many queries of each arm."""
        cell = load_cell(CELL)
        scene = motion_scene(cell)
        drawn = [
            (name, query) for name, arm in cell.arms.items() for query in motion_queries(cell, arm, scene, problems)
        ]
        timed_answer(drawn[0][1], 0)
        answers = [timed_answer(query, seed) for seed, (_, query) in enumerate(drawn)]
        return cls(cell, [name for name, _ in drawn], answers)

    def scene(self, margin: float) -> PinocchioScene:
        """Return the scene in coal."""
        return PinocchioScene(self.cell, motion_scene(self.cell), {"plate": ("world", plate_pose(self.cell))}, margin)

    @cached_property
    def oracle(self) -> PinocchioScene:
        """The scene without clearance."""
        return self.scene(0.0)

    def goals(self, query: MotionQuery) -> Array:
        """Return the goals (k, 6) that are free and within limits, the nearest first and no more than ours looks at."""
        within = (query.goals >= query.position_min).all(axis=1) & (query.goals <= query.position_max).all(axis=1)
        metric = JointMetric.from_velocity_limits(query.velocity_max, query.start.size)
        near = query.goals[within][np.argsort(metric.distances(query.start, query.goals[within]), kind="stable")]
        return np.array([q for q in near if query.edge_checker.state_free(q)][: MotionSettings().max_goals])

    def judged(self, name: str, paths: Sequence[Array | None], seconds: Sequence[float]) -> Entry:
        """Return how somebody fared who answered with these paths."""
        good = [path is not None and self._valid(i, path) for i, path in enumerate(paths)]
        lengths = [
            self._length(i, path) if path is not None and ok else np.nan
            for i, (path, ok) in enumerate(zip(paths, good, strict=True))
        ]
        return Entry(name, seconds, good, lengths, [path is not None for path in paths])

    def _length(self, i: int, path: Array) -> float:
        query = self.answers[i].query
        return JointMetric.from_velocity_limits(query.velocity_max, query.start.size).length(path)

    def _valid(self, i: int, path: Array) -> bool:
        query = self.answers[i].query
        ends = np.abs(query.goals - path[-1]).max(axis=1).min() < 1e-5 and np.abs(path[0] - query.start).max() < 1e-5
        within = (path >= query.position_min - 1e-9).all() and (path <= query.position_max + 1e-9).all()
        return bool(ends and within) and self._free(self.arms[i], path)

    def _free(self, arm: str, path: Array) -> bool:
        q = self.cell.home.copy()
        for q_from, q_to in pairwise(path):
            steps = max(1, int(np.ceil(np.abs(q_to - q_from).max() / ORACLE_STEP)))
            for share in np.linspace(0.0, 1.0, steps + 1):
                q[JOINTS[arm]] = q_from + share * (q_to - q_from)
                if self.oracle.broadphase(q):
                    return False
        return True


def motion_contests(cases: MotionCases, note: Note) -> list[Contest]:
    """Return two contests: where a straight line serves, and where a search is needed."""
    ours = cases.judged("ours", [a.result.path for a in cases.answers], [1e-3 * a.milliseconds for a in cases.answers])
    note("peers: motion, OMPL with coal")
    peers: list[Peer] = [tried("OMPL with coal", lambda: _ompl_with_coal(cases))]
    note("peers: motion, mplib")
    peers.append(_mplib(cases))
    peers.append(PLAINMP)
    straight = [
        i for i, a in enumerate(cases.answers) if a.result.path is not None and not a.result.statistics.iterations
    ]
    searched = [i for i in range(len(cases.answers)) if i not in set(straight)]
    return [
        Contest(
            f"free motion, {kind} ({len(chosen)})",
            ours.of(chosen),
            [peer.of(chosen) if isinstance(peer, Entry) else peer for peer in peers],
            "length",
            text=TEXT if kind == "straight" else "",
        )
        for kind, chosen in (("straight", straight), ("search", searched))
        if chosen
    ]


def _ompl_with_coal(cases: MotionCases) -> Entry:
    from tests.benchmarks.peers.ompl_coal import OmplCoalPlanner

    scene = cases.scene(MARGIN)

    def plan(i: int) -> Array | None:
        query, arm = cases.answers[i].query, cases.arms[i]
        planner = OmplCoalPlanner(scene, cases.cell.home, JOINTS[arm], query.position_min, query.position_max)
        return planner.plan(query.start, goals[i], i + 1, SECONDS)

    goals = [cases.goals(answer.query) for answer in cases.answers]
    plan(0)
    return cases.judged("OMPL with coal", *answers_of(plan, range(len(cases.answers))))


def _mplib(cases: MotionCases) -> Peer:
    obstacle = BoxObstacle("plate", [size + 2.0 * MARGIN for size in PLATE_SIZE], plate_pose(cases.cell), ["table"])
    queries = [
        MplibQuery(arm, answer.query.start, cases.goals(answer.query))
        for arm, answer in zip(cases.arms, cases.answers, strict=True)
    ]
    try:
        answers = ask_mplib(cases.cell, obstacle, queries, SECONDS)
    except NoInterpreter as error:
        return NotMeasured("mplib", str(error))
    return cases.judged("mplib", [each.path for each in answers], [each.seconds for each in answers])
