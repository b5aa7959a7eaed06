"""A database that is gone for a while: jobs wait for it, requests are told."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import sqlalchemy as sa
import structlog
from sqlalchemy import event, exc

FIRST_PAUSE_SECONDS = 0.2
LONGEST_PAUSE_SECONDS = 5.0
DATABASE_GONE = (exc.OperationalError, exc.InterfaceError, exc.TimeoutError)
"""What the database layer raises if the server is away, has no connection to spare, has no room on its disk, or takes
no writes or has ended the session (`tell_refusal_as_loss`)."""
READ_ONLY = "25006"
"""SQLSTATE of a write that a server refuses which is no primary, or is none any more after a failover."""
SILENT_TOO_LONG = "25P03"
"""SQLSTATE of a session that the server has ended because it was silent within a transaction for too long."""

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
log = structlog.get_logger(__name__)


def said_by(error: exc.SQLAlchemyError) -> str:
    """Return what the database said, without the statement that it was asked: for the log."""
    return str(error.args[0] if error.args else error)


def tell_refusal_as_loss() -> None:
    """Have a server that takes no writes, or has ended our session, count as one that is away.

    Its connections are closed, and made anew. After a failover a name leads to another server, while connections to the
    one before may live on; and a process that was frozen in a transaction finds its session ended.
    """
    # On the class: the job engine makes database engines of its own, and waits for lost connections as we do.
    event.listen(sa.Engine, "handle_error", _lose)


def _lose(context: sa.engine.ExceptionContext) -> exc.OperationalError | None:
    if getattr(context.original_exception, "sqlstate", None) not in {READ_ONLY, SILENT_TOO_LONG}:
        return None
    context.is_disconnect = True
    original = context.original_exception
    return exc.OperationalError(context.statement, context.parameters, original, connection_invalidated=True)


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
            log.warning("waiting for the database", seconds=pause, error=said_by(error))
        await asyncio.sleep(pause)
        pause = min(2.0 * pause, LONGEST_PAUSE_SECONDS)
