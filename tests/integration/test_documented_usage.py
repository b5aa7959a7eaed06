"""What docstrings show of the planners' public surface works as shown."""

from __future__ import annotations

import doctest
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHOWN = ["planners", "planners.planning", "planners.plan.plan"]


@pytest.mark.parametrize("name", SHOWN)
def test_usage_in_docstrings_works(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    result = doctest.testmod(import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted
    assert not result.failed
