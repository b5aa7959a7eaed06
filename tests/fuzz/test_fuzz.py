"""The fuzzing of `make bench`, a few hundred cases of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.fuzz import fuzz, watched_service

CASES = 300


@pytest.mark.slow
def test_bad_input_is_answered_in_little_memory_and_touches_nothing_outside_the_data_directory(tmp_path: Path) -> None:
    with watched_service(tmp_path) as target:
        fuzz(target, CASES)
        figures = target.conclude()
    assert figures.faults == []
    assert figures.cases > CASES
    assert set(figures.statuses) <= {200, 201, 202, 400, 413, 422}
    assert figures.documents > 0
