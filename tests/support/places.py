"""The databases that a test runs on, one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from .postgres import needs_postgres, running_postgres
from .samples import sample

PLACES = ("sqlite", pytest.param("postgres", marks=needs_postgres))
on_both_databases = pytest.mark.parametrize("place", PLACES, indirect=True, scope="module")
on_one_or_both_databases = pytest.mark.parametrize("place", sample(PLACES[:1], PLACES), indirect=True, scope="module")
"""The second one where everything is tried: for what is said of the interface, whose stores have tests on both."""


@contextmanager
def database_at(place: str) -> Iterator[dict[str, str]]:
    """Have such a database for the time of a test, and yield the settings that lead to it."""
    if place == "sqlite":
        yield {}
        return
    with running_postgres() as server:
        yield {"database_url": server.url}
