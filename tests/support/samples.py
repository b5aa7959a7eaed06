"""How much of a law is tried: a sample in every run, all of it with the option `--all`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import pytest

T = TypeVar("T")
MOST_CASES = 2
"""Of one law in a quick run."""


class _Extent:
    whole = True
    """Whether this run has the option `--all`, which is known before any file of tests is read; else nothing is saved
    on, as in benchmarks."""


def take(*, whole: bool) -> None:
    """Say which of both this run is."""
    _Extent.whole = whole


def sample(quick: T, whole: T) -> T:
    """Return what a law is tried on, or on how many cases: less in every run, more with `--all`."""
    return whole if _Extent.whole else quick


def among(cases: Iterable[Any], quick: Sequence[Any]) -> list[Any]:
    """Return parameters of a test: of all its cases those for every run, and the others marked as slow.

    A case that is a tuple has several parameters.
    """
    return [
        case if case in quick else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
        for case in cases
    ]


def few_of_each(items: Sequence[pytest.Item]) -> list[pytest.Item]:
    """Return of each law's cases a few, spread evenly, the first and the last among them; in the order of before.

    Rules have each of theirs: a case of theirs is a part of the product that nothing else looks at.
    """
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    few: set[pytest.Item] = set()
    for law, all_cases in cases.items():
        last, steps = len(all_cases) - 1, MOST_CASES - 1
        whole = last <= steps or "rules/" in law
        few |= set(all_cases) if whole else {all_cases[round(step * last / steps)] for step in range(MOST_CASES)}
    return [item for item in items if item in few]


def told(cases: Iterable[dict[str, Any]]) -> list[Any]:
    """Return the cases of a file of problems, each named by its story; those that the file calls slow are marked so."""
    return [
        pytest.param(case, id=case["story"], marks=[pytest.mark.slow] if case.get("slow") else []) for case in cases
    ]
