"""The soak of `make bench`, short and with made-up solvers: whatever is killed, every accepted job ends once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.postgres import needs_postgres
from support.service import FAKE_SOLVER, task

from tests.benchmarks.soak import SoakSettings, soak


def body(number: int) -> dict[str, Any]:
    return task(external_id=f"steps-{10 + number % 3 * 10}")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("postgres", "jobs", "kills"),
    [pytest.param(False, 8, 4, id="sqlite"), pytest.param(True, 10, 6, id="postgres", marks=needs_postgres)],
)
def test_every_accepted_job_ends_with_one_whole_document_whatever_is_killed(
    postgres: bool, jobs: int, kills: int, tmp_path: Path
) -> None:
    settings = SoakSettings(jobs, kills, postgres, body, FAKE_SOLVER, seed=3)
    figures = soak(settings, tmp_path, lambda _: None)
    assert figures.faults == []
    assert figures.states == {"succeeded": jobs}
    assert sum(figures.kills.values()) == kills
