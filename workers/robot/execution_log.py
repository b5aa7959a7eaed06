"""What happened while a plan was executed, as JSON lines."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any, TextIO

import numpy as np

from planners.contract.arrays import ArmName
from workers.robot.arm_link import ArmState

SAMPLE_STEP = 0.02
"""Between two samples of the motion in the log [s]."""


class ExecutionLog:
    """Writes events and samples, each a line with its time since the begin [s]."""

    def __init__(self, file: TextIO) -> None:
        self._file, self._begin, self._sampled = file, time.monotonic(), -SAMPLE_STEP

    def event(self, name: str, **facts: Any) -> None:
        """Write that something happened."""
        self._write({"time": self._time(), "event": name, **facts})
        self._file.flush()

    def sample(self, states: Mapping[ArmName, ArmState]) -> None:
        """Write where both arms are, unless that was just done."""
        now = self._time()
        if now - self._sampled < SAMPLE_STEP:
            return
        self._sampled = now
        self._write({"time": now, "arms": {arm: _told(state) for arm, state in states.items()}})

    def _time(self) -> float:
        return round(time.monotonic() - self._begin, 4)

    def _write(self, line: Mapping[str, Any]) -> None:
        self._file.write(json.dumps(line, separators=(",", ":")) + "\n")


def _told(state: ArmState) -> dict[str, Any]:
    return {
        "timestamp": state.timestamp,
        "step": state.step,
        "path_time": round(state.path_time, 6),
        "state": state.state.name.lower(),
        "positions": np.round(state.positions, 6).tolist(),
        "force": np.round(state.force, 3).tolist(),
    }
