"""Runs a plan's programs on two controllers, keeps them in step, and stops both as soon as anything is wrong."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field

from planners.contract.arrays import ArmName
from planners.plan.scenery import ARMS
from planners.program.schedule import STOP_DURATION, ProgramStep, Schedule
from planners.program.urscript import ProgramState, start_tolerance, write_urscript
from workers.robot.arm_link import ArmLink, ArmState
from workers.robot.execution_log import ExecutionLog
from workers.robot.supervision import ArmSupervisor, Stop, StopReason, SupervisionSettings

Confirm = Callable[[ProgramStep | None], bool]
"""Asks a person whether a step may begin, None: the lift that follows the last one; it may take as long as it likes."""


@dataclass(frozen=True)
class ExecutionSettings:
    """How a plan is executed."""

    speed: float = 1.0
    """Share of the planned speed, above 0 and at most 1, of both arms."""
    stops_may_drop: bool = False
    """Whether steps are executed at that speed, too, in which a stop from it may lose what is carried."""
    period: float = 0.002
    """Of supervision: an e-Series' control cycle [s]."""
    patience: float = 2.0
    """How long programs may take to start, and arms to stand still after a stop [s]."""
    supervision: SupervisionSettings = field(default_factory=SupervisionSettings)
    functions: str | None = None
    """URScript for what is mounted, see `write_urscript`."""

    def speed_in(self, step: ProgramStep) -> float:
        """Return the share of the planned speed in a step; 0: no stop is borne in it."""
        return self.speed if self.stops_may_drop else min(self.speed, step.stop_share)


@dataclass(frozen=True, eq=False)
class Execution:
    """How an execution ended."""

    stop: Stop | None
    """None: the plan was executed to its end."""
    states: Mapping[ArmName, ArmState]
    """What each arm told last."""
    step: int
    """The last step that was begun; 0: none."""
    reached: Mapping[ArmName, float]
    """Where each arm is on the plan's clock [s]."""

    @property
    def is_done(self) -> bool:
        """Whether the plan was executed to its end."""
        return self.stop is None


class Executor:
    """One run of one schedule."""

    def __init__(
        self,
        schedule: Schedule,
        links: Mapping[ArmName, ArmLink],
        log: ExecutionLog,
        confirm: Confirm,
        settings: ExecutionSettings | None = None,
    ) -> None:
        """Be ready to run a schedule.

        Args:
            schedule: of a plan that may be executed, see `planners.program.guard`.
            links: to each arm's controller; they share a clock.
            log: of all that happens.
            confirm: asked before each step.
            settings: how it is run.

        Raises:
            ValueError: no stop is borne in a step, and stops must not lose anything.
        """
        settings = settings or ExecutionSettings()
        if not all(settings.speed_in(step) for step in schedule.steps):
            raise ValueError("a step bears no stop, and none may lose what is carried")
        self._clock = links[ARMS[0]].clock
        self._due = self._clock.now()
        self._schedule, self._links, self._log, self._confirm = schedule, links, log, confirm
        self._settings = settings
        self._supervisor = ArmSupervisor(schedule, self._settings.supervision)
        self._asked_to_stop, self._lifted = threading.Event(), threading.Event()
        self._shares: dict[ArmName, float] = {}
        self._speed, self._since = 0.0, self._due
        """Share of the planned speed in the step that is executed, or begins next, and since when it is asked for."""
        self._confirmed = schedule.steps[0].number - 1
        self._asking: Future[bool] | None = None

    def ask_to_stop(self) -> None:
        """Have both arms stop on their path; from any thread."""
        self._asked_to_stop.set()

    def end_lift(self) -> None:
        """Have the lift end as high as it has come, if it has begun; from any thread."""
        if self._confirmed > self._schedule.last:
            self._lifted.set()

    def off_start(self) -> dict[ArmName, list[int]]:
        """Return which joints of which arm are not where the plan begins, by their places from 0."""
        off = {arm: abs(self._links[arm].state().positions - self._schedule.start[arm]) for arm in ARMS}
        most = {arm: start_tolerance(self._schedule, arm) for arm in ARMS}
        return {arm: [int(j) for j in (off[arm] > most[arm]).nonzero()[0]] for arm in ARMS}

    def run(self) -> Execution:
        """Load both programs and see them to their end; both arms stand still when this returns."""
        off = self.off_start()
        if any(off.values()):
            self._log.event("refused", off_start=off)
            return self._ended(Stop(StopReason.WRONG_START, next(arm for arm in ARMS if off[arm])))
        try:
            stop = self._start() or self._watch()
        except BaseException:
            # Whatever goes wrong here, Ctrl-C too: arms must not go on without anybody.
            self._stop_arms(None)
            raise
        if stop is not None:
            self._stop_arms(stop)
            self._log.event("stop", reason=stop.reason.name.lower(), words=stop.reason.value, arm=stop.arm)
        execution = self._ended(stop)
        self._log.event("end", done=execution.is_done, step=execution.step, reached=execution.reached)
        return execution

    def _start(self) -> Stop | None:
        """Start both programs, and wait until both stand before the first step."""
        # Written first: the one that is loaded waits for the signs of life of this process from its first lines on.
        programs = {arm: write_urscript(self._schedule, arm, functions=self._settings.functions) for arm in ARMS}
        for arm, link in self._links.items():
            link.load(programs[arm])
        self._take_up_speed(self._confirmed + 1)
        until = self._clock.now() + self._settings.patience
        states, silences = self._beat(), dict.fromkeys(ARMS, 0.0)
        while self._clock.now() < until:
            states = self._beat()
            silences = {arm: self._links[arm].silence(state.timestamp) for arm, state in states.items()}
            # Registers keep what a program before this one wrote.
            if all(
                state.is_playing and state.barrier == self._confirmed + 1 and state.state is ProgramState.WAITING
                for state in states.values()
            ):
                self._since = self._clock.now()
                self._log.event(
                    "begin",
                    plan=self._schedule.plan.id,
                    digest=self._schedule.plan.digest,
                    speed=self._settings.speed,
                    with_objects=self._schedule.with_objects,
                )
                return None
            self._wait()
        for arm in ARMS:
            if silences[arm] > self._settings.supervision.silence:
                return Stop(StopReason.LOST, arm)
            if states[arm].state is ProgramState.WRONG_START:
                return Stop(StopReason.WRONG_START, arm)
        return Stop(StopReason.ENDED, None)

    def _beat(self) -> dict[ArmName, ArmState]:
        for link in self._links.values():
            link.beat()
        return {arm: link.state() for arm, link in self._links.items()}

    def _watch(self) -> Stop | None:
        told: dict[ArmName, tuple[int, float, float, float]] = {}
        looked = self._clock.now()
        while True:
            late, looked = self._clock.now() - looked, self._clock.now()
            states = {arm: link.state() for arm, link in self._links.items()}
            silences = {arm: self._links[arm].silence(states[arm].timestamp) for arm in ARMS}
            stop = self._supervisor.fault(states, silences)
            if stop is None and all(state.state is ProgramState.DONE for state in states.values()):
                return None
            late = max(late, *(link.unheard() for link in self._links.values()))
            if late > self._settings.supervision.late and (stop is None or stop.reason is StopReason.ENDED):
                # The programs may have noticed before this did, and ended.
                stop = Stop(StopReason.LATE, None)
            if stop is None and self._asked_to_stop.is_set():
                stop = Stop(StopReason.ASKED, None)
            if stop is not None:
                return stop
            for link in self._links.values():
                link.beat()
            for arm, other in ((ARMS[0], ARMS[1]), (ARMS[1], ARMS[0])):
                each = states[other]
                news = each.barrier, each.lift_force, each.lift_speed, each.lift_height
                if told.get(arm) != news:
                    self._links[arm].relay(each)
                    told[arm] = news
            self._ask(states)
            self._keep_in_step(states)
            self._log.sample(states, min(map(self._on_clock, states.values())))
            self._wait()

    def _wait(self) -> None:
        """Wait for the next control cycle; one that was missed is not made up for."""
        now = self._clock.now()
        self._due = max(self._due + self._settings.period, now)
        self._clock.sleep(self._due - now)

    def _ask(self, states: Mapping[ArmName, ArmState]) -> None:
        """Have the next step confirmed once both arms stand before it."""
        if self._asking is not None:
            if self._asking.done():
                self._answered(self._asking.result())
            return
        waiting = [state.barrier for state in states.values() if state.state is ProgramState.WAITING]
        if len(waiting) == 2 and waiting[0] == waiting[1] == self._confirmed + 1:
            self._take_up_speed(waiting[0])
            # Both arms take it up while they wait, so that they begin alike.
            if self._clock.now() - self._since > STOP_DURATION + 10 * self._settings.period:
                self._asking = _asked(self._confirm, self._schedule.step(waiting[0]))
        elif self._lifted.is_set() and self._confirmed == self._schedule.last + 1:
            self._answered(True)

    def _answered(self, yes: bool) -> None:
        self._asking = None
        if not yes:
            self._asked_to_stop.set()
            return
        self._confirmed += 1
        for link in self._links.values():
            link.confirm(self._confirmed)
        self._log.event("step", number=self._confirmed)

    def _take_up_speed(self, number: int) -> None:
        """Have both arms take up the speed of a step, or of the lift."""
        step = self._schedule.step(number)
        speed = self._settings.speed if step is None else self._settings.speed_in(step)
        if speed != self._speed:
            self._speed, self._since = speed, self._clock.now()
            for arm in ARMS:
                self._pace(arm, speed)

    def _keep_in_step(self, states: Mapping[ArmName, ArmState]) -> None:
        """Slow whichever arm is ahead, in proportion to its lead."""
        lead, speed, pull = self._supervisor.lead(states), self._speed, self._settings.supervision.pull
        for arm, ahead in (("left", lead), ("right", -lead)):
            self._pace(arm, speed * max(0.0, 1.0 - pull * max(0.0, ahead)))

    def _pace(self, arm: ArmName, share: float) -> None:
        if abs(self._shares.get(arm, -1.0) - share) > 1e-3 or (share == self._speed != self._shares[arm]):
            self._shares[arm] = share
            self._links[arm].pace(share)

    def _stop_arms(self, stop: Stop | None) -> None:
        """Stop both arms, the one that can be reached first, and end their programs once they stand still."""
        lost = stop.arm if stop is not None and stop.reason is StopReason.LOST else None
        reached = [arm for arm in ARMS if arm != lost]
        for arm in reached:
            self._links[arm].stop()
        until = self._clock.now() + self._settings.patience
        while self._clock.now() < until:
            for arm in reached:
                self._links[arm].beat()
            if all(_has_ended(self._links[arm].state()) for arm in reached):
                break
            self._wait()
        for arm in reached:
            self._links[arm].end_program()

    def _ended(self, stop: Stop | None) -> Execution:
        states = {arm: link.state() for arm, link in self._links.items()}
        # Registers keep what a program before this one wrote.
        begun = self._confirmed >= self._schedule.steps[0].number
        reached = {
            arm: self._on_clock(state) if begun else self._schedule.steps[0].begin for arm, state in states.items()
        }
        return Execution(stop, states, min(state.step for state in states.values()) if begun else 0, reached)

    def _on_clock(self, state: ArmState) -> float:
        """Return where an arm is on the plan's clock [s]; in the lift, at its end."""
        last = self._schedule.steps[-1]
        if state.state is ProgramState.WAITING:
            # The step in its registers is the one before, or what another program left there.
            awaited = self._schedule.step(state.barrier)
            return last.clock(last.duration) if awaited is None else awaited.clock(0.0)
        step = self._schedule.step(state.step)
        return last.clock(last.duration) if step is None else step.clock(state.path_time)


def _has_ended(state: ArmState) -> bool:
    """Tell whether an arm stands still, and its program has come to an end, too: slow arms look as if they stood."""
    moves = state.is_playing and state.state in (ProgramState.RUNNING, ProgramState.WAITING)
    return state.is_still and not moves


def _asked(confirm: Confirm, step: ProgramStep | None) -> Future[bool]:
    """Ask in a thread of its own, which nobody waits for when the program ends."""
    answer: Future[bool] = Future()

    def ask() -> None:
        try:
            answer.set_result(confirm(step))
        except BaseException as error:  # noqa: BLE001 - it is raised where the answer is read
            answer.set_exception(error)

    threading.Thread(target=ask, name="confirmation", daemon=True).start()
    return answer
