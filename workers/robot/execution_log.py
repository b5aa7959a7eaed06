"""What happened while a plan was executed, as JSON lines: written as it happens, and read again to be played."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TextIO

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from planners.contract.arrays import ArmName
from planners.errors import LiftwrightError
from planners.geometry.pose import Array
from workers.robot.arm_link import ArmState
from workers.robot.clock import Clock, WallClock

SAMPLE_STEP = 0.02
"""Between two samples of the motion in the log [s]."""


class ExecutionLog:
    """Writes events and samples, each a line with its time since the begin [s]."""

    def __init__(self, file: TextIO, clock: Clock | None = None) -> None:
        self._file, self._clock, self._sampled = file, clock or WallClock(), -SAMPLE_STEP
        self._begin = self._clock.now()

    def event(self, name: str, **facts: Any) -> None:
        """Write that something happened."""
        self._write({"time": self._time(), "event": name, **facts})

    def sample(self, states: Mapping[ArmName, ArmState], clock: float) -> None:
        """Write where both arms are, unless that was just done; `clock`: where on the plan's clock that is [s]."""
        now = self._time()
        if now - self._sampled < SAMPLE_STEP:
            return
        self._sampled = now
        told = {arm: _told(state) for arm, state in states.items()}
        self._write({"time": now, "clock": round(clock, 6), "arms": told})

    def _time(self) -> float:
        return round(self._clock.now() - self._begin, 4)

    def _write(self, line: Mapping[str, Any]) -> None:
        self._file.write(json.dumps(line, separators=(",", ":")) + "\n")
        self._file.flush()


class _LoggedArm(BaseModel):
    positions: Annotated[tuple[float, ...], Field(min_length=6, max_length=6)]
    force: tuple[float, float, float]


class _LoggedArms(BaseModel):
    left: _LoggedArm
    right: _LoggedArm


class _Sample(BaseModel):
    """A line that says where the arms were."""

    time: float
    clock: float
    arms: _LoggedArms

    def row(self) -> list[float]:
        """Return time, clock, both arms' positions and both forces: (16,)."""
        both = (self.arms.left, self.arms.right)
        forces = (float(np.linalg.norm(arm.force)) for arm in both)
        return [self.time, self.clock, *(q for arm in both for q in arm.positions), *forces]


class _Event(BaseModel):
    """A line that says what happened."""

    event: str
    digest: str | None = None
    done: bool = False
    words: str = ""


_LINE: TypeAdapter[_Sample | _Event] = TypeAdapter(_Sample | _Event)


class NotALog(LiftwrightError):
    """A file is no log of an execution; says in which line."""


@dataclass(frozen=True, eq=False)
class ExecutedMotion:
    """What a log has of the motion of both arms, sample by sample."""

    digest: str | None
    """Of the plan."""
    time: Array
    """(n,) from the first sample, increasing [s]."""
    clock: Array
    """(n,) where on the plan's clock [s]."""
    positions: Array
    """(n, 12) measured, left arm first [rad]."""
    force: Array
    """(n, 2) at the wrist of each arm [N]."""
    ending: str
    """How the last run ended, for a person."""
    is_done: bool
    """Whether that was the end of the plan."""

    @classmethod
    def read(cls, path: Path) -> ExecutedMotion:
        """Read the log of an execution; one that ends in the middle of a line is read as far as it goes.

        Raises:
            NotALog: it is none, or nothing was executed.
        """
        samples, begun, ended = [], None, None
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
            try:
                told = _LINE.validate_json(line)
                if isinstance(told, _Sample):
                    samples.append(told.row())
                elif told.event == "begin":
                    begun = told
                elif told.event == "stop" or (told.event == "end" and told.done):
                    ended = told
            except ValidationError as error:
                if begun is not None and samples:
                    break
                raise NotALog(f"{path}:{number}: this is no log of an execution") from error
        if begun is None or len(samples) < 2:
            raise NotALog(f"{path}: nothing was executed")
        rows = np.array(samples)
        rows = rows[np.concatenate([[True], np.diff(rows[:, 0]) > 0.0])]
        return cls(
            digest=begun.digest,
            time=rows[:, 0] - rows[0, 0],
            clock=rows[:, 1],
            positions=rows[:, 2:14],
            force=rows[:, 14:],
            ending=_ending(ended),
            is_done=ended is not None and ended.event == "end",
        )


def _ending(ended: _Event | None) -> str:
    if ended is None:
        return "the log ends before the execution does"
    return "executed to its end" if ended.event == "end" else f"stopped: {ended.words}"


def _told(state: ArmState) -> dict[str, Any]:
    return {
        "timestamp": state.timestamp,
        "step": state.step,
        "path_time": round(state.path_time, 6),
        "state": state.state.name.lower(),
        "positions": np.round(state.positions, 6).tolist(),
        "force": np.round(state.force, 3).tolist(),
    }
