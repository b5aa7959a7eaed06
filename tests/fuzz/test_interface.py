"""Whatever several owners do in whatever order, the service knows what it was told, as a model beside it does."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.interface import explore, explored
from tests.support.samples import sample


@pytest.mark.slow
def test_the_whole_interface_answers_as_a_model_beside_it_foretells(tmp_path: Path) -> None:
    examples, steps = sample((4, 20), (60, 50))
    with explored(tmp_path) as machine:
        explore(machine, examples, steps)
    assert machine.figures.examples >= examples
    seen = set(machine.figures.statuses)
    assert sample({200, 201, 202, 404}, {200, 201, 202, 204, 304, 400, 401, 403, 404, 409, 413, 415, 422, 429}) <= seen
