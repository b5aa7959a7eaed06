"""The first tables: plans with their events and documents, and uploaded meshes."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Change the tables."""
    # Databases of the first software have them, and tell no version.
    op.create_table(
        "liftwright_plans",
        sa.Column("id", sa.String(64), primary_key=True),
        sa.Column("created_us", sa.BigInteger, nullable=False),
        sa.Column("kind", sa.String(32), nullable=False),
        sa.Column("external_id", sa.String(128)),
        sa.Column("idempotency_key", sa.String(255), unique=True),
        sa.Column("fingerprint", sa.String(64), nullable=False),
        sa.Column("task", sa.Text, nullable=False),
        sa.Column("started_us", sa.BigInteger),
        sa.Column("finished_us", sa.BigInteger),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("crashes", sa.Integer, nullable=False),
        sa.Column("stage", sa.String(64).with_variant(sa.Text(), "sqlite")),
        sa.Column("fraction", sa.Float, nullable=False),
        if_not_exists=True,
    )
    op.create_index("liftwright_plans_newest", "liftwright_plans", ["created_us", "id"], if_not_exists=True)
    op.create_table(
        "liftwright_plan_events",
        sa.Column("plan_id", sa.String(64), primary_key=True),
        sa.Column("sequence", sa.Integer, primary_key=True),
        sa.Column("event", sa.Text, nullable=False),
        if_not_exists=True,
    )
    op.create_table(
        "liftwright_documents",
        sa.Column("plan_id", sa.String(64), primary_key=True),
        sa.Column("outcome", sa.String(32), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("gzip", sa.LargeBinary, nullable=False),
        if_not_exists=True,
    )
    op.create_table(
        "liftwright_meshes",
        sa.Column("id", sa.String(64), primary_key=True),
        sa.Column("created_us", sa.BigInteger, nullable=False),
        sa.Column("gzip", sa.LargeBinary, nullable=False),
        if_not_exists=True,
    )
