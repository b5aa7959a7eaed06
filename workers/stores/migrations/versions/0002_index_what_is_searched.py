"""Plans are found by the name that the caller gave them, documents counted without reading them, totals kept."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Change the tables."""
    plans, documents = "liftwright_plans", "liftwright_documents"
    op.create_index("liftwright_plans_external_id", plans, ["external_id", "created_us"], if_not_exists=True)
    op.create_index("liftwright_documents_outcome", documents, ["outcome"], if_not_exists=True)
    op.create_table(
        "liftwright_totals",
        sa.Column("name", sa.String(64), primary_key=True),
        sa.Column("label", sa.String(64), primary_key=True),
        sa.Column("count", sa.BigInteger, nullable=False),
        sa.Column("seconds", sa.Float, nullable=False),
        if_not_exists=True,
    )
