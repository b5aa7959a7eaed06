"""Waiting costs the database the same for one and for many."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

import pytest
from sqlalchemy.exc import OperationalError

from app.resources import plan_feed
from app.resources.plan_feed import PlanFeed, wait_for_end
from workers.engine.supervisor import Supervisor
from workers.stores.jobs import Job, JobState


class CountedDatabase:
    """Store and queue in one: a plan with some events, and how often it was asked for."""

    def __init__(self) -> None:
        self.events = [(number, {"n": number}) for number in (1, 2, 3)]
        self.state = JobState.RUNNING
        self.looks = 0
        self.gone = 0

    def jobs(self, plan_ids: Sequence[str]) -> dict[str, Job]:
        self.looks += 1
        if self.gone:
            self.gone -= 1
            raise OperationalError("select", {}, Exception("gone"))
        return {plan_id: Job(self.state, None, None) for plan_id in plan_ids if plan_id != "deleted"}

    def last_events(self, plan_ids: Sequence[str]) -> dict[str, int]:
        return {plan_id: self.events[-1][0] for plan_id in plan_ids}

    def events_after(self, _: str, sequence: int) -> list[tuple[int, dict[str, Any]]]:
        return [event for event in self.events if event[0] > sequence]


async def _followed(feed: PlanFeed, plan_id: str, received: int) -> list[int]:
    """Return the numbers of the events that come until the plan has ended."""
    seen: list[int] = []
    async with feed.follow(plan_id) as plan:
        while True:
            changed, done = plan.changed, plan.done
            seen += [number for number, _ in plan.behind(received)]
            received = max([received, *seen])
            if done:
                return seen
            await changed.wait()


def run_with(database: CountedDatabase, scenario: Any) -> Any:
    async def run() -> Any:
        feed = PlanFeed(database, database)  # pyright: ignore[reportArgumentType]
        supervisor = Supervisor()
        supervisor.repeat("feed", feed.look, plan_feed.POLL_SECONDS)
        try:
            async with asyncio.timeout(20):
                return await scenario(feed)
        finally:
            await supervisor.stop()

    return asyncio.run(run())


def test_many_followers_get_everything_and_are_no_more_looks_than_one() -> None:
    database = CountedDatabase()

    async def scenario(feed: PlanFeed) -> list[list[int]]:
        tasks = [asyncio.create_task(_followed(feed, f"plan-{n % 3}", n % 3)) for n in range(200)]
        await asyncio.sleep(3.5 * plan_feed.POLL_SECONDS)
        database.events.append((4, {"n": 4}))
        database.state = JobState.SUCCEEDED
        return await asyncio.gather(*tasks)

    for n, seen in enumerate(run_with(database, scenario)):
        assert seen == [number for number in (1, 2, 3, 4) if number > n % 3]
    assert database.looks <= 8


def test_nobody_waiting_is_no_look_at_all() -> None:
    database = CountedDatabase()
    run_with(database, lambda _: asyncio.sleep(3 * plan_feed.POLL_SECONDS))
    assert database.looks == 0


@pytest.mark.slow
def test_a_database_that_comes_back_is_asked_again() -> None:
    database = CountedDatabase()
    database.gone, database.state = 1, JobState.FAILED
    assert run_with(database, lambda feed: _followed(feed, "a", 0)) == [1, 2, 3]


def test_the_followers_of_a_plan_that_is_deleted_are_told_so() -> None:
    assert run_with(CountedDatabase(), lambda feed: _followed(feed, "deleted", 3)) == []


def test_waiting_ends_in_time_with_a_job_that_does_not() -> None:
    run_with(CountedDatabase(), lambda feed: wait_for_end(feed, "a", 0.05))
