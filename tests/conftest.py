"""What holds for all tests: kernels are those of today's sources, files that take long begin first, `--all` is all."""

from __future__ import annotations

import gc
import logging
import os
from collections.abc import Iterator

import pytest

from tests.support import samples
from tests.support.plan_shelf import PlanShelf
from workers.solver.warm_up import forget_stale_kernels

LONG_FIRST = (
    "robot/test_execution_in_physics",
    "robot/test_stops_in_physics",
    "acceptance/test_tasks_over_http",
    "robot/test_",
    "benchmarks/test_report",
    "soak/",
    "viewer/test_viewer_in_browser",
    "integration/",
    "acceptance/",
    "viewer/test_documents_in_browser",
    "viewer/",
    "regrasp/test_hard_objects",
    "manipulation/",
    "remedies/",
    "simulation/",
    "certify/",
    "contract_http/",
)
"""Beginnings of paths of files that take long, the longest first; but none beside another that waits for its plans."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Have an option for everything."""
    parser.addoption("--all", action="store_true", dest="whole", help="slow tests too, and the whole of every sample")


def pytest_configure(config: pytest.Config) -> None:
    """Test no kernel that was compiled before the last change of any source; tests keep none of their own."""
    samples.take(whole=config.option.whole)
    # A process that tests beside others was started by one that has done so.
    if "PYTEST_XDIST_WORKER" not in os.environ:
        forget_stale_kernels()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Look for no garbage in what is imported and collected: all of it stays, and there is more and more to look at."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


def pytest_unconfigure() -> None:
    """Let go of it all in order, as what is compiled asks for."""
    gc.unfreeze()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what only a run of everything has; put what takes long first; the rest keeps its order."""
    if not config.option.whole:
        chosen = samples.few_of_each([item for item in items if not item.get_closest_marker("slow")])
        left_out = set(items).difference(chosen)
        config.hook.pytest_deselected(items=[item for item in items if item in left_out])
        items[:] = chosen
    items.sort(key=lambda item: _place(item.nodeid.removeprefix("tests/")))


@pytest.fixture(autouse=True)
def _logs_go_where_they_went() -> Iterator[None]:
    """Forget where a test had the engine's logs written: that is closed by then, and the next engine would flush it."""
    engine = logging.getLogger("dbos")
    before = engine.handlers[:], engine.propagate
    yield
    engine.handlers[:], engine.propagate = before


@pytest.fixture(scope="session")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> PlanShelf:
    """Return where plans are that several tests look at, shared by all processes of this run."""
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "plans"
    folder.mkdir(exist_ok=True)
    return PlanShelf(folder)


def _place(path: str) -> int:
    return next((place for place, begin in enumerate(LONG_FIRST) if path.startswith(begin)), len(LONG_FIRST))
