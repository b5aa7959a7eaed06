"""How good the free motion of the shipped suction-tool tasks is: its length, its duration, and how far wrists turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np

from planners.cell.arm import Arm
from planners.contract.task_spec import SuctionToolTask, read_task
from planners.geometry.pose import Array
from planners.hands import arm_motion
from planners.motion.blended_path import BlendedPath
from planners.motion.joint_metric import JointMetric
from planners.motion.path_search import plan_motion
from planners.motion.query import MotionOutcome, MotionQuery, MotionResult, MotionSettings
from planners.motion.timing import JointLimits, time_path
from planners.plan.segment import SegmentKind
from planners.progress import silent
from planners.regrasp.planner import SuctionToolPlanner
from planners.regrasp.tool_segment import ToolSegment
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.tool_scene import build_tool_scene
from tests.benchmarks.path_shortening import lengths_shortened
from tests.benchmarks.random_piles import PILES
from tests.benchmarks.tasks import Note, task_body
from workers.stores.handover_store import HandoverStore

TASKS = tuple(pile.task for pile in PILES)
EMPTY, TOOL, LADEN = "empty hand", "tool", "tool and object"
WRIST = 5
"""The last joint of an arm."""
_SETTINGS = ToolPlannerSettings()


@dataclass(frozen=True)
class FreeMotion:
    """One free motion of one arm in a plan."""

    carried: str
    """`EMPTY`, `TOOL` or `LADEN`."""
    searched: bool
    """Whether straight motion to none of the nearest goals was free."""
    length: float
    """Over that of the straight line between its ends, in time of the joints [1]."""
    detour: float
    """Straight distance to the end that was reached over that to the nearest end within limits [1]."""
    duration: float
    """[s]"""
    slowness: float
    """Duration over that of the straight line at the joints' limits [1]."""
    wrist_turn: float
    """Largest less smallest position of the last joint [rad]."""
    of_ompl: float | None
    """Length of a raw path after our shortcuts over that after OMPL's simplifier [1]; None where none is searched."""


@dataclass(frozen=True)
class TaskMotion:
    """The free motion of one task."""

    task: str
    motions: Sequence[FreeMotion]
    duration: float
    """Of the whole plan, straight ways, fingers and vacuum included [s]."""
    hose_turns: float
    """Of the tool about its axis from start to end, signed [1]."""
    most_hose_turns: float
    """At any time, either way [1]."""


def measure(note: Note, databases: Path, tasks: Sequence[str] = TASKS) -> list[TaskMotion]:
    """Plan each task once and look at its motion."""
    return [_measure(name, HandoverStore(databases), note) for name in tasks]


def _measure(name: str, store: HandoverStore, note: Note) -> TaskMotion:
    note(f"motion of {name}")
    task = read_task(task_body(name))
    assert isinstance(task, SuctionToolTask)
    scene = build_tool_scene(task)
    database = store.get(scene.cell, scene.tool, _SETTINGS.handovers)
    recorder = MotionRecorder()
    with patch.object(arm_motion, "plan_motion", recorder):
        plan = SuctionToolPlanner(scene, _SETTINGS, database, silent).plan()
    joints = {arm: slice(6 * i, 6 * i + 6) for i, arm in enumerate(scene.cell.arms)}
    found = [
        _judged(segment, answer, scene.cell.arms[arm], joints[arm])
        for segment in plan.segments
        for arm in segment.movers
        for answer in recorder.answers
        if _is_motion_of(segment, answer, joints[arm])
    ]
    duration = sum(segment.trajectory.duration for segment in plan.segments)
    return TaskMotion(name, found, duration, plan.hose_turns, plan.most_hose_turns)


@dataclass(frozen=True, eq=False)
class Answer:
    """A query that was answered with a path (m, 6)."""

    path: Array
    detour: float
    searched: bool
    of_ompl: float | None


class MotionRecorder:
    """Stands in for `plan_motion` while a task is planned: a query's collisions can be asked only then."""

    def __init__(self) -> None:
        self.answers: list[Answer] = []

    def __call__(self, query: MotionQuery, settings: MotionSettings, rng: np.random.Generator) -> MotionResult:
        """Answer a query and keep the answer."""
        result = plan_motion(query, settings, rng)
        if result.outcome is MotionOutcome.FOUND:
            assert result.path is not None
            searched = result.statistics.iterations > 0
            lengths = lengths_shortened(query, result.path[-1]) if searched else None
            of_ompl = None if lengths is None else lengths[0] / lengths[1]
            self.answers.append(Answer(result.path, _detour(query, result.path[-1]), searched, of_ompl))
        return result


def _detour(query: MotionQuery, reached: Array) -> float:
    metric = JointMetric.from_velocity_limits(query.velocity_max, query.start.size)
    within = np.all((query.goals >= query.position_min) & (query.goals <= query.position_max), axis=1)
    nearest = metric.distances(query.start, query.goals[within]).min()
    return float(metric.distances(query.start, reached[None])[0] / nearest)


def _is_motion_of(segment: ToolSegment, answer: Answer, joints: slice) -> bool:
    ends = segment.trajectory.positions[[0, -1], joints]
    return bool(np.abs(ends - answer.path[[0, -1]]).max() < 1e-9)


def _judged(segment: ToolSegment, answer: Answer, arm: Arm, joints: slice) -> FreeMotion:
    metric = JointMetric.from_velocity_limits(arm.velocity_max, 6)
    positions, ends = segment.trajectory.positions[:, joints], answer.path[[0, -1]]
    limits = JointLimits(arm.velocity_max, arm.acceleration_max)
    straight = time_path(BlendedPath(ends, np.zeros(2)), limits)
    return FreeMotion(
        carried=EMPTY if segment.kind is SegmentKind.TRANSIT else TOOL if segment.sucked is None else LADEN,
        searched=answer.searched,
        length=metric.length(positions) / metric.length(ends),
        detour=answer.detour,
        duration=segment.trajectory.duration,
        slowness=segment.trajectory.duration / straight.duration,
        wrist_turn=float(np.ptp(positions[:, WRIST])),
        of_ompl=answer.of_ompl,
    )
