"""What holds for all tests: kernels are those of today's sources, and files that take long begin first."""

from __future__ import annotations

from pathlib import Path

import pytest

from workers.solver.warm_up import KERNEL_FOLDERS, forget_stale_kernels

LONG_FIRST = (
    "viewer/test_viewer_in_browser",
    "acceptance/",
    "regrasp/test_hard_objects",
    "integration/",
    "simulation/",
    "certify/",
    "contract_http/",
)
"""Beginnings of paths of files that take long, the longest first."""


def pytest_configure() -> None:
    """Test no kernel that was compiled before the last change of any source."""
    forget_stale_kernels((*KERNEL_FOLDERS, Path(__file__).parent))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put what takes long first; the rest keeps its order."""
    items.sort(key=lambda item: _place(item.nodeid.removeprefix("tests/")))


def _place(path: str) -> int:
    return next((place for place, begin in enumerate(LONG_FIRST) if path.startswith(begin)), len(LONG_FIRST))
