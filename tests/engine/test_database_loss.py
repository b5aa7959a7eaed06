"""Waiting for a database that is away."""

from __future__ import annotations

import asyncio

import pytest
from sqlalchemy import exc

from workers import database_loss
from workers.database_loss import once_it_is_there


def test_a_call_is_repeated_until_the_database_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database_loss, "FIRST_PAUSE_SECONDS", 0.0)
    losses = [exc.OperationalError("", {}, Exception()), exc.InterfaceError("", {}, Exception()), exc.TimeoutError()]

    def call(number: int) -> int:
        if losses:
            raise losses.pop()
        return number

    assert asyncio.run(once_it_is_there(call, 7)) == 7


def test_other_errors_are_not_waited_for() -> None:
    def call() -> None:
        raise exc.IntegrityError("", {}, Exception())

    with pytest.raises(exc.IntegrityError):
        asyncio.run(once_it_is_there(call))
