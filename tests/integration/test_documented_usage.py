"""What docstrings show of the planners' public surface works as shown; `Plan.at` is tried where its timeline is."""

from __future__ import annotations

import doctest
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import planners
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import sample

ROOT = Path(__file__).parents[2]
SHOWN = [planners, planners.solve, planners.Plan.read]


@pytest.mark.parametrize("shown", SHOWN, ids=lambda shown: shown.__name__)
def test_usage_in_docstrings_works(
    shown: ModuleType | Callable[..., object], monkeypatch: pytest.MonkeyPatch, shelf: PlanShelf
) -> None:
    monkeypatch.chdir(ROOT)
    if sample(quick=shown is not planners.solve, whole=False):
        monkeypatch.setattr(planners, "solve", shelf.plan)
    (usage,) = doctest.DocTestFinder(recurse=False).find(shown, module=import_module("planners"), globs={})
    assert usage.examples
    assert not doctest.DocTestRunner().run(usage).failed
