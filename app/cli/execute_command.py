"""`liftwright execute PLAN --left HOST --right HOST`: a certified plan on two controllers, under somebody's eyes."""

from __future__ import annotations

import json
import queue
import re
import signal
import sys
import termios
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.cli.export_command import site_cell
from app.cli.given_file import FileKind, read_given
from app.cli.output import BadInput
from planners.contract.arrays import ArmName
from planners.contract.task_spec import write_task
from planners.plan.scenery import ARMS
from planners.program import NotExportable, Schedule
from planners.program.archive import check_urscript
from planners.program.guard import exportable, physics_words
from planners.program.recovery import CannotPlanOn, held_in, task_from, way_back
from planners.program.schedule import ProgramStep
from planners.program.urscript import JOINT_TOLERANCE, SITE_FUNCTIONS
from workers.robot.arm_link import NORMAL_MODES, ArmLink, NoLink
from workers.robot.execution_log import ExecutionLog
from workers.robot.executor import Execution, ExecutionSettings, Executor

EXECUTED, REFUSED = 0, 2
_LIFT = "both hands rise as the lifter takes load off them; Enter ends it"
SILENT_FOR_GOOD = 0.5
"""A controller that told nothing new for so long is gone [s]."""


@dataclass(frozen=True)
class ExecuteRequest:
    """What was asked for on the command line."""

    plan: Path
    hosts: Mapping[ArmName, str]
    site: Path | None
    """Of the cell that is there; None: a shipped one."""
    moves: bool
    """Whether the arms move; else everything is looked at, and nothing moves."""
    continuous: bool
    """Whether steps are not confirmed one by one."""
    speed: float
    """Share of the planned one."""
    log: Path
    stops_may_drop: bool = False
    """Whether it holds for steps, too, in which a stop from it may lose what is carried."""
    functions: Path | None = None
    """URScript for fingers and vacuum that are mounted; None: as they are exported."""
    without_objects: bool = False
    """Whether what the plan moves is not there, see `Schedule.of`."""


def execute_file(request: ExecuteRequest, connect: Callable[[str], ArmLink] | None = None) -> int:
    """Execute a plan, or tell what executing it would be; returns the exit code.

    Args:
        request: what is executed, where and how.
        connect: makes the link to a controller, given its host; None: an `ArmLink` on the wall's clock.

    Raises:
        BadInput: A file cannot be made sense of.
        OSError: A file cannot be read or written.
    """
    document = read_given(str(request.plan), FileKind.PLAN)
    functions = None if request.functions is None else _functions(request.functions)
    with ExitStack() as stack:
        cell = stack.enter_context(site_cell(document, request.plan, request.site))
        try:
            schedule = Schedule.of(exportable(document, cell), with_objects=not request.without_objects)
            check_urscript(cell)
            links = {arm: (connect or ArmLink)(host) for arm, host in request.hosts.items()}
        except (NotExportable, NoLink) as why:
            sys.stderr.write(f"liftwright: {request.plan}: {why}\n")
            return REFUSED
        for link in links.values():
            stack.callback(link.close)
        settings = ExecutionSettings(request.speed, request.stops_may_drop, functions=functions)
        _tell_steps(schedule, settings)
        _say(f"  {physics_words(schedule.plan)}")
        faults = [*_unborne(schedule, settings), *_faults(schedule, links)]
        for fault in faults:
            sys.stderr.write(f"liftwright: {fault}\n")
        if not request.moves:
            _say("dry run: nothing was moved. With --run the arms move." if not faults else "dry run: would not begin.")
        if faults or not request.moves:
            return REFUSED if faults else EXECUTED
        with request.log.open("w") as file:
            return _Session(request, links, ExecutionLog(file, links[ARMS[0]].clock), settings).run(schedule)


def _functions(path: Path) -> str:
    """Read URScript for what is mounted.

    Raises:
        BadInput: It is no text, or does not define all that a program calls.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise BadInput(f"{path} is no text") from error
    missing = [name for name in SITE_FUNCTIONS if re.search(rf"^\s*def {name}\(", text, re.MULTILINE) is None]
    if missing:
        raise BadInput(f"{path} does not define {' and '.join(missing)}; `liftwright export` writes both as an example")
    return text


def _tell_steps(schedule: Schedule, settings: ExecutionSettings) -> None:
    plan, steps = schedule.plan, schedule.steps
    speeds = [settings.speed_in(step) for step in steps]
    takes = sum(step.duration / speed for step, speed in zip(steps, speeds, strict=True) if speed)
    slow = f", {takes:.0f} s as it is executed" if takes > 1.01 * plan.duration else ""
    _say(f"{plan.id or 'plan'}: {len(steps)} steps, {plan.duration:.1f} s at the planned speed{slow}")
    for step, speed in zip(steps, speeds, strict=True):
        slower = "" if speed == settings.speed else f", at {speed:g}: a stop from more may lose what is carried"
        _say(f"  {step.number:3d}  {step.duration:5.1f} s  {step.words}{slower}")
    if not schedule.with_objects:
        _say("  without the plate or the objects: hands press on nothing, and no lift follows")
    elif schedule.lift is not None:
        _say(f"  {schedule.last + 1:3d}  {_LIFT}")
    elif plan.task.kind == "plate_lift":
        _say("  no lift follows: its law is that of a simulation, and this plan has none that came to it")


def _unborne(schedule: Schedule, settings: ExecutionSettings) -> Iterator[str]:
    """Yield in which steps no stop is borne."""
    for step in schedule.steps:
        if not settings.speed_in(step):
            yield (
                f"step {step.number}: a stop may lose what is carried, however slow it is: plan with more "
                "reserve, or execute with --stops-may-drop"
            )


def _faults(schedule: Schedule, links: Mapping[ArmName, ArmLink]) -> Iterator[str]:
    """Yield why the plan cannot begin."""
    for arm, link in links.items():
        state = link.state()
        if state.safety_mode not in NORMAL_MODES:
            yield f"{arm}: the safety mode is {state.safety_mode}, not normal: see the pendant"
        if state.is_playing:
            yield f"{arm}: a program runs already: stop it on the pendant"
        off = np.abs(state.positions - schedule.start[arm])
        names = schedule.plan.joint_names[6 * ARMS.index(arm) :][:6]
        far = [f"{name} by {each:.3f} rad" for name, each in zip(names, off, strict=True) if each > JOINT_TOLERANCE]
        if far:
            yield f"{arm}: not where step {schedule.steps[0].number} begins: {', '.join(far)} off"


class _Keyboard:
    """Lines that a person types, asked for one question at a time; a question can be taken back."""

    def __init__(self) -> None:
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._taken_back = threading.Event()
        self.on_line: Callable[[], None] | None = None
        """Called for a line that nobody asked for."""
        self._asked = threading.Event()
        threading.Thread(target=self._read, name="keyboard", daemon=True).start()

    def ask(self, words: str) -> str | None:
        """Return what is answered, without spaces around it; None: nothing ever will be, or the question is void.

        What a person has typed before was no answer to it, and begins no step. What is piped in are answers in order.
        """
        self._forget_what_was_typed()
        self._taken_back.clear()
        self._asked.set()
        _say(words, end="")
        try:
            while not self._taken_back.is_set():
                try:
                    line = self._lines.get(timeout=0.1)
                except queue.Empty:
                    continue
                return None if line is None else line.strip()
            return None
        finally:
            self._asked.clear()

    def _forget_what_was_typed(self) -> None:
        if not sys.stdin.isatty():
            return
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
        while not self._lines.empty():
            if self._lines.get() is None:
                # Nobody is there any more.
                self._lines.put(None)
                return

    def take_back(self) -> None:
        """Let whoever asks wait no longer."""
        self._taken_back.set()

    def _read(self) -> None:
        for line in sys.stdin:
            if self._asked.is_set() or self.on_line is None:
                self._lines.put(line)
            else:
                self.on_line()
        self._lines.put(None)


class _Session:
    """Runs a schedule, and after a stop whatever a person chooses, until there is nothing more to choose."""

    def __init__(
        self,
        request: ExecuteRequest,
        links: Mapping[ArmName, ArmLink],
        log: ExecutionLog,
        settings: ExecutionSettings,
    ) -> None:
        self._request, self._links, self._log, self._settings = request, links, log, settings
        self._keyboard = _Keyboard()

    def run(self, schedule: Schedule) -> int:
        """Return the exit code."""
        todo: Schedule | None = schedule
        while todo is not None:
            execution = self._execute(todo)
            if execution.is_done:
                _say(f"done; the log is {self._request.log}")
                return EXECUTED
            self._tell_stop(todo, execution)
            todo = self._after(todo, execution.reached)
        return REFUSED

    def _execute(self, schedule: Schedule, *, continuous: bool | None = None) -> Execution:
        asks = not (self._request.continuous if continuous is None else continuous)

        def confirm(step: ProgramStep | None) -> bool:
            words = f"step {schedule.last + 1}: {_LIFT}"
            if step is not None:
                words = f"step {step.number}: {self._words_of(step)}"
            if not asks:
                _say(words)
                return True
            # Nothing follows a lifter unasked, and nobody goes on when there is nobody to say so.
            return self._keyboard.ask(f"{words}. Enter begins it, q stops: ") == ""

        executor = Executor(schedule, self._links, self._log, confirm, self._settings)
        self._keyboard.on_line = executor.end_lift
        try:
            with _interrupted(executor.ask_to_stop):
                return executor.run()
        finally:
            self._keyboard.on_line = None
            self._keyboard.take_back()

    def _words_of(self, step: ProgramStep) -> str:
        return f"{step.words}, {step.duration / self._settings.speed_in(step):.1f} s"

    def _tell_stop(self, schedule: Schedule, execution: Execution) -> None:
        assert execution.stop is not None
        arm = f" ({execution.stop.arm})" if execution.stop.arm else ""
        at = min(execution.reached.values())
        where = f"in step {execution.step}" if execution.step else "before the first step"
        _say(f"\nstopped: {execution.stop.reason.value}{arm}, {where}, {at:.2f} s from the begin of the plan")
        for name, state in execution.states.items():
            joints = " ".join(f"{each:.4f}" for each in state.positions)
            _say(f"  {name:5s} [{joints}] rad, {np.linalg.norm(state.force):.0f} N at the wrist")
        segment = schedule.plan.at(at).segment
        part = None if segment is None else schedule.plan.segments[segment]
        if part is None or not schedule.with_objects:
            return
        for body, carrier in ({body: ride.to for body, ride in part.rides} | held_in(part)).items():
            _say(f"  {body} is held by {carrier}: fingers and vacuum stay as they are")

    def _after(self, schedule: Schedule, reached: Mapping[ArmName, float]) -> Schedule | None:
        """Let a person choose what is done after a stop; returns what is executed next."""
        while True:
            if any(self._is_away(arm) for arm in ARMS):
                _say("a controller is stopped or gone: see the pendant, then start again")
                return None
            back = way_back(schedule, reached)
            begins = next((step for step in schedule.steps if abs(step.begin - max(reached.values())) < 1e-6), None)
            choices = {
                "b": None if back is None else f"b: {self._words_of(back.steps[0])}",
                "c": None if begins is None else f"c: go on from the begin of step {begins.number}",
                "p": "p: write the task that is left, from here" if schedule.with_objects else None,
            }
            offered = "; ".join(words for words in choices.values() if words is not None)
            answer = self._keyboard.ask(f"{offered}; Enter: leave it so\n> ")
            if answer == "c" and begins is not None:
                return schedule.since(begins.number)
            if answer == "p" and schedule.with_objects:
                self._write_task(schedule, min(reached.values()))
            if answer == "b" and back is not None:
                gone = self._execute(back, continuous=True)
                if not gone.is_done:
                    self._tell_stop(back, gone)
                reached = gone.reached
            if answer not in ("b", "c", "p"):
                return None

    def _is_away(self, arm: ArmName) -> bool:
        link = self._links[arm]
        state = link.state()
        silence = link.silence(state.timestamp)
        return state.safety_mode not in NORMAL_MODES or max(silence, link.unheard()) > SILENT_FOR_GOOD

    def _write_task(self, schedule: Schedule, reached: float) -> None:
        positions = np.concatenate([self._links[arm].state().positions for arm in ARMS])
        try:
            task = task_from(schedule, reached, positions)
        except CannotPlanOn as why:
            _say(str(why))
            return
        place = self._request.plan.with_suffix(".from_here.json")
        place.write_text(json.dumps(write_task(task), indent=2) + "\n")
        _say(f"{place}; `liftwright plan {place}` plans it")


@contextmanager
def _interrupted(stop: Callable[[], None]) -> Iterator[None]:
    """Have Ctrl-C stop the arms on their path instead of ending this program."""
    before = signal.signal(signal.SIGINT, lambda *_: stop())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _say(words: str, end: str = "\n") -> None:
    sys.stdout.write(words + end)
    sys.stdout.flush()
