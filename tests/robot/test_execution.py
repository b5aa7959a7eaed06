"""Plans executed through the unmodified `ur-rtde` on two stand-in controllers, and what is done to them meanwhile."""

from __future__ import annotations

import io
import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import pytest

from planners.contract.arrays import ArmName
from planners.contract.task_spec import read_task
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from planners.program.schedule import STOP_DURATION, ProgramStep, Schedule
from planners.program.urscript import OPENING_SECONDS, ProgramState
from tests.support.controller.executed import STANDSTILL, Cell, apart, assert_as_planned, running
from tests.support.controller.lock_step import LockStep, lock_step, wait_for
from tests.support.controller.site import CYCLE
from tests.support.controller.stand_in import hosts
from tests.support.moving_plan import DURATION, moving_plan
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import among
from tests.support.service import task
from workers.robot.arm_link import ArmLink, NoLink
from workers.robot.execution_log import ExecutionLog
from workers.robot.executor import Execution, ExecutionSettings, Executor
from workers.robot.supervision import StopReason, SupervisionSettings

SCHEDULE = Schedule.of(moving_plan())


@contextmanager
def cell() -> Iterator[Cell]:
    with lock_step(SCHEDULE) as clock:
        yield Cell(SCHEDULE, clock, {arm: clock.connect(hosts()[arm]) for arm in ARMS}, io.StringIO())


@pytest.mark.slow
def test_both_arms_move_as_planned_and_stay_together() -> None:
    """Within 1e-3 rad and one cycle of the plan, the arms within 8 ms of each other, at a share of the speed too."""
    with cell() as site:
        execution = site.execute()
        assert execution.is_done, execution.stop
        site.stand_ins["left"].tell(joints=SCHEDULE.start["left"].tolist())
        site.stand_ins["right"].tell(joints=SCHEDULE.start["right"].tolist())
        begun = {arm: len(site.stand_ins[arm].recording().time) for arm in ARMS}
        site.clock.sleep(0.05)
        again = site.execute(speed=0.6, schedule=Schedule(SCHEDULE.plan, SCHEDULE.steps[:1]))
        assert again.is_done, again.stop
        recordings = {arm: site.stand_ins[arm].recording() for arm in ARMS}
    for arm, recording in recordings.items():
        for step in range(1, len(SCHEDULE.steps) + 1):
            first = running(recording, step) & (np.arange(len(recording.time)) < begun[arm])
            lasted = recording.time[first][-1] - recording.time[first][0]
            assert lasted == pytest.approx(DURATION, abs=0.05)
    assert_as_planned(SCHEDULE, recordings)
    for step in range(1, len(SCHEDULE.steps) + 1):
        assert np.percentile(apart(recordings, step), 99) < 0.008
    left = recordings["left"]
    slow = running(left, 1) & (np.arange(len(left.time)) >= begun["left"])
    assert left.time[slow][-1] - left.time[slow][0] == pytest.approx(DURATION / 0.6, abs=0.1)
    steps = [event["number"] for event in site.events() if event["event"] == "step"]
    assert steps == [1, 2, 3, 4, 1]


def execute_and(
    site: Cell, step: int, act: Callable[[], object], after: float = 0.3, **settings: Any
) -> tuple[Execution, float]:
    """Execute, and do something a while after a step was begun; returns how it ended, and when that was done."""
    done: list[float] = []
    # Behind the first barrier fingers open before anything moves.
    after += OPENING_SECONDS if step == 1 and SCHEDULE.openings else 0.0

    def confirm(begins: ProgramStep | None) -> bool:
        if begins is not None and begins.number == step:
            site.clock.at(site.clock.now() + after, do)
        return True

    def do() -> None:
        done.append(site.clock.now())
        act()

    ended = site.execute(confirm, **settings)
    assert len(done) == 1
    return ended, done[0]


def assert_still(site: Cell, since: float, arms: tuple[ArmName, ...] = ARMS) -> None:
    """Whatever moved when something happened stood still in time, and still does."""
    site.clock.sleep(2 * STANDSTILL)
    for arm in arms:
        recording = site.stand_ins[arm].recording()
        assert recording.still_since() - since < STANDSTILL
        step = SCHEDULE.steps[recording.step[recording.time <= since][-1] - 1]
        if step.arms[arm].moves:
            assert recording.still_since() > since - CYCLE, "it did not move when it was stopped"


STOPS: dict[str, tuple[dict[str, Any], StopReason]] = {
    "protective stop": ({"protective_stop": "by a test"}, StopReason.PROTECTIVE_STOP),
    "force": ({"wrench": [0.0, 0.0, 90.0, 0.0, 0.0, 0.0]}, StopReason.OVERLOAD),
    "silence": ({"silent": True}, StopReason.LOST),
    "lost packets": ({"loss": 1.0}, StopReason.LOST),
}


ONE_ARM_EACH = (("protective stop", "left"), ("force", "right"), ("silence", "left"), ("lost packets", "right"))


@pytest.mark.parametrize(("what", "arm"), among(product(STOPS, ARMS), ONE_ARM_EACH))
@pytest.mark.slow
def test_whatever_stops_one_arm_stops_both(what: str, arm: ArmName) -> None:
    order, reason = STOPS[what]
    with cell() as site:
        execution, since = execute_and(site, 1, lambda: site.stand_ins[arm].tell(**order))
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
            site.clock.sleep(0.05)
            execution, since = execute_and(
                site, step, lambda: site.stand_ins["right"].tell(protective_stop="by a test")
            )
            assert execution.stop is not None
            assert execution.stop.reason is StopReason.PROTECTIVE_STOP
            assert execution.step == step
            assert_still(site, since)


@pytest.mark.slow
def test_a_controller_that_dies_leaves_the_other_arm_at_rest() -> None:
    with cell() as site:
        execution, since = execute_and(site, 1, site.stand_ins["right"].kill)
        assert execution.stop is not None
        assert execution.stop.reason is StopReason.LOST
        assert_still(site, since, ("left",))


@pytest.mark.slow
def test_a_connection_that_breaks_between_two_looks_at_it_is_a_controller_lost_and_no_computer_late() -> None:
    with cell() as site:
        link = site.links["right"]
        listen = link.silence

        def listen_once_more(timestamp: float) -> float:
            heard = listen(timestamp)
            link._is_lost = True
            return heard

        execution, _ = execute_and(site, 1, lambda: setattr(link, "silence", listen_once_more))
        assert execution.stop is not None
        assert (execution.stop.reason, execution.stop.arm) == (StopReason.LOST, "right")


@pytest.mark.slow
def test_arms_that_are_told_late_stay_together() -> None:
    with cell() as site:
        site.stand_ins["right"].tell(delay=0.006)
        execution = site.execute(schedule=Schedule(SCHEDULE.plan, SCHEDULE.steps[:2]))
        assert execution.is_done, execution.stop
        recordings = {arm: site.stand_ins[arm].recording() for arm in ARMS}
    assert np.percentile(apart(recordings, 1), 99) < 0.008 + 0.006


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_arms_on_a_network_that_is_late_now_and_then_stay_together(seed: int) -> None:
    jitter = 0.006
    with cell() as site:
        for number, arm in enumerate(ARMS):
            site.stand_ins[arm].tell(jitter=jitter, seed=2 * seed + number)
        execution = site.execute()
        assert execution.is_done, execution.stop
        recordings = {arm: site.stand_ins[arm].recording() for arm in ARMS}
    assert_as_planned(SCHEDULE, recordings)
    for step in range(1, len(SCHEDULE.steps) + 1):
        assert np.percentile(apart(recordings, step), 99) < 0.008 + jitter


@pytest.mark.slow
def test_a_computer_that_is_a_little_late_goes_on_and_one_that_is_too_late_stops_both_arms() -> None:
    """Whichever notices first, the programs or the computer: the reason that is told is the true one."""
    with cell() as site:
        for late, goes_on in ((0.03, True), (0.06, False)):
            execution, _ = execute_and(site, 1, lambda late=late: site.clock.sleep(late))
            assert execution.is_done == goes_on, execution.stop
            for arm in ARMS:
                site.stand_ins[arm].tell(joints=SCHEDULE.start[arm].tolist())
            site.clock.sleep(0.05)
        assert execution.stop is not None
        assert execution.stop.reason is StopReason.LATE
        for arm in ARMS:
            assert running(site.stand_ins[arm].recording(), 1)[-1]


@pytest.mark.slow
def test_a_silent_controller_stops_the_other_arm_however_seldom_the_computer_looks() -> None:
    """A computer that looks so seldom counts hardly any of the silence, and knows nothing of that arm all the same."""
    seldom = 0.03
    with cell() as site:
        execution, since = execute_and(site, 1, lambda: site.stand_ins["right"].tell(silent=True), period=seldom)
        assert execution.stop is not None
        assert execution.stop.reason in (StopReason.LATE, StopReason.LOST)
        site.clock.sleep(3 * STANDSTILL)
        # Two looks find nothing new, at most one more goes by before that, and then the arm brakes.
        assert site.stand_ins["left"].recording().still_since() - since < 3 * seldom + 0.5 * STANDSTILL


class HandClock:
    """A clock that shows what a test sets."""

    time = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds


@pytest.mark.slow
def test_time_in_which_nobody_looked_says_nothing_of_a_controller() -> None:
    with cell() as site:
        link, told = site.links["left"], site.links["left"].timestamp
        link.clock = clock = HandClock()
        assert link.silence(told) == 0.0
        clock.sleep(0.03)
        assert link.silence(told) < SupervisionSettings().silence / 2
        for _ in range(10):
            clock.sleep(CYCLE)
            link.silence(told)
        assert link.silence(told) > SupervisionSettings().silence
        assert link.unheard() == pytest.approx(0.03 + 10 * CYCLE)
        link.clock = site.clock


class DistantClock:
    """The clock of another process, at the other end of a pipe."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self.links: dict[ArmName, ArmLink] = {}

    def now(self) -> float:
        return self._ask(0.0)

    def sleep(self, seconds: float) -> None:
        self._ask(seconds)

    def _ask(self, seconds: float) -> float:
        self._pipe.send(seconds)
        now, told = self._pipe.recv()
        wait_for(self.links, told)
        return now


def _execute_alone(addresses: dict[ArmName, str], pipe: Connection) -> None:
    clock = DistantClock(pipe)
    links = {arm: ArmLink(address, clock=clock) for arm, address in addresses.items()}
    clock.links = links
    Executor(SCHEDULE, links, ExecutionLog(io.StringIO()), lambda _: True).run()


@pytest.mark.parametrize("late", among([0.0, 0.04], [0.04]))
@pytest.mark.slow
def test_a_step_that_bears_stops_from_less_is_slower_and_brakes_as_gently(
    late: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stop takes as long from a fifth of the speed as from all of it, after a faster step and on a late network."""
    first, second, *others = SCHEDULE.steps
    slow = replace(SCHEDULE, steps=(first, replace(second, stop_share=0.2), *others))
    with cell() as site:
        for arm in ARMS:
            monkeypatch.setattr(site.links[arm], "pace", delayed(site.clock, late, site.links[arm].pace))

        def confirm(step: ProgramStep | None) -> bool:
            if step is not None and step.number == second.number:
                site.clock.at(site.clock.now() + 2.0 * second.duration, executor.ask_to_stop)
            return True

        executor = Executor(slow, site.links, ExecutionLog(site.log, site.clock), confirm, ExecutionSettings())
        ended = executor.run()
        assert ended.stop is not None
        assert (ended.stop.reason, ended.step) == (StopReason.ASKED, second.number)
        recordings = {arm: site.stand_ins[arm].recording() for arm in ARMS}
    for recording in recordings.values():
        rows = running(recording, second.number)
        shares = np.diff(recording.path_time[rows]) / np.diff(recording.time[rows])
        assert shares[: len(shares) // 2].max() == pytest.approx(0.2, abs=0.01)
        brake = shares[len(shares) // 2 :]
        assert np.count_nonzero((brake > 1e-6) & (brake < 0.199)) == pytest.approx(STOP_DURATION / CYCLE, abs=3)


def delayed(clock: LockStep, late: float, pace: Callable[[float], None]) -> Callable[[float], None]:
    """Have a share arrive late."""
    return lambda share: clock.at(clock.now() + late, lambda: pace(share)) if late else pace(share)


@pytest.mark.slow
def test_an_executor_that_is_killed_leaves_both_arms_at_rest() -> None:
    with cell() as site:
        context = multiprocessing.get_context("spawn")
        mine, yours = context.Pipe()
        process = context.Process(target=_execute_alone, args=(hosts(), yours))
        process.start()

        def serve() -> None:
            assert mine.poll(120.0)
            site.clock.sleep(mine.recv())
            mine.send((site.clock.now(), site.clock.told))

        with site.clock.let_go():
            # A link asks for the time once it is connected.
            for _ in ARMS:
                serve()
        while site.links["left"].state().path_time < 0.3:
            serve()
        process.kill()
        process.join()
        assert_still(site, site.clock.now())


@pytest.mark.slow
def test_nothing_moves_from_elsewhere_nor_without_a_yes() -> None:
    with cell() as site:
        refused = site.execute(lambda _: False)
        assert refused.stop is not None
        assert refused.stop.reason is StopReason.ASKED
        site.stand_ins["left"].tell(joints=[*(SCHEDULE.start["left"] + 0.02).tolist()])
        site.clock.sleep(0.05)
        elsewhere = site.execute()
        assert elsewhere.stop is not None
        assert elsewhere.stop.reason is StopReason.WRONG_START
        assert elsewhere.stop.arm == "left"
        for arm in ARMS:
            assert np.ptp(site.stand_ins[arm].recording().q, axis=0).max() <= 0.02 + 1e-12


@pytest.mark.slow
def test_after_a_no_both_programs_have_ended_and_may_go_on_from_there() -> None:
    """What registers still tell of the program before is not taken for the next one."""
    with cell() as site:
        refused = site.execute(lambda step: step is None or step.number < 2)
        assert refused.stop is not None
        assert (refused.stop.reason, refused.step) == (StopReason.ASKED, 1)
        assert all(state.state is ProgramState.STOPPED for state in refused.states.values())
        gone_on = site.execute(schedule=SCHEDULE.since(2))
        assert gone_on.is_done, gone_on.stop


def test_where_no_controller_is_that_is_said() -> None:
    with pytest.raises(NoLink, match="does not answer"):
        ArmLink("127.0.0.9")


@pytest.fixture(scope="module")
def ab1(shelf: PlanShelf) -> Plan:
    return shelf.plan(read_task(task("ab1.json")))


@pytest.mark.slow
@pytest.mark.parametrize("with_objects", [True, False])
def test_a_lift_can_be_run_without_its_plate_where_it_is_told_so(ab1: Plan, with_objects: bool) -> None:
    """Wrists feel nothing: hands that should press on a plate press on, until their program ends."""
    schedule = Schedule.of(ab1, with_objects=with_objects)
    with lock_step(schedule) as clock:
        site = Cell(schedule, clock, {arm: clock.connect(hosts()[arm]) for arm in ARMS}, io.StringIO())
        execution = site.execute()
        recordings = {arm: site.stand_ins[arm].recording() for arm in ARMS}
    if with_objects:
        assert execution.stop is not None
        assert execution.stop.reason is StopReason.OVERLOAD
        return
    assert execution.is_done, execution.stop
    assert execution.step == schedule.last, "no lift follows"
    assert_as_planned(schedule, recordings)
