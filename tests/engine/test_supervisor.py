"""Work in the background goes on whatever happens to it, and what does not get on is told."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
from sqlalchemy import exc
from structlog.testing import capture_logs

from workers.engine import supervisor as module
from workers.engine.supervisor import Supervisor


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FIRST_RETRY_SECONDS", 0.01)
    monkeypatch.setattr(module, "STUCK_SECONDS", 0.0)


class Work:
    """Fails as it is told, as often as it is told."""

    def __init__(self, error: BaseException, failures: int, *, first: BaseException | None = None) -> None:
        """`first`: what it fails with at first, if not with the same."""
        self.error, self.failures, self.times = error, failures, 0
        self.first = first or error

    async def __call__(self) -> None:
        self.times += 1
        if self.times <= self.failures:
            raise self.first if self.times == 1 else self.error


def supervised(work: Work, holds: Callable[[Supervisor], bool]) -> None:
    """Have work repeated until something holds."""

    async def run() -> None:
        supervisor = Supervisor()
        supervisor.repeat("work", work, 0.01)
        try:
            async with asyncio.timeout(10.0):
                while not holds(supervisor):
                    await asyncio.sleep(0.005)
        finally:
            await supervisor.stop()
        before = work.times
        await asyncio.sleep(0.05)
        assert work.times == before

    asyncio.run(run())


def test_work_that_fails_is_done_again_and_the_log_has_its_traceback() -> None:
    work = Work(ValueError("out of order"), 3)
    with capture_logs() as logged:
        supervised(work, lambda _: work.times >= 6)
    assert [(each["event"], each["work"], each["exc_info"]) for each in logged] == [
        ("background work failed", "work", True)
    ] * 3


@pytest.mark.slow
def test_work_that_keeps_failing_is_stuck_until_it_goes_well_once() -> None:
    work = Work(ValueError("out of order"), 5)
    told: list[tuple[int, bool]] = []

    def watched(supervisor: Supervisor) -> bool:
        told.append((work.times, supervisor.stuck == ["work"]))
        return work.times >= 8

    supervised(work, watched)
    assert {stuck for times, stuck in told if 2 <= times <= 5} == {True}
    assert {stuck for times, stuck in told if times in (0, 8)} == {False}


def test_a_failure_is_not_told_before_it_has_lasted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "STUCK_SECONDS", 60.0)
    work = Work(ValueError("out of order"), 1000)
    supervised(work, lambda supervisor: bool(supervisor.stuck) or work.times >= 4)
    assert work.times >= 4


@pytest.mark.parametrize("kind", [exc.OperationalError, exc.InterfaceError])
def test_a_database_that_is_away_is_waited_for_and_nothing_is_stuck(kind: type[exc.DBAPIError]) -> None:
    work = Work(kind("", {}, Exception("away")), 3)

    def watched(supervisor: Supervisor) -> bool:
        assert supervisor.stuck == []
        return work.times >= 5

    supervised(work, watched)


def test_an_odd_failure_before_the_database_goes_away_does_not_count_for_as_long_as_that_lasts() -> None:
    """As when a server is failed over: one transaction ends oddly, then nobody answers."""
    work = Work(exc.OperationalError("", {}, Exception("away")), 5, first=ValueError("odd"))

    def watched(supervisor: Supervisor) -> bool:
        # After its next try the first failure is over.
        assert supervisor.stuck == [] or work.times == 1
        return work.times >= 5

    supervised(work, watched)


def test_work_that_has_ended_for_good_is_stuck() -> None:
    """As when the threads that it needs are cancelled under it."""
    work = Work(asyncio.CancelledError(), 1)
    supervised(work, lambda supervisor: supervisor.stuck == ["work"])


def test_work_is_done_after_its_first_pause_or_at_once() -> None:
    async def run() -> None:
        later, soon, supervisor = Work(ValueError(), 0), Work(ValueError(), 0), Supervisor()
        supervisor.repeat("later", later, 60.0)
        supervisor.repeat("soon", soon, 60.0, at_once=True)
        await asyncio.sleep(0.05)
        await supervisor.stop()
        assert (later.times, soon.times) == (0, 1)

    asyncio.run(run())
