"""Plans executed through the unmodified `ur-rtde` on two stand-in controllers, and what is done to them meanwhile."""

from __future__ import annotations

import io
import json
import math
import multiprocessing
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from support.controller.lock_step import LockStep, lock_step, wait_for
from support.controller.physical_cell import TAKING_ON, PhysicalCell, PhysicalLift, PhysicalPile, physical_cell
from support.controller.site import CYCLE
from support.controller.stand_in import Recording, StandIn, hosts
from support.documents import plan_of
from support.moving_plan import DURATION, moving_plan
from support.plan_shelf import PlanShelf
from support.samples import among
from support.service import ROOT, task

from planners.contract.arrays import ArmName
from planners.contract.task_spec import PlateLiftTask
from planners.geometry.pose import rotation_angle
from planners.kinematics.forward import flange_pose
from planners.lifting.hand_admittance import HandAdmittance
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from planners.plan.segment import SegmentKind
from planners.program.schedule import STOP_DURATION, ProgramStep, Schedule, WrenchCurve
from planners.program.urscript import BEARING_TOLERANCE, SETTLING, ProgramState
from workers.robot.arm_link import ArmLink, NoLink
from workers.robot.execution_log import ExecutionLog
from workers.robot.executor import Confirm, Execution, ExecutionSettings, Executor
from workers.robot.supervision import StopReason, SupervisionSettings
from workers.simulation.settings import CupSettings

SHIPPED = sorted(path.name for path in (ROOT / "assets/tasks").glob("*.json"))
Recordings = Mapping[ArmName, Recording]
NORMAL = 1
"""RTDE's `safety_mode` of an arm that was not stopped."""
STANDSTILL = 0.1
"""In which both arms must stand still, whatever happens [s]."""


SCHEDULE = Schedule.of(moving_plan())


@dataclass
class Cell:
    """Two controllers on one clock, and what is executed on them."""

    clock: LockStep
    links: Mapping[ArmName, ArmLink]
    log: io.StringIO

    @property
    def stand_ins(self) -> Mapping[ArmName, StandIn]:
        return self.clock.stand_ins

    def execute(self, confirm: Confirm = lambda _: True, schedule: Schedule = SCHEDULE, **settings: Any) -> Execution:
        log = ExecutionLog(self.log, self.clock)
        return Executor(schedule, self.links, log, confirm, ExecutionSettings(**settings)).run()

    def events(self) -> list[dict[str, Any]]:
        return [line for line in map(json.loads, self.log.getvalue().splitlines()) if "event" in line]


@contextmanager
def cell() -> Iterator[Cell]:
    with lock_step(SCHEDULE) as clock:
        yield Cell(clock, {arm: clock.connect(hosts()[arm]) for arm in ARMS}, io.StringIO())


def curve(schedule: Schedule, arm: ArmName, step: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return what a plan has an arm do in a step, by SciPy."""
    mine = schedule.steps[step - 1].arms[arm]
    if not mine.moves:
        return lambda times: np.repeat(mine.positions, len(times), axis=0)
    return CubicHermiteSpline(mine.time, mine.positions, mine.velocities)


def assert_as_planned(schedule: Schedule, recordings: Recordings) -> None:
    """Recorded joints are within 1e-3 rad and one cycle of the plan, in each of its steps."""
    for arm, recording in recordings.items():
        for step in schedule.steps:
            assert off_plan(schedule, arm, step, recording) < 1e-3


def off_plan(schedule: Schedule, arm: ArmName, step: ProgramStep, recording: Recording) -> float:
    """Return how far a joint is off the plan within a cycle, at most in a step [rad]."""
    rows = running(recording, step.number)
    assert rows.any()
    times = recording.path_time[rows]
    # The joints are sent a cycle before the path's time goes on.
    off = [
        np.abs(curve(schedule, arm, step.number)(np.clip(times - late, 0.0, step.duration)) - recording.q[rows]).max(
            axis=1
        )
        for late in np.linspace(0.0, CYCLE, 5)
    ]
    return float(np.min(off, axis=0).max())


def apart(recordings: Recordings, step: int) -> np.ndarray:
    """Return by how much the arms are apart on the plan's clock in a step, cycle by cycle [s]."""
    left, right = (recordings[arm] for arm in ARMS)
    mine, other = running(left, step), running(right, step)
    return np.abs(np.interp(left.time[mine], right.time[other], right.path_time[other]) - left.path_time[mine])


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


def executed(
    schedule: Schedule, physics: PhysicalCell, seconds: float
) -> tuple[Execution, Mapping[ArmName, Recording]]:
    """Execute a plan in a world at its own speed, and follow its lifter for so long after it, if a lift follows."""
    with lock_step(schedule) as clock:
        links = {arm: clock.connect(hosts()[arm]) for arm in ARMS}
        clock.physics = physics

        def confirm(step: ProgramStep | None) -> bool:
            if step is None:
                # The lift begins a few cycles after it was confirmed.
                clock.at(clock.now() + TAKING_ON * SETTLING + seconds + 0.1, executor.end_lift)
            return True

        settings = ExecutionSettings(stops_may_drop=True)
        executor = Executor(schedule, links, ExecutionLog(io.StringIO(), clock), confirm, settings)
        execution = executor.run()
        return execution, {arm: clock.stand_ins[arm].recording() for arm in ARMS}


def assert_on_plate_as_planned(schedule: Schedule, recordings: Recordings) -> None:
    """Hands on the plate are off the plan by no more than they may give way, and lose that once they have let go."""
    for arm, recording in recordings.items():
        described, free = schedule.plan.cell.arms[arm], math.inf
        for step in schedule.steps:
            mine = step.arms[arm]
            assert mine.wrenches is not None
            rows = np.flatnonzero(running(recording, step.number))[::20]
            assert len(rows)
            if mine.wrenches.bears:
                free = 0.0
            planned = curve(schedule, arm, step.number)(np.clip(recording.path_time[rows], 0.0, step.duration))
            if not mine.wrenches.bears:
                left = BEARING_TOLERANCE * math.exp(-free / HandAdmittance.fading)
                assert off_plan(schedule, arm, step, recording) < left + 1e-3
                free += step.duration
            for q, planned_q in zip(recording.q[rows], planned, strict=True):
                T, T_planned = (
                    flange_pose(described.dh, described.T_world_base, each) @ mine.T_flange_tcp
                    for each in (q, planned_q)
                )
                assert np.linalg.norm(T[:3, 3] - T_planned[:3, 3]) < HandAdmittance.largest_correction + 1e-3
                assert rotation_angle(T[:3, :3], T_planned[:3, :3]) < HandAdmittance.largest_turning + 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_tasks_that_have_a_plan_are_executed_to_their_end(shelf: PlanShelf, name: str) -> None:
    """In physics: hands hold the plate, the cup its objects, by nothing but what the programs have the arms do."""
    document = shelf.document(task(name))
    if document["outcome"] != "solved":
        assert "segments" not in document or not document["segments"]
        return
    schedule = Schedule.of(plan_of(document))
    with physical_cell(schedule) as physics:
        execution, recordings = executed(schedule, physics, 1.0)
        assert physics.gave_way is None
        assert execution.is_done, execution.stop
        for step in schedule.steps:
            assert np.percentile(apart(recordings, step.number), 99) < 0.008
        if isinstance(physics, PhysicalLift):
            assert_on_plate_as_planned(schedule, recordings)
            assert physics.untracked
            admittance = HandAdmittance()
            # What the leak leaves of the largest correction, and what a sensor's noise does.
            most = admittance.leak * admittance.damping * admittance.largest_correction + 1.0
            assert all(np.median(off) < most for off in physics.untracked.values())
            assert physics.samples[-1].followed > 0.0
        else:
            assert_as_planned(schedule, recordings)
            assert_at_goals(physics)


def assert_at_goals(physics: PhysicalPile) -> None:
    watch = physics.execution.settings.watch
    for error in physics.execution.goal_errors().values():
        assert error.distance < watch.goal_distance
        assert error.angle < watch.goal_angle


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "part", "speed", "drops"),
    [
        *(("ab1.json", 0.5, 1.0, False), ("pb2.json", 0.8, 1.0, False)),
        *(("can_stack.json", 0.3, 1.0, False), ("domino_pile.json", 0.7, 1.0, False)),
        # Far from the hand that bears it, and what the world has to say of a stop from more than a stop is borne from.
        *(("carton_pile.json", 0.3, 1.0, False), ("carton_pile.json", 0.3, 0.6, True)),
        ("carton_pile.json", 0.1, 0.25, False),
    ],
)  # fmt: skip
def test_a_stop_on_request_drops_nothing(shelf: PlanShelf, name: str, part: float, speed: float, drops: bool) -> None:
    settings = ExecutionSettings(speed, stops_may_drop=drops)
    gave_way = stopped_midway(shelf, name, part, settings, protective=False)
    assert (gave_way is not None) == drops


@pytest.mark.slow
@pytest.mark.parametrize(("name", "part"), [("ab1.json", 0.2), ("domino_pile.json", 0.2)])
def test_a_slow_arm_that_is_stopped_for_protection_drops_nothing(shelf: PlanShelf, name: str, part: float) -> None:
    """That arm brakes as hard as it can, the other one as programs do, with what they hold."""
    assert stopped_midway(shelf, name, part, ExecutionSettings(0.25), protective=True) is None


def stopped_midway(
    shelf: PlanShelf, name: str, part: float, settings: ExecutionSettings, *, protective: bool
) -> str | None:
    """Stop both arms in the middle of a step in which something is carried; returns what gave way."""
    schedule = Schedule.of(plan_of(shelf.document(task(name))))
    carrying = [step for step in schedule.steps if step.kind is SegmentKind.TRANSFER and step.duration > 0.5]
    step = carrying[round(part * (len(carrying) - 1))]
    moving = next(arm for arm in ARMS if step.arms[arm].moves)
    speed = settings.speed_in(step)
    with physical_cell(schedule) as physics, lock_step(schedule) as clock:
        clock.physics = physics
        site = Cell(clock, {arm: clock.connect(hosts()[arm]) for arm in ARMS}, io.StringIO())
        log = ExecutionLog(site.log, clock)
        done: list[float] = []

        def act() -> None:
            done.append(clock.now())
            if protective:
                clock.stand_ins[moving].tell(protective_stop="by a test")
            else:
                executor.ask_to_stop()

        def confirm(begins: ProgramStep | None) -> bool:
            if begins is not None and begins.number == step.number:
                clock.at(clock.now() + 0.5 * step.duration / speed, act)
            return True

        executor = Executor(schedule, site.links, log, confirm, settings)
        ended = executor.run()
        assert ended.stop is not None
        assert ended.stop.reason is (StopReason.PROTECTIVE_STOP if protective else StopReason.ASKED)
        assert ended.step == step.number
        clock.sleep(1.0)
        for arm in ARMS:
            assert clock.stand_ins[arm].recording().still_since() - done[0] < STANDSTILL
        return physics.gave_way


@contextmanager
def lift_of(whole: Schedule, seed: int, lets_go: float = math.inf) -> Iterator[tuple[Schedule, PhysicalLift]]:
    """Give a world in which all but the lift is done, and the last moment of the plan with the lift after it."""
    with physical_cell(whole, seed, lets_go) as physics:
        assert isinstance(physics, PhysicalLift)
        joints, last, moment = physics.prepare(), whole.steps[-1], 0.1
        ended = {
            arm: replace(
                each, time=each.time[:1], positions=joints[arm][None], velocities=each.velocities[-1:],
                wrenches=WrenchCurve(np.array([0.0, moment]), each.wrenches.values[[-1, -1]]),
            )
            for arm, each in last.arms.items()
            if each.wrenches is not None
        }  # fmt: skip
        step = replace(last, begin=last.begin + last.duration, duration=moment, arms=ended)
        physics.schedule = replace(whole, steps=(step,))
        yield physics.schedule, physics


def heights(schedule: Schedule, arm: ArmName, recording: Recording, since: float) -> np.ndarray:
    """Return how high a flange is in each control cycle since a time [m]."""
    described = schedule.plan.cell.arms[arm]
    joints = recording.q[recording.time > since]
    return np.array([flange_pose(described.dh, described.T_world_base, q)[2, 3] for q in joints])


@pytest.fixture(scope="module")
def ab1(shelf: PlanShelf) -> Schedule:
    return Schedule.of(plan_of(shelf.document(task("ab1.json"))))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_hands_follow_whoever_raises_the_lifter_unevenly(ab1: Schedule, seed: int) -> None:
    """By what wrists feel alone: the cup bears no more than it can for long, and neither hand slips."""
    seconds, settings = 2.0, CupSettings()
    with lift_of(ab1, seed) as (schedule, physics):
        execution, recordings = executed(schedule, physics, seconds)
        assert physics.gave_way is None
        assert execution.is_done, execution.stop
        samples = physics.samples
    for arm, recording in recordings.items():
        assert np.diff(heights(ab1, arm, recording, physics.begun)).min() > -1e-6, "a hand went down"
    assert samples[-1].time > seconds, "the lift ended too soon"
    assert max(abs(each.risen - each.followed) for each in samples) < settings.travel
    assert max(each.pull for each in samples) < settings.burst * plate_task(ab1.plan).cup.max_force
    risen = np.array([each.risen for each in samples])
    assert samples[-1].followed == pytest.approx(risen[-1], abs=settings.travel)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_cup_that_lets_go_leaves_both_hands_at_rest(ab1: Schedule, seed: int) -> None:
    """What the lifter bore comes on the hands at once: they rise no more, and never go down."""
    slip = 1.0
    with lift_of(ab1, seed, lets_go=slip) as (schedule, physics):
        _, recordings = executed(schedule, physics, slip + 0.5)
        begun = physics.begun
    for arm, recording in recordings.items():
        risen, times = heights(ab1, arm, recording, begun), recording.time[recording.time > begun] - begun
        assert np.ptp(risen[times < slip]) > 1e-3, "they stood still before"
        assert np.abs(np.diff(risen[times > slip + STANDSTILL])).max() < 1e-9
        assert np.diff(risen).min() > -1e-6
        assert (recording.safety_mode == NORMAL).all()


def plate_task(plan: Plan) -> PlateLiftTask:
    assert isinstance(plan.task, PlateLiftTask)
    return plan.task
