"""The running service: from 202 to done over HTTP, with a store of its own on this machine."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import httpx

from tests.benchmarks.tasks import SOLVABLE, TOO_HEAVY, Note, task_body, timed
from tests.support.service import finished, running_service

LONGEST_JOB_SECONDS = 120.0


@dataclass(frozen=True)
class ServiceFigures:
    """Seconds."""

    first_start: float
    """From the command to ready to serve with an empty data directory: handovers of the shipped tools are computed."""
    start: float
    """From the command to ready to serve, every other time."""
    accepted: dict[str, float]
    """From POST to its 202."""
    done: dict[str, float]
    """From the 202 to done, while a warm solver process waits for work."""
    states: dict[str, str]
    """How each job ended."""
    in_a_row: float
    """From the first 202 to the last done, all tasks posted at once, per task."""


def measure(note: Note, pause: float, names: Sequence[str] = (*SOLVABLE, *TOO_HEAVY)) -> ServiceFigures:
    """Post each task alone, `pause` seconds apart, so that a solver process is ready; then all at once."""
    note("starting the service")
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        with running_service(Path(folder), None) as service, service.client() as client:
            first_started = time.perf_counter() - begun
            accepted, done, states = {}, {}, {}
            for name in names:
                time.sleep(pause)
                note(f"{name} over HTTP")
                plan, accepted[name] = timed(lambda name=name: _post(client, name))
                ended, done[name] = timed(lambda plan=plan: finished(client, plan, LONGEST_JOB_SECONDS))
                states[name] = ended["outcome"] or ended["state"]
            note("all tasks at once over HTTP")
            _, seconds = timed(lambda: _all_at_once(client, names))
        begun = time.perf_counter()
        with running_service(Path(folder), None):
            started = time.perf_counter() - begun
    return ServiceFigures(first_started, started, accepted, done, states, seconds / len(names))


def _post(client: httpx.Client, name: str) -> dict:
    answer = client.post("/v1/plans", json=task_body(name))
    answer.raise_for_status()
    return answer.json()


def _all_at_once(client: httpx.Client, names: Sequence[str]) -> None:
    for plan in [_post(client, name) for name in names]:
        finished(client, plan, LONGEST_JOB_SECONDS * len(names))
