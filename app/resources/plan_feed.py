"""News of plans for everybody who waits for some, and a job's events as a stream that can be resumed."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from app.errors import PlanNotFound, StudyNotFound
from workers.stores.database_loss import DATABASE_GONE
from workers.stores.jobs import Job

POLL_SECONDS = 0.1
"""How often the database is looked at while somebody waits [s]."""

Event = tuple[int, dict[str, Any]]
SentEvent = tuple[int, bytes]
"""An event as it goes over the wire: made once, however many follow."""
PING_SECONDS = 15.0
"""A stream that has nothing to say says so this often, so that nothing in between cuts it [s]."""


@dataclass(eq=False)
class FollowedPlan:
    """What is known of one plan while somebody follows it."""

    events: list[SentEvent] = field(default_factory=list)
    """All since the first one."""
    done: bool = False
    """Whether it will never change again, or is gone; then `events` are complete."""
    followers: int = 0
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    def behind(self, received: int) -> list[SentEvent]:
        """Return the events behind number `received`."""
        # They are numbered from 1 without gaps.
        return self.events[received:]

    def tell(self) -> None:
        """Wake everybody who waits for a change."""
        self.changed.set()
        self.changed = asyncio.Event()


class KeptEvents(Protocol):
    """Where events are kept: of plans their progress, of studies their points."""

    def last_events(self, plan_ids: Sequence[str], /) -> dict[str, int]:
        """Return the number of the newest event of each; one without events is left out."""
        ...

    def events_after(self, plan_id: str, sequence: int, /) -> list[Event]:
        """Return the events behind `sequence`, oldest first."""
        ...


class KnownJobs(Protocol):
    """Who knows how jobs stand."""

    def jobs(self, plan_ids: Sequence[str], /) -> dict[str, Job]:
        """Return the jobs of some ids; one that does not exist is left out."""
        ...


class PlanFeed:
    """Looks for news of the plans, or studies, that somebody follows. Belongs to one event loop."""

    def __init__(self, store: KeptEvents, queue: KnownJobs, event: str = "progress") -> None:
        """`event` is the name of what is sent."""
        self._store, self._queue, self._event = store, queue, event
        self._plans: dict[str, FollowedPlan] = {}
        self._wanted = asyncio.Event()

    @asynccontextmanager
    async def follow(self, plan_id: str) -> AsyncIterator[FollowedPlan]:
        """Follow a plan for as long as the context is open. At first nothing is known of it."""
        plan = self._plans.setdefault(plan_id, FollowedPlan())
        plan.followers += 1
        self._wanted.set()
        try:
            yield plan
        finally:
            plan.followers -= 1
            if plan.followers == 0:
                del self._plans[plan_id]

    async def look(self) -> None:
        """Wait until somebody follows a plan, and look for news once."""
        while not self._plans:
            self._wanted.clear()
            await self._wanted.wait()
        known = {plan_id: plan.events[-1][0] if plan.events else 0 for plan_id, plan in self._plans.items()}
        ended, news = await run_in_threadpool(self._read, known)
        for plan_id in known:
            plan = self._plans.get(plan_id)
            if plan is None or plan.done or not (plan_id in ended or plan_id in news):
                continue
            # Somebody may have left and come back meanwhile: then there are more events than the plan knows of.
            last = plan.events[-1][0] if plan.events else 0
            if last != known[plan_id]:
                continue
            plan.events += [self._as_sent(*event) for event in news.get(plan_id, [])]
            plan.done = plan_id in ended
            plan.tell()

    def _read(self, known: dict[str, int]) -> tuple[set[str], dict[str, list[Event]]]:
        """Return which plans have ended, and the events behind those that are known."""
        # The states before the events: the events of a plan that has ended are complete.
        jobs = self._queue.jobs(list(known))
        ended = {plan_id for plan_id in known if plan_id not in jobs or jobs[plan_id].state.done}
        newest = self._store.last_events(list(known))
        behind = [plan_id for plan_id, sequence in newest.items() if sequence > known[plan_id]]
        return ended, {plan_id: self._store.events_after(plan_id, known[plan_id]) for plan_id in behind}

    def _as_sent(self, number: int, event: dict[str, Any]) -> SentEvent:
        # Those of another kind say so themselves.
        told = {name: value for name, value in event.items() if name != "event"}
        kind = event.get("event", self._event)
        return number, format_sse_event(data_str=json.dumps(told), event=kind, id=str(number))


async def stream_events(
    feed: PlanFeed, plan_id: str, received: int, resource: Callable[[str], BaseModel]
) -> AsyncIterator[bytes]:
    """Yield events from behind number `received`, then one `finished` event with the plan or study, and end.

    The number of the `finished` event follows that of the last event before, so a client that resumes with it has
    everything. A plan that is deleted meanwhile ends the stream, and so does a database that is gone at the end:
    the client comes again, and resumes.
    """
    async with feed.follow(plan_id) as followed:
        while True:
            changed = followed.changed
            done = followed.done
            if news := followed.behind(received):
                # In one piece: a stream that is resumed begins with all there was.
                yield b"".join(event for _, event in news)
                received = news[-1][0]
            if done:
                break
            try:
                async with asyncio.timeout(PING_SECONDS):
                    await changed.wait()
            except TimeoutError:
                yield KEEPALIVE_COMMENT
    try:
        plan = await run_in_threadpool(resource, plan_id)
    except (PlanNotFound, StudyNotFound, *DATABASE_GONE):
        return
    yield format_sse_event(data_str=plan.model_dump_json(), event="finished", id=str(received + 1))


async def wait_for_end(feed: PlanFeed, plan_id: str, seconds: float) -> None:
    """Return when a plan's job has ended, or after some time [s]."""
    try:
        async with asyncio.timeout(seconds), feed.follow(plan_id) as followed:
            while not followed.done:
                await followed.changed.wait()
    except TimeoutError:
        return
