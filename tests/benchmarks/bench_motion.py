"""Free motions of either arm round a tilted plate: search, shortcuts against OMPL's own, and time laws."""

from __future__ import annotations

from dataclasses import dataclass
from time import process_time

import numpy as np

from planners.cell.arm import Arm
from planners.cell.cell import Cell, load_cell
from planners.collision.model import CollisionModel, CollisionQuery, Fixed
from planners.geometry.convex import CollisionBody, box
from planners.geometry.pose import Array, Transform, rotation_y, transform
from planners.kinematics.forward import flange_pose
from planners.kinematics.inverse import inverse_kinematics
from planners.kinematics.windings import all_windings
from planners.motion.blended_path import BlendedPath
from planners.motion.checker import ArmEdgeChecker
from planners.motion.joint_metric import JointMetric
from planners.motion.path_search import plan_motion
from planners.motion.query import MotionOutcome, MotionQuery, MotionResult, MotionSettings
from planners.motion.timing import JointLimits, time_path
from planners.motion.trajectory import Trajectory
from tests.benchmarks.path_shortening import lengths_shortened

PROBLEMS_PER_ARM = 40
MARGIN = 0.003
PLATE_SIZE = (0.3, 0.3, 0.04)
JOINTS = {"left": slice(0, 6), "right": slice(6, 12)}


@dataclass(frozen=True, eq=False)
class Answer:
    """One query, its answer, and the CPU time it took."""

    query: MotionQuery
    result: MotionResult
    milliseconds: float


def measure() -> dict[str, float]:
    """Return CPU milliseconds, and how paths and durations compare with bounds and with OMPL's simplifier."""
    cell = load_cell("dual_ur3e_lift")
    scene = motion_scene(cell)
    queries = [query for arm in cell.arms.values() for query in motion_queries(cell, arm, scene)]
    limits = JointLimits(cell.arms["left"].velocity_max, cell.arms["left"].acceleration_max)
    timed_answer(queries[0], 0)
    answers = [timed_answer(query, seed) for seed, query in enumerate(queries)]
    found = [answer for answer in answers if answer.result.outcome is MotionOutcome.FOUND]
    searched = [answer for answer in found if answer.result.statistics.iterations]
    straight = [answer for answer in found if not answer.result.statistics.iterations]
    metric = JointMetric.from_velocity_limits(limits.velocity, 6)
    detours = [a.result.statistics.length / metric.length(_path(a)[[0, -1]]) for a in searched]
    shortened = [lengths_shortened(answer.query, _path(answer)[-1]) for answer in searched]
    ours, ompls = np.array([lengths for lengths in shortened if lengths is not None]).T
    blends, laws, slowness = zip(*(_time(a, limits) for a in found), strict=True)
    return {
        "problems": float(len(queries)),
        "found_share": len(found) / len(queries),
        "straight_share": len(straight) / len(found),
        "straight_ms_median": float(np.median([a.milliseconds for a in straight])),
        "search_ms_median": float(np.median([a.milliseconds for a in searched])),
        "search_ms_p95": float(np.percentile([a.milliseconds for a in searched], 95)),
        "iterations_median": float(np.median([a.result.statistics.iterations for a in searched])),
        "length_over_straight_distance": float(np.median(detours)),
        "length_over_ompl_simplified": float(np.median(ours / ompls)),
        "blend_ms_median": float(np.median(blends)),
        "time_law_ms_median": float(np.median(laws)),
        "duration_over_straight_optimum": float(np.median(slowness)),
    }


def plate_pose(cell: Cell) -> Transform:
    """Return where the tilted plate is."""
    return transform(rotation_y(-1.0), [0.32, 0.0, cell.table_top + 0.15])


def motion_scene(cell: Cell) -> CollisionQuery:
    """Return the cell with the plate."""
    plate = CollisionBody("plate", "plate", "plate", (box(PLATE_SIZE),))
    arms = {name: (arm.dh, arm.T_world_base) for name, arm in cell.arms.items()}
    model = CollisionModel.build(arms, [*cell.collision_bodies(), plate], set(cell.excluded_pairs))
    return model.scene({"plate": Fixed(plate_pose(cell))}, allowed=[("plate", "table")], margin=MARGIN)


def motion_queries(cell: Cell, arm: Arm, scene: CollisionQuery, problems: int = PROBLEMS_PER_ARM) -> list[MotionQuery]:
    """Return queries from a free flange pose above the table to all branches and windings of another."""
    rng = np.random.default_rng(0)
    checker = ArmEdgeChecker(scene, cell.home, JOINTS[arm.name])
    reachable: list[Array] = []
    while len(reachable) < 2 * problems:
        q = rng.uniform(-np.pi, np.pi, 6)
        T_world_flange = flange_pose(arm.dh, arm.T_world_base, q)
        x, _, height = T_world_flange[:3, 3] - [0.0, 0.0, cell.table_top]
        if 0.1 < x < 0.6 and 0.1 < height < 0.6 and T_world_flange[2, 2] < 0.3 and checker.state_free(q):
            reachable.append(q)
    return [
        MotionQuery(
            start, _windings(arm, goal), arm.position_min, arm.position_max, checker, velocity_max=arm.velocity_max
        )
        for start, goal in zip(reachable[::2], reachable[1::2], strict=True)
    ]


def _windings(arm: Arm, q: Array) -> Array:
    T_base_flange = flange_pose(arm.dh, np.eye(4), q)
    branches = np.empty((8, 6))
    valid = inverse_kinematics(arm.dh, T_base_flange, q[5], branches)
    return np.concatenate(
        [all_windings(branches[k], arm.position_min, arm.position_max) for k in range(8) if valid >> k & 1]
    )


def timed_answer(query: MotionQuery, seed: int) -> Answer:
    """Answer a query."""
    started = process_time()
    result = plan_motion(query, MotionSettings(), np.random.default_rng(seed))
    return Answer(query, result, 1e3 * (process_time() - started))


def _path(answer: Answer) -> Array:
    assert answer.result.path is not None
    return answer.result.path


def _time(answer: Answer, limits: JointLimits) -> tuple[float, float, float]:
    """CPU milliseconds of the blends and of the time law; duration over that of the straight line, both smoothed."""
    started = process_time()
    path = BlendedPath.through(_path(answer), answer.query.edge_checker)
    blended = process_time()
    trajectory = time_path(path, limits)
    timed = process_time()
    return 1e3 * (blended - started), 1e3 * (timed - blended), trajectory.duration / _straight(answer, limits).duration


def _straight(answer: Answer, limits: JointLimits) -> Trajectory:
    ends = _path(answer)[[0, -1]]
    return time_path(BlendedPath(ends, np.zeros(2)), limits)
