"""Plans executed through the unmodified `ur-rtde` on two stand-in controllers, and what is done to them meanwhile."""

from __future__ import annotations

import io
import json
import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from support.controller.site import CYCLE, configurations
from support.controller.spring_lifter import SpringLifter
from support.controller.stand_in import Recording, StandIn, hosts, stand_ins
from support.documents import plan_of
from support.moving_plan import DURATION, moving_plan
from support.plan_shelf import PlanShelf
from support.service import task

from planners.contract.arrays import ArmName
from planners.contract.task_spec import PlateLiftTask
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from planners.program.schedule import ProgramStep, Schedule
from planners.program.urscript import ProgramState
from workers.robot.arm_link import ArmLink, NoLink
from workers.robot.execution_log import ExecutionLog
from workers.robot.executor import Confirm, Execution, ExecutionSettings, Executor
from workers.robot.supervision import StopReason
from workers.simulation.lifter import WinchProfile
from workers.simulation.settings import CupSettings, WinchSettings

SLOWNESS = 5.0
"""Controllers and executor run in slow motion: a machine that tests other things besides is late by milliseconds."""
STANDSTILL = 0.1
"""In which both arms must stand still, whatever happens [s]."""


def clock() -> float:
    """Return the time of the slow world [s]."""
    return time.monotonic() / SLOWNESS


def wait(seconds: float) -> None:
    time.sleep(SLOWNESS * seconds)


SCHEDULE = Schedule.of(moving_plan())


@dataclass
class Cell:
    """Two controllers, and what is executed on them."""

    stand_ins: Mapping[ArmName, StandIn]
    links: Mapping[ArmName, ArmLink]
    log: io.StringIO

    def execute(self, confirm: Confirm = lambda _: True, schedule: Schedule = SCHEDULE, **settings: Any) -> Execution:
        return Executor(
            schedule, self.links, ExecutionLog(self.log), confirm, ExecutionSettings(**settings), clock
        ).run()

    def events(self) -> list[dict[str, Any]]:
        return [line for line in map(json.loads, self.log.getvalue().splitlines()) if "event" in line]


@contextmanager
def cell() -> Iterator[Cell]:
    with stand_ins(*configurations(SCHEDULE, SLOWNESS)) as controllers:
        links = {arm: ArmLink(hosts()[arm], clock=clock) for arm in ARMS}
        try:
            yield Cell(dict(zip(ARMS, controllers, strict=True)), links, io.StringIO())
        finally:
            for controller in controllers:
                controller.hear()
            for link in links.values():
                link.close()


def curve(arm: ArmName, step: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return what the plan has an arm do in a step, by SciPy."""
    mine = SCHEDULE.steps[step - 1].arms[arm]
    if not mine.moves:
        return lambda times: np.repeat(mine.positions, len(times), axis=0)
    return CubicHermiteSpline(mine.time, mine.positions, mine.velocities)


def running(recording: Recording, step: int) -> np.ndarray:
    return (recording.step == step) & (recording.state == ProgramState.RUNNING)


def test_both_arms_move_as_planned_and_stay_together() -> None:
    """Within 1e-3 rad and one cycle of the plan, the arms within 8 ms of each other, at a share of the speed too."""
    with cell() as site:
        execution = site.execute()
        assert execution.is_done, execution.stop
        site.stand_ins["left"].tell(joints=SCHEDULE.start["left"].tolist())
        site.stand_ins["right"].tell(joints=SCHEDULE.start["right"].tolist())
        begun = {arm: len(site.stand_ins[arm].recording().time) for arm in ARMS}
        wait(0.05)
        again = site.execute(speed=0.6, schedule=Schedule(SCHEDULE.plan, SCHEDULE.steps[:1]))
        assert again.is_done, again.stop
        recordings = {arm: site.stand_ins[arm].recording() for arm in ARMS}
    whole = {arm: slice(0, begun[arm]) for arm in ARMS}
    for arm, recording in recordings.items():
        for step in range(1, len(SCHEDULE.steps) + 1):
            rows = running(recording, step)
            times = recording.path_time[rows]
            # The joints are sent a cycle before the path's time goes on.
            off = [
                np.abs(curve(arm, step)(np.clip(times - late, 0.0, DURATION)) - recording.q[rows]).max(axis=1)
                for late in np.linspace(0.0, CYCLE, 5)
            ]
            assert np.min(off, axis=0).max() < 1e-3
            first = rows & (np.arange(len(rows)) < whole[arm].stop)
            lasted = recording.time[first][-1] - recording.time[first][0]
            assert lasted == pytest.approx(DURATION, abs=0.05)
    left, right = recordings["left"], recordings["right"]
    for step in range(1, len(SCHEDULE.steps) + 1):
        mine, other = running(left, step), running(right, step)
        times = np.interp(left.time[mine], right.time[other], right.path_time[other])
        assert np.percentile(np.abs(times - left.path_time[mine]), 99) < 0.008
    slow = running(left, 1) & (np.arange(len(left.time)) >= begun["left"])
    assert left.time[slow][-1] - left.time[slow][0] == pytest.approx(DURATION / 0.6, abs=0.1)
    steps = [event["number"] for event in site.events() if event["event"] == "step"]
    assert steps == [1, 2, 3, 4, 1]


def meanwhile(execution: Callable[[], Execution], moment: float, act: Callable[[], float]) -> tuple[Execution, float]:
    """Do something a while after an execution was begun; returns how it ended, and when that was done."""
    done: list[float] = []

    def wait_and_act() -> None:
        wait(moment)
        done.append(act())

    thread = threading.Thread(target=wait_and_act)
    thread.start()
    ended = execution()
    thread.join()
    return ended, done[0]


def assert_still(site: Cell, since: float, arms: tuple[ArmName, ...] = ARMS) -> None:
    wait(STANDSTILL)
    for arm in arms:
        recording = site.stand_ins[arm].recording()
        assert recording.still_since() > since - 0.05, "it did not move when it was stopped"
        assert recording.still_since() - since < STANDSTILL


STOPS: dict[str, tuple[dict[str, Any], StopReason]] = {
    "protective stop": ({"protective_stop": "by a test"}, StopReason.PROTECTIVE_STOP),
    "force": ({"wrench": [0.0, 0.0, 90.0, 0.0, 0.0, 0.0]}, StopReason.OVERLOAD),
    "silence": ({"silent": True}, StopReason.LOST),
}


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("what", STOPS)
def test_whatever_stops_one_arm_stops_both(what: str, arm: ArmName) -> None:
    order, reason = STOPS[what]
    with cell() as site:
        execution, since = meanwhile(
            lambda: site.execute(), 0.8, lambda: float(site.stand_ins[arm].tell(**order)["time"])
        )
        assert execution.stop is not None
        assert execution.stop.reason is reason
        assert execution.stop.arm == arm
        assert_still(site, since)
        assert site.events()[-1] == {**site.events()[-1], "event": "end", "done": False}


@pytest.mark.slow
def test_a_protective_stop_in_any_step_stops_both_arms() -> None:
    with cell() as site:
        for step in range(1, len(SCHEDULE.steps) + 1):
            for arm in ARMS:
                site.links[arm]._dashboard.unlockProtectiveStop()
                site.stand_ins[arm].tell(joints=SCHEDULE.start[arm].tolist())
            wait(0.05)
            begun = threading.Event()

            def told(next_step: ProgramStep | None, step: int = step, begun: threading.Event = begun) -> bool:
                if next_step is not None and next_step.number == step:
                    begun.set()
                return True

            def stop(begun: threading.Event = begun) -> float:
                assert begun.wait(60.0)
                wait(0.3)
                return float(site.stand_ins["right"].tell(protective_stop="by a test")["time"])

            execution, since = meanwhile(lambda told=told: site.execute(told), 0.0, stop)
            assert execution.stop is not None
            assert execution.stop.reason is StopReason.PROTECTIVE_STOP
            wait(STANDSTILL)
            for arm in ARMS:
                assert site.stand_ins[arm].recording().still_since() - since < STANDSTILL


@pytest.mark.slow
def test_a_controller_that_dies_leaves_the_other_arm_at_rest() -> None:
    with cell() as site:

        def kill() -> float:
            site.stand_ins["right"].kill()
            return clock()

        execution, since = meanwhile(lambda: site.execute(), 0.8, kill)
        assert execution.stop is not None
        assert execution.stop.reason is StopReason.LOST
        assert_still(site, since, ("left",))


@pytest.mark.slow
def test_arms_that_are_told_late_stay_together() -> None:
    with cell() as site:
        site.stand_ins["right"].tell(delay=0.006)
        execution = site.execute(schedule=Schedule(SCHEDULE.plan, SCHEDULE.steps[:2]))
        assert execution.is_done, execution.stop
        left, right = (site.stand_ins[arm].recording() for arm in ARMS)
    mine, other = running(left, 1), running(right, 1)
    apart = np.abs(np.interp(left.time[mine], right.time[other], right.path_time[other]) - left.path_time[mine])
    assert np.percentile(apart, 99) < 0.008 + 0.006


def _execute_alone() -> None:
    links = {
        arm: ArmLink(address, clock=clock)
        for arm, address in json.loads(multiprocessing.current_process().name).items()
    }
    Executor(SCHEDULE, links, ExecutionLog(io.StringIO()), lambda _: True, clock=clock).run()


@pytest.mark.slow
def test_an_executor_that_is_killed_leaves_both_arms_at_rest() -> None:
    with cell() as site:
        process = multiprocessing.get_context("spawn").Process(target=_execute_alone, name=json.dumps(hosts()))
        process.start()
        until = time.monotonic() + 30.0
        while site.links["left"].state().path_time < 0.3:
            assert time.monotonic() < until
            time.sleep(0.002)
        process.kill()
        since = clock()
        process.join()
        assert_still(site, since)


def test_nothing_moves_from_elsewhere_nor_without_a_yes() -> None:
    with cell() as site:
        refused = site.execute(lambda _: False)
        assert refused.stop is not None
        assert refused.stop.reason is StopReason.ASKED
        site.stand_ins["left"].tell(joints=[*(SCHEDULE.start["left"] + 0.02).tolist()])
        wait(0.05)
        elsewhere = site.execute()
        assert elsewhere.stop is not None
        assert elsewhere.stop.reason is StopReason.WRONG_START
        assert elsewhere.stop.arm == "left"
        for arm in ARMS:
            assert np.ptp(site.stand_ins[arm].recording().q, axis=0).max() <= 0.02 + 1e-12


def test_where_no_controller_is_that_is_said() -> None:
    with pytest.raises(NoLink, match="does not answer"):
        ArmLink("127.0.0.9")


@pytest.fixture(scope="module")
def lift(shelf: PlanShelf) -> Schedule:
    """Return a moment at the end of AB1, and the lift after it."""
    whole = Schedule.of(plan_of(shelf.document(task("ab1.json"))))
    last = whole.steps[-1]
    ended = {
        arm: replace(each, time=each.time[:1], positions=each.positions[-1:], velocities=each.velocities[-1:])
        for arm, each in last.arms.items()
    }
    moment = 0.1
    return replace(whole, steps=(replace(last, begin=last.begin + last.duration, duration=moment, arms=ended),))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_hands_follow_whoever_raises_the_lifter_unevenly(lift: Schedule, seed: int) -> None:
    """By what wrists feel alone: the cup bears no more than it can for long, and nothing goes down."""
    winch, seconds = WinchProfile.draw(1.0, 0.002, np.random.default_rng(seed), WinchSettings()), 2.0
    with stand_ins(*configurations(lift, SLOWNESS)) as controllers:
        site = dict(zip(ARMS, controllers, strict=True))
        links = {arm: ArmLink(hosts()[arm], clock=clock) for arm in ARMS}
        with SpringLifter(lift, site, winch, clock).at_work() as lifter:
            executor = Executor(lift, links, ExecutionLog(io.StringIO()), lambda _: True, ExecutionSettings(), clock)

            def end() -> None:
                until = time.monotonic() + 60.0
                while not (lifter.samples and lifter.samples[-1].time > seconds) and time.monotonic() < until:
                    time.sleep(0.02)
                executor.end_lift()

            ending = threading.Thread(target=end)
            ending.start()
            execution = executor.run()
            ending.join()
        for link in links.values():
            link.close()
    assert execution.is_done, execution.stop
    followed = [each for each in lifter.samples if each.time < seconds]
    assert np.diff([each.followed for each in followed]).min() > -1e-4
    plate, cup, settings = lift.plan.bodies["plate"], plate_task(lift.plan).cup, CupSettings()
    assert max(abs(each.risen - each.followed) for each in followed) < settings.travel
    assert plate.mass is not None
    weight = plate.mass * np.linalg.norm(lift.plan.cell.gravity)
    borne = np.array([weight - each.force for each in followed])
    assert borne.max() < settings.burst * cup.max_force
    over = np.flatnonzero(borne > cup.max_force)
    for run in np.split(over, np.flatnonzero(np.diff(over) > 1) + 1):
        assert len(run) == 0 or followed[run[-1]].time - followed[run[0]].time < settings.grace


def plate_task(plan: Plan) -> PlateLiftTask:
    assert isinstance(plan.task, PlateLiftTask)
    return plan.task
