"""Plans have what an MES says about their jobs; those of before have nothing of it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Change the tables."""
    plans = "liftwright_plans"
    op.add_column(plans, sa.Column("work_master", sa.String(128)))
    op.add_column(plans, sa.Column("priority", sa.Integer))
    op.add_column(plans, sa.Column("start_us", sa.BigInteger))
    op.add_column(plans, sa.Column("end_us", sa.BigInteger))
    op.create_index("liftwright_plans_work_master", plans, ["work_master", "created_us", "id"])
