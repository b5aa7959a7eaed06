"""`liftwright execute` on two stand-in controllers, with somebody at the keyboard who answers what is asked."""

from __future__ import annotations

import io
import json
import os
import pty
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from app.cli import execute_command
from app.cli.execute_command import ExecuteRequest, _Keyboard, execute_file
from app.cli.output import BadInput
from planners.plan.scenery import ARMS
from planners.program.schedule import Schedule
from planners.program.urscript import write_urscript
from tests.support.controller.lock_step import LockStep, lock_step
from tests.support.controller.stand_in import hosts
from tests.support.moving_plan import DURATION, moving_plan

SCHEDULE = Schedule.of(moving_plan())


class Terminal(io.StringIO):
    """Keeps what is said, and answers what is asked in turn; what is no text is called, and its result typed."""

    def __init__(self, keyboard: int, answers: list[str | Callable[[], str]]) -> None:
        super().__init__()
        self._keyboard, self._answers = keyboard, answers

    def write(self, words: str) -> int:
        if words.endswith((": ", "> ")):
            if not self._answers:
                os.close(self._keyboard)
            else:
                answer = self._answers.pop(0)
                os.write(self._keyboard, f"{answer if isinstance(answer, str) else answer()}\n".encode())
        return super().write(words)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Terminal]]:
    reading, writing = os.pipe()
    with os.fdopen(reading) as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)

        def sits_there(*answers: str | Callable[[], str]) -> Terminal:
            screen = Terminal(writing, list(answers))
            monkeypatch.setattr(sys, "stdout", screen)
            return screen

        yield sits_there
        # Whoever still reads there sees the end.
        with suppress(OSError):
            os.close(writing)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[LockStep]:
    """Have controllers for a plan that is not certified, which the tests of `exportable` are for."""
    monkeypatch.setattr(execute_command, "exportable", lambda document, cell: SCHEDULE.plan)
    with lock_step(SCHEDULE) as clock:
        yield clock


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.json"
    path.write_bytes(SCHEDULE.plan.write())
    return path


def request(plan: Path, *, moves: bool = True, continuous: bool = False) -> ExecuteRequest:
    return ExecuteRequest(plan, hosts(), None, moves, continuous, 1.0, plan.with_suffix(".log.jsonl"))


@pytest.mark.slow
def test_without_run_all_is_told_and_nothing_moves(
    clock: LockStep, plan: Path, terminal: Callable[..., Terminal]
) -> None:
    screen = terminal()
    assert execute_file(request(plan, moves=False), clock.connect) == 0
    for step in SCHEDULE.steps:
        assert step.words in screen.getvalue()
    assert "nothing was moved" in screen.getvalue()
    for controller in clock.stand_ins.values():
        assert np.ptp(controller.recording().q, axis=0).max() == 0.0


@pytest.mark.slow
def test_arms_that_are_elsewhere_are_named_with_their_joints(
    clock: LockStep, plan: Path, terminal: Callable[..., Terminal], capsys: pytest.CaptureFixture[str]
) -> None:
    terminal()
    joints = SCHEDULE.start["right"].copy()
    joints[2] += 0.05
    clock.stand_ins["right"].tell(joints=joints.tolist())
    assert execute_file(request(plan), clock.connect) == 2
    said = capsys.readouterr().err
    assert f"{SCHEDULE.plan.joint_names[8]} by 0.050 rad" in said
    assert "left" not in said


@pytest.mark.slow
def test_each_step_is_asked_for_and_whoever_is_not_there_moves_nothing(
    clock: LockStep, plan: Path, terminal: Callable[..., Terminal]
) -> None:
    assert_done = terminal("", "", "", "")
    assert execute_file(request(plan), clock.connect) == 0
    assert assert_done.getvalue().count("Enter begins it") == len(SCHEDULE.steps)
    log = [json.loads(line) for line in plan.with_suffix(".log.jsonl").read_text().splitlines()]
    assert [line["number"] for line in log if line.get("event") == "step"] == [1, 2, 3, 4]
    assert log[-1]["done"]


@pytest.mark.slow
def test_after_a_stop_one_goes_back_and_on(clock: LockStep, plan: Path, terminal: Callable[..., Terminal]) -> None:
    """Ctrl-C in the second step; back to the begin; then all of it, with a task written on the way."""

    def interrupted_later() -> str:
        clock.at(clock.now() + 0.4 * DURATION, lambda: signal.raise_signal(signal.SIGINT))
        return ""

    screen = terminal("", interrupted_later, "b", "p", "c", "", "", "", "")
    assert execute_file(request(plan), clock.connect) == 0
    said = screen.getvalue()
    assert "stopped: somebody asked to stop, in step 2" in said
    assert "back to the begin of step 1" in said
    assert "done; the log is" in said.rstrip().splitlines()[-1]
    written = json.loads(plan.with_suffix(".from_here.json").read_text())
    np.testing.assert_allclose(written["start_positions"], np.hstack([SCHEDULE.start[arm] for arm in ARMS]), atol=1e-2)
    for arm, controller in clock.stand_ins.items():
        end = SCHEDULE.steps[-1].arms[arm].positions[-1]
        np.testing.assert_allclose(controller.recording().q[-1], end, atol=1e-3)


@pytest.mark.slow
def test_whoever_leaves_after_a_stop_leaves_the_arms_where_they_are(
    clock: LockStep, plan: Path, terminal: Callable[..., Terminal]
) -> None:
    screen = terminal("", "q", "")
    assert execute_file(request(plan), clock.connect) == 2
    assert "stopped: somebody asked to stop" in screen.getvalue()
    for arm, controller in clock.stand_ins.items():
        end = SCHEDULE.steps[0].arms[arm].positions[-1]
        np.testing.assert_allclose(controller.recording().q[-1], end, atol=1e-3)


def test_functions_for_what_is_mounted_must_define_all_that_a_program_calls(tmp_path: Path, plan: Path) -> None:
    path = tmp_path / "mounted.script"
    path.write_text("def site_fingers(width, force):\nend\n")
    with pytest.raises(BadInput, match=r"mounted\.script does not define site_vacuum"):
        execute_file(replace(request(plan), functions=path))


def test_functions_for_what_is_mounted_are_in_both_programs_in_place_of_the_defaults() -> None:
    given = "def site_fingers(width, force):\n  textmsg(width)\nend\ndef site_vacuum(on):\nend"
    for arm in ARMS:
        program = write_urscript(SCHEDULE, arm, functions=given)
        assert program.count("def site_fingers(") == program.count("def site_vacuum(") == 1
        assert "63352" not in program


def test_what_was_typed_before_it_was_asked_for_begins_no_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who pressed Enter while the plan was certified has not seen what it would begin."""
    person, terminal = pty.openpty()
    with os.fdopen(terminal) as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        os.write(person, b"\n\n")
        asked = _Keyboard()
        answers: list[str | None] = []
        # What is typed last is its end.
        for typed in (b"y\nearly\n", b"y\nearly\n", b"\x04"):
            asking = Thread(target=lambda: answers.append(asked.ask("")), daemon=True)
            asking.start()
            asking.join(0.3)
            assert asking.is_alive(), "nobody has answered yet"
            os.write(person, typed)
            asking.join(5.0)
        assert answers == ["y", "y", None]
        os.close(person)
