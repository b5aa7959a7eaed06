"""A database that is gone for a while: jobs wait for it, requests are told."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import structlog
from sqlalchemy import exc

FIRST_PAUSE_SECONDS = 0.2
LONGEST_PAUSE_SECONDS = 5.0
DATABASE_GONE = (exc.OperationalError, exc.InterfaceError, exc.TimeoutError)
"""What the database layer raises if the server is away, has no connection to spare, or has no room on its disk."""

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
log = structlog.get_logger(__name__)


async def once_it_is_there(
    call: Callable[Arguments, Result], *arguments: Arguments.args, **named: Arguments.kwargs
) -> Result:
    """Return what a blocking call returns, however long the database is away.

    It may happen twice: if the connection breaks while the answer is on its way, nobody knows whether it was done.
    """
    pause = FIRST_PAUSE_SECONDS
    while True:
        try:
            return await asyncio.to_thread(call, *arguments, **named)
        except DATABASE_GONE as error:
            log.warning("waiting for the database", seconds=pause, error=str(error.args[0] if error.args else error))
        await asyncio.sleep(pause)
        pause = min(2.0 * pause, LONGEST_PAUSE_SECONDS)
