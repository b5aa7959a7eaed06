"""After a stop: back along the path that was come on, or a task from where the arms are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from planners.contract.arrays import ArmName
from planners.contract.task_spec import ObjectToMove, PlateLiftTask, TaskSpec, read_task, to_post_again, write_task
from planners.errors import LiftwrightError
from planners.geometry.pose import Array
from planners.plan.scenery import ARMS
from planners.plan.segment import Segment, SegmentKind
from planners.program.schedule import ProgramStep, Schedule, WrenchCurve

BACK_SPEED = 0.25
"""Of the planned speed, on the average, at which arms go back [1]."""
LEAST_DURATION = 1.0
"""A way back takes at least as long [s]: so it is gentle, however short it is."""
SAMPLE_STEP = 0.02
"""Between samples of a way back [s]."""
_STILL = 1e-6
"""Bodies whose poses differ by no more have not been moved [m, 1]."""
_TAKING = (SegmentKind.GRIP, SegmentKind.RELEASE, SegmentKind.ATTACH, SegmentKind.DETACH, SegmentKind.HANDOVER)


class CannotPlanOn(LiftwrightError):
    """There is no task that begins where things are; says what has to be done first."""


def way_back(schedule: Schedule, reached: Mapping[ArmName, float]) -> Schedule | None:
    """Return one step that leads back along the executed path, from rest to rest.

    It leads to the begin of the step, and of all before it in which no hand and no vacuum did anything: what was taken
    since is not let go of by going back, and what was let go of is not taken. What was feasible in quasi-static motion
    one way is so the other way too, at less speed.

    Args:
        schedule: that was executed.
        reached: where each arm is, on the plan's clock [s].

    Returns:
        A schedule of that one step, or None where the arms stand at the begin of such a step already.
    """
    farthest = max(reached.values())
    done = [step for step in schedule.steps if step.begin < farthest]
    free = list(takewhile(_is_free, reversed(done)))
    if not free:
        return None
    target = free[-1].begin
    duration = max(LEAST_DURATION, (farthest - target) / BACK_SPEED)
    time = np.linspace(0.0, duration, round(duration / SAMPLE_STEP) + 1)
    falling = 0.5 * (1.0 + np.cos(np.pi * time / duration))
    falling_rate = -0.5 * np.pi / duration * np.sin(np.pi * time / duration)
    arms = {}
    for arm in ARMS:
        length = max(reached[arm], target) - target
        positions, velocities = _on_path(schedule, arm, target + length * falling)
        arms[arm] = replace(
            done[-1].arms[arm],
            time=time,
            positions=positions,
            velocities=length * falling_rate[:, None] * velocities,
            width=None,
            squeeze=None,
            vacuum=None,
            wrenches=_wrenches_on_path(schedule, arm, time, target + length * falling),
            free=False,
        )
    number = free[-1].number
    words = f"back to the begin of step {number}"
    way = time, target + (farthest - target) * falling
    # Of the planned speed: what it is where it is fastest.
    fastest = 0.5 * np.pi * (farthest - target) / duration
    stop_share = min(1.0, min(step.stop_share for step in free) / fastest)
    step = ProgramStep(number, target, SegmentKind.TRANSIT, float(duration), words, arms, stop_share, way)
    return replace(schedule, steps=(step,), lift=None)


def task_from(schedule: Schedule, reached: float, positions: Array) -> TaskSpec:
    """Return the task that is left, from where the arms are.

    Args:
        schedule: that was executed.
        reached: how far, on the plan's clock [s].
        positions: (12,) measured, left arm first [rad].

    Raises:
        CannotPlanOn: a hand holds something, or something lies where no task can begin.
    """
    plan = schedule.plan
    moment = plan.at(reached)
    assert moment.segment is not None
    held = sorted(held_in(plan.segments[moment.segment]))
    if held:
        raise CannotPlanOn(
            f"{' and '.join(held)} {'is' if len(held) == 1 else 'are'} in a hand: put down by hand first"
        )
    begun = plan.at(0.0).body_poses
    moved = {name: pose for name, pose in moment.body_poses.items() if np.abs(pose - begun[name]).max() > _STILL}
    start = {"start_positions": positions.tolist()}
    task = to_post_again(plan.task)
    if isinstance(task, PlateLiftTask):
        if "plate" in moved:
            raise CannotPlanOn("the plate is not where the task has it: go back, or lay it down there, first")
        return _changed(task, **start)
    ended = plan.at(plan.duration).body_poses
    done = {name for name, pose in moved.items() if np.abs(pose - ended[name]).max() <= _STILL}
    left = [_at(each, moved.get(each.name)) for each in task.objects if each.name not in done]
    if not left:
        raise CannotPlanOn("every object is at its goal: nothing is left to be planned")
    away = sorted(set(moved) - {each.name for each in task.objects})
    if away:
        raise CannotPlanOn(f"{' and '.join(away)} is not where it was: put it back first")
    put = [
        {"name": each.name, "shape": each.shape, "pose": moved[each.name].tolist()}
        for each in task.objects
        if each.name in done
    ]
    return _changed(task, **start, objects=left, obstacles=[*task.obstacles, *put])


def held_in(segment: Segment) -> dict[str, ArmName]:
    """Return what hands hold in a segment, or begin or cease to, with one of the hands each."""
    riding = {body: arm for body, ride in segment.rides for arm in ARMS if ride.to == arm}
    return {grip.body: grip.arm for grip in segment.grips} | riding


def _at(body: ObjectToMove, pose: Array | None) -> ObjectToMove:
    return body if pose is None else body.model_copy(update={"pose": tuple(pose.tolist())})


def _changed(task: TaskSpec, **members: object) -> TaskSpec:
    """Return a task with other members, read and checked as if it were posted."""
    return read_task({**write_task(task), **to_jsonable_python(members)})


def _is_free(step: ProgramStep) -> bool:
    """Tell whether hands and vacuum stay as they are in a step."""
    return step.kind not in _TAKING and all(arm.width is None and arm.vacuum is None for arm in step.arms.values())


def _on_path(schedule: Schedule, arm: ArmName, clock: Array) -> tuple[Array, Array]:
    """Return positions and velocities (n, 6) of an arm at times (n,) on the plan's clock."""
    positions, velocities = np.empty((len(clock), 6)), np.empty((len(clock), 6))
    for rows, step, local in _by_step(schedule, clock):
        positions[rows], velocities[rows] = step.arms[arm].curve(local), step.arms[arm].curve(local, 1)
    return positions, velocities


def _wrenches_on_path(schedule: Schedule, arm: ArmName, time: Array, clock: Array) -> WrenchCurve | None:
    """Return what a hand exerts on a plate at times (n,) of a step that is at times (n,) on the plan's clock."""
    values = np.empty((len(clock), 6))
    for rows, step, local in _by_step(schedule, clock):
        curve = step.arms[arm].wrenches
        if curve is None:
            return None
        values[rows] = curve.at(local).values
    # A hand that is on the plate for a part of the way gives way to what it touches for the rest.
    return WrenchCurve(time, values if np.isnan(values).all() else np.nan_to_num(values))


def _by_step(schedule: Schedule, clock: Array) -> Iterator[tuple[NDArray[np.bool_], ProgramStep, Array]]:
    """Yield which of some times (n,) on the plan's clock are in a step, the step, and these as times from its begin."""
    index = np.searchsorted([step.begin for step in schedule.steps], clock, side="right") - 1
    for each in np.unique(index):
        rows, step = index == each, schedule.steps[max(each, 0)]
        yield rows, step, np.clip(clock[rows] - step.begin, 0.0, step.duration)
