"""Which plans somebody asks for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import sqlalchemy as sa

from workers.engine_table import workflow_table
from workers.job_state import STATE_OF_STATUS, JobState
from workers.tables import DOCUMENTS, PLANS


@dataclass(frozen=True)
class PlanFilter:
    """What a plan must be to be listed; None: anything."""

    owner: str | None = None
    kind: str | None = None
    external_id: str | None = None
    work_master: str | None = None
    state: JobState | None = None
    outcome: str | None = None
    """Of a job that has succeeded."""

    def conditions(self, dialect: str) -> Iterator[sa.ColumnElement[bool]]:
        """Yield what must hold in a query of plans joined with their documents, on `sqlite` or `postgresql`."""
        wishes = {
            PLANS.c.owner: self.owner,
            PLANS.c.kind: self.kind,
            PLANS.c.external_id: self.external_id,
            PLANS.c.work_master: self.work_master,
            DOCUMENTS.c.outcome: self.outcome,
        }
        yield from (column == wanted for column, wanted in wishes.items() if wanted is not None)
        state = JobState.SUCCEEDED if self.outcome is not None and self.state is None else self.state
        if state is not None:
            jobs = workflow_table(dialect)
            statuses = [status for status, meant in STATE_OF_STATUS.items() if meant is state]
            job = sa.select(jobs.c.workflow_uuid).where(jobs.c.workflow_uuid == PLANS.c.id)
            yield job.where(jobs.c.status.in_(statuses)).exists()
