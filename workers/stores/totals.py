"""Counts that only grow, of all workers together: what a monitoring system makes rates of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from workers.stores.tables import TOTALS

DOCUMENT = "document"
"""One for each document, by outcome."""
STAGE = "stage"
"""One for each stage that led to a document, of each object for itself, with its seconds."""
SOLVER_DEATH = "solver_death"
"""One for each solver process that ended without an answer."""
FAILURE = "failure"
"""One for each job that failed, by why."""
STUDY_POINT = "study_point"
"""One for each point of a study that was examined, by outcome, with its seconds."""
TAKEOVER = "takeover"
"""One for each job that was put back into the queue because its worker had died or lost it."""


@dataclass(frozen=True)
class Total:
    """How often something has happened, and how long it took altogether [s]."""

    name: str
    label: str
    count: int
    seconds: float


def add_to_total(
    transaction: sa.Connection, name: str, label: str = "", *, count: int = 1, seconds: float = 0.0
) -> None:
    """Count something."""
    insert = (postgresql.insert if transaction.dialect.name == "postgresql" else sqlite.insert)(TOTALS)
    row = insert.values(name=name, label=label, count=count, seconds=seconds)
    grown = {"count": TOTALS.c.count + row.excluded.count, "seconds": TOTALS.c.seconds + row.excluded.seconds}
    transaction.execute(row.on_conflict_do_update(index_elements=[TOTALS.c.name, TOTALS.c.label], set_=grown))


def count_document(transaction: sa.Connection, outcome: str, stages: Iterable[tuple[str, float]]) -> None:
    """Count a document and the stages that led to it, each with its seconds."""
    add_to_total(transaction, DOCUMENT, outcome)
    # In one order everywhere, so that two workers never wait for each other.
    for stage, those in groupby(sorted(stages), key=itemgetter(0)):
        seconds = [each for _, each in those]
        add_to_total(transaction, STAGE, stage, count=len(seconds), seconds=sum(seconds))
