"""A job's events as a stream of server-sent events that can be resumed."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncIterator

import anyio
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from starlette.concurrency import run_in_threadpool

from app.errors import PlanNotFound
from app.plan_desk import PlanDesk

POLL_SECONDS = 0.1
"""How often a stream looks for new events [s]."""
PING_SECONDS = 15.0
"""A stream that has nothing to say says so this often, so that nothing in between cuts it [s]."""


async def stream_events(desk: PlanDesk, plan_id: str, received: int) -> AsyncIterator[bytes]:
    """Yield `progress` events from behind number `received`, then one `finished` event with the plan, and end.

    The number of the `finished` event follows that of the last `progress` event, so a client that resumes with it
    has everything. A plan that is deleted meanwhile ends the stream.
    """
    quiet_since = time.monotonic()
    while True:
        try:
            # The state before the events: whatever is added in between comes with the next look.
            plan = await run_in_threadpool(desk.plan, plan_id)
        except PlanNotFound:
            return
        for sequence, event in await run_in_threadpool(desk.store.events_after, plan_id, received):
            yield format_sse_event(data_str=json.dumps(event), event="progress", id=str(sequence))
            received, quiet_since = sequence, time.monotonic()
        if plan.done:
            yield format_sse_event(data_str=plan.model_dump_json(), event="finished", id=str(received + 1))
            return
        if time.monotonic() - quiet_since > PING_SECONDS:
            yield KEEPALIVE_COMMENT
            quiet_since = time.monotonic()
        await anyio.sleep(POLL_SECONDS)
