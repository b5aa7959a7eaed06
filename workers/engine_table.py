"""The job engine's table of workflows, as far as we read and repair it ourselves.

The engine's own calls fetch whole rows where a count is wanted, and hand over the jobs of a dead worker only with a
service that is sold separately.
"""

from __future__ import annotations

import sqlalchemy as sa

POSTGRES_SCHEMA = "dbos"
ENQUEUED = "ENQUEUED"
DELAYED = "DELAYED"
"""Until the start of its order."""
QUEUED = (ENQUEUED, DELAYED)
RUNNING = "PENDING"
FAILED = "ERROR"
GIVEN_UP = "MAX_RECOVERY_ATTEMPTS_EXCEEDED"


def workflow_table(dialect: str) -> sa.TableClause:
    """Return the table as it is named on `sqlite` or `postgresql`."""
    return sa.table(
        "workflow_status",
        sa.column("workflow_uuid", sa.Text),
        sa.column("status", sa.Text),
        sa.column("queue_name", sa.Text),
        sa.column("executor_id", sa.Text),
        sa.column("owner_xid", sa.Text),
        sa.column("started_at_epoch_ms", sa.BigInteger),
        sa.column("updated_at", sa.BigInteger),
        sa.column("completed_at", sa.BigInteger),
        schema=POSTGRES_SCHEMA if dialect == "postgresql" else None,
    )
