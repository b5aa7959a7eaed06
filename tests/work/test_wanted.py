"""Work that is done while somebody waits for it: whoever leaves is answered to no more, but what has begun is ended."""

from __future__ import annotations

import asyncio
import os
import threading
from typing import Any, cast

import pytest
from anyio import CapacityLimiter
from starlette.requests import ClientDisconnect, Request

from app.work.wanted import StillWanted, while_waited_for


class LeavingClient:
    """Stands for a request whose client leaves when it is told to."""

    def __init__(self) -> None:
        self.leaves = asyncio.Event()

    async def receive(self) -> dict[str, Any]:
        await self.leaves.wait()
        return {"type": "http.disconnect"}


def test_what_has_begun_keeps_its_pipe_and_its_place_to_its_end_and_what_waits_for_its_turn_is_never_begun() -> None:
    begun, go_on, seen = threading.Event(), threading.Event(), list[str]()

    def work(wanted: StillWanted) -> None:
        begun.set()
        assert go_on.wait(20)
        os.fstat(wanted.descriptor)
        seen.append("the pipe is still there")

    def second(_wanted: StillWanted) -> None:
        seen.append("begun behind somebody's back")

    async def run() -> None:
        limiter, client = CapacityLimiter(1), LeavingClient()
        request = cast(Request, client)
        working = asyncio.create_task(while_waited_for(request, work, limiter))
        assert await asyncio.to_thread(begun.wait, 20)
        waiting = asyncio.create_task(while_waited_for(request, second, limiter))
        await asyncio.sleep(0.05)
        client.leaves.set()
        with pytest.raises(ClientDisconnect):
            await waiting
        await asyncio.sleep(0.05)
        assert not working.done()
        assert limiter.borrowed_tokens == 1
        go_on.set()
        with pytest.raises(ClientDisconnect):
            await working
        assert limiter.borrowed_tokens == 0

    asyncio.run(run())
    assert seen == ["the pipe is still there"]
