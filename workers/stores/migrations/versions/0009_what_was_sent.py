"""A repeat is known by what was sent; of plans of before only what it was taken for is known."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    """Change the tables."""
    op.add_column("liftwright_plans", sa.Column("sent_fingerprint", sa.String(64)))
