"""What holds for all tests: files that take long begin first, so that all cores end at about the same time."""

from __future__ import annotations

import pytest

LONG_FIRST = (
    "viewer/test_viewer_in_browser",
    "acceptance/",
    "integration/",
    "simulation/",
    "certify/",
    "contract_http/",
)
"""Beginnings of paths of files that take long, the longest first."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put what takes long first; the rest keeps its order."""
    items.sort(key=lambda item: _place(item.nodeid.removeprefix("tests/")))


def _place(path: str) -> int:
    return next((place for place, begin in enumerate(LONG_FIRST) if path.startswith(begin)), len(LONG_FIRST))
