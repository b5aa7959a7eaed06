"""A job's events as a stream of server-sent events that can be resumed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from starlette.concurrency import run_in_threadpool

from app.errors import PlanNotFound
from app.plan_desk import PlanDesk
from app.plan_feed import PlanFeed
from workers.stores.database_loss import DATABASE_GONE

PING_SECONDS = 15.0
"""A stream that has nothing to say says so this often, so that nothing in between cuts it [s]."""


async def stream_events(desk: PlanDesk, feed: PlanFeed, plan_id: str, received: int) -> AsyncIterator[bytes]:
    """Yield `progress` events from behind number `received`, then one `finished` event with the plan, and end.

    The number of the `finished` event follows that of the last `progress` event, so a client that resumes with it
    has everything. A plan that is deleted meanwhile ends the stream, and so does a database that is gone at the end:
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
        plan = await run_in_threadpool(desk.plan, plan_id)
    except (PlanNotFound, *DATABASE_GONE):
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
