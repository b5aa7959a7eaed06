"""What can be done after a stop leads along the path, lets go of nothing, and can be planned."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from planners import solve
from planners.contract.arrays import ArmName
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from planners.plan.segment import SegmentKind
from planners.program.recovery import BACK_SPEED, CannotPlanOn, task_from, way_back
from planners.program.schedule import Schedule
from tests.support.moving_plan import DURATION, MOVERS, moving_plan
from tests.support.plan_shelf import PlanShelf
from tests.support.service import task
from workers.solver.protocol import SolverRequest

COLUMNS = {"left": slice(0, 6), "right": slice(6, 12)}
TASKS = ("ab1", "domino_pile")


@pytest.fixture(scope="module")
def moving() -> Schedule:
    return Schedule.of(moving_plan())


@pytest.fixture(scope="module")
def path(moving: Schedule) -> np.ndarray:
    """The joints (n, 12) all along the plan."""
    return np.array([moving.plan.at(time).positions for time in np.arange(0.0, moving.plan.duration, 2e-4)])


@pytest.fixture(scope="module")
def schedules(shelf: PlanShelf) -> dict[str, Schedule]:
    documents = {name: shelf.take(SolverRequest(name, task(f"{name}.json")), lambda _: None) for name in TASKS}
    return {name: Schedule.of(Plan.read(document)) for name, document in documents.items()}


def both(time: float, apart: float = 0.0) -> dict[ArmName, float]:
    return {"left": time, "right": time - apart}


@pytest.mark.parametrize("reached", [0.02, 0.5, DURATION, 1.9, 4 * DURATION])
@pytest.mark.parametrize("apart", [0.0, 0.008])
def test_the_way_back_is_the_way_come_on_from_rest_to_rest(
    moving: Schedule, path: np.ndarray, reached: float, apart: float
) -> None:
    back = way_back(moving, both(reached, apart))
    assert back is not None
    (step,) = back.steps
    plan = moving.plan
    for arm in ARMS:
        mine = step.arms[arm]
        time = np.linspace(0.0, step.duration, 500)
        columns = COLUMNS[arm]
        assert KDTree(path[:, columns]).query(mine.curve(time))[0].max() < 5e-4
        assert mine.positions[0] == pytest.approx(plan.at(both(reached, apart)[arm]).positions[columns], abs=1e-9)
        assert mine.positions[-1] == pytest.approx(plan.at(0.0).positions[columns], abs=1e-9)
        assert mine.velocities[[0, -1]] == pytest.approx(0.0, abs=1e-9)
        planned = np.abs([segment.velocities[:, columns] for segment in plan.segments]).max()
        assert np.abs(mine.curve(time, 1)).max() <= 0.5 * np.pi * BACK_SPEED * planned + 1e-6
        assert np.abs(mine.curve(time, 2)).max() < plan.cell.arms[arm].acceleration_max.min()


def test_on_the_way_back_hands_exert_on_a_plate_what_they_did_there_on_the_way_come(
    schedules: dict[str, Schedule],
) -> None:
    """And give way to what they touch where they were away from it: the sensor is not zeroed before it is known."""
    schedule = schedules["ab1"]
    tipped = next(step for step in schedule.steps if step.kind is SegmentKind.TRANSFER)
    reached = tipped.begin + 0.5 * tipped.duration
    back = way_back(schedule, both(reached))
    assert back is not None
    (step,) = back.steps
    assert step.way is not None
    borne = 0
    for arm in ARMS:
        mine = step.arms[arm]
        assert mine.wrenches is not None
        assert not mine.free
        for time, value in zip(mine.wrenches.time, mine.wrenches.values, strict=True):
            clock = step.clock(time)
            there = max((each for each in schedule.steps if each.begin <= clock + 1e-9), key=lambda each: each.begin)
            curve = there.arms[arm].wrenches
            assert curve is not None
            told = curve.at(np.array([clock - there.begin])).values[0]
            if mine.wrenches.bears:
                np.testing.assert_allclose(value, np.nan_to_num(told), atol=1e-9)
                borne += bool(np.linalg.norm(value[:3]) > 3.0)
            else:
                assert np.isnan(told).all()
    assert borne > 10
    (pile,) = [way for way in [way_back(schedules["domino_pile"], both(1.0))] if way is not None]
    assert all(each.wrenches is None for each in pile.steps[0].arms.values())


def test_where_nothing_has_been_done_nothing_is_gone_back(moving: Schedule) -> None:
    assert way_back(moving, both(0.0)) is None


@pytest.mark.parametrize("name", TASKS)
def test_no_way_back_leads_across_a_hand_that_took_or_let_go(schedules: dict[str, Schedule], name: str) -> None:
    schedule = schedules[name]
    found = 0
    for reached in np.random.default_rng(0).uniform(0.0, schedule.plan.duration, 60):
        back = way_back(schedule, both(float(reached)))
        if back is None:
            continue
        found += 1
        begin = back.steps[0].begin
        crossed = [each for each in schedule.plan.segments if each.end > begin and each.time[0] < reached]
        assert all(np.ptp(width) == 0.0 for each in crossed for width in each.gripper_width.values())
        attached = [sorted((body, ride.to) for body, ride in each.rides if ride.to in ARMS) for each in crossed]
        assert all(each == attached[0] for each in attached)
    assert found > 20


def test_steps_from_one_on_keep_numbers_and_begin_where_the_plan_has_them(moving: Schedule) -> None:
    for number in range(1, len(MOVERS) + 1):
        rest = moving.since(number)
        assert [step.number for step in rest.steps] == list(range(number, len(MOVERS) + 1))
        assert rest.last == len(MOVERS)
        assert rest.step(number) is moving.step(number)
        assert rest.step(number - 1) is None
        for arm in ARMS:
            planned = moving.plan.at(rest.steps[0].begin).positions[COLUMNS[arm]]
            assert rest.start[arm] == pytest.approx(planned, abs=1e-12)


@pytest.mark.slow
def test_a_task_from_where_the_arms_stopped_is_planned_from_there(schedules: dict[str, Schedule]) -> None:
    schedule = schedules["ab1"]
    time = 0.5 * schedule.plan.segments[0].end
    here = schedule.plan.at(time).positions
    left = task_from(schedule, time, here)
    assert left.start_positions == pytest.approx(here)
    again = solve(left.model_copy(update={"options": left.options.model_copy(update={"simulate": False})}))
    assert again.outcome == "solved"
    assert again.segments[0].positions[0] == pytest.approx(here)
    assert again.certificate is not None
    assert again.certificate.passed


def test_what_a_hand_has_or_what_was_moved_is_no_begin_of_a_task(schedules: dict[str, Schedule]) -> None:
    for name, schedule in schedules.items():
        plan, told = schedule.plan, set[str]()
        for part in plan.segments:
            # While fingers close or open nothing is attached yet, or any more.
            held = {body for body, ride in part.rides if ride.to in ARMS} | {grip.body for grip in part.grips}
            time = 0.5 * (float(part.time[0]) + part.end)
            moved = any(
                np.abs(pose - plan.bodies[body].pose).max() > 1e-6 for body, pose in plan.at(time).body_poses.items()
            )
            if held:
                with pytest.raises(CannotPlanOn, match="in a hand"):
                    task_from(schedule, time, plan.at(time).positions)
                told.add("held")
            elif moved:
                told.add("moved")
            else:
                assert task_from(schedule, time, plan.at(time).positions).kind == plan.task.kind
                told.add("free")
        assert {"held", "free"} <= told, name
