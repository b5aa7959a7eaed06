"""Work that tests have a workbench do. It is found by name in another process."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np

from planners.contract.scan_spec import ScanSpec
from planners.errors import SceneError


def process_of(*_: Any) -> int:
    """Return in which process this is done."""
    return os.getpid()


def echo(content: bytes) -> bytes:
    return content


def refuse(*_: Any) -> None:
    raise SceneError("/plate", "is too heavy", ["light"], others=["/cup"])


def fail(*_: Any) -> None:
    raise ZeroDivisionError("out of order")


def grow(*_: Any) -> None:
    """Take memory without end."""
    kept: list[Any] = []
    while True:
        kept.append(np.ones(10**6))


def die(*_: Any) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def work_on(told: Path, *_: Any) -> None:
    """Tell the process, and work for ever without a look at anything."""
    told.write_text(str(os.getpid()))
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
    threading.Event().wait()


def record_for_ever(_packed: bytes, _cell: Any, drawings: Path) -> str:
    """Stand in for what makes a recording; tell the process beside the folder of drawings."""
    work_on(drawings.parent / "told")
    return ""


def perceive_for_ever(scan: ScanSpec, *_: Any) -> None:
    """Stand in for what perceives; tell the process in the file that the scan names."""
    work_on(Path(scan.external_id or ""))


PREPARED = list[int]()
"""Processes that have prepared this module, and those that they were forked from."""


def prepare() -> None:
    """Note who has prepared it."""
    PREPARED.append(os.getpid())


def preparers() -> tuple[list[int], int]:
    """Return who has prepared it, and who has forked this process."""
    return PREPARED, os.getppid()
