"""The soak of `make bench`, short and with made-up solvers: whatever is killed, every accepted job ends once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from tests.benchmarks.attempt_file import AttemptFile
from tests.benchmarks.soak import SoakFigures, SoakRound, SoakSettings, soak
from tests.support.postgres import needs_postgres
from tests.support.service import FAKE_SOLVER, task


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


def test_a_round_is_kept_in_a_file_as_it_was(tmp_path: Path) -> None:
    figures = SoakFigures(3, 1.5, Counter(solver=2, api=1), Counter(succeeded=3), 4, 5, ["one promise"])
    file = AttemptFile(tmp_path / "rounds.jsonl", SoakRound)
    file.add(SoakRound("SQLite", 7, figures.data()))
    (kept,) = file.read().values()
    assert (kept.key, kept.sums, "3 kills" in kept.told()) == (("SQLite", 7), figures, True)
    assert kept.sums + kept.sums == SoakFigures(
        6, 3.0, Counter(solver=4, api=2), Counter(succeeded=6), 8, 10, 2 * ["one promise"]
    )
