"""Studies and their points are kept."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    """Change the tables."""
    op.create_table(
        "liftwright_studies",
        sa.Column("id", sa.String(64), primary_key=True),
        sa.Column("created_us", sa.BigInteger, nullable=False),
        sa.Column("kind", sa.String(32), nullable=False),
        sa.Column("external_id", sa.String(128)),
        sa.Column("owner", sa.String(64)),
        sa.Column("idempotency_key", sa.String(255), unique=True),
        sa.Column("sent_fingerprint", sa.String(64), nullable=False),
        sa.Column("study", sa.Text, nullable=False),
        sa.Column("count", sa.Integer, nullable=False),
        sa.Column("parts", sa.Integer, nullable=False),
        sa.Column("started_us", sa.BigInteger),
        sa.Column("finished_us", sa.BigInteger),
        sa.Column("best_plan_id", sa.String(64)),
    )
    op.create_index("liftwright_studies_newest", "liftwright_studies", ["created_us", "id"])
    op.create_index("liftwright_studies_newest_of_owner", "liftwright_studies", ["owner", "created_us", "id"])
    op.create_table(
        "liftwright_study_points",
        sa.Column("study_id", sa.String(64), primary_key=True),
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("sequence", sa.Integer, nullable=False),
        sa.Column("outcome", sa.String(32), nullable=False),
        sa.Column("point", sa.Text, nullable=False),
        sa.UniqueConstraint("study_id", "sequence"),
    )
