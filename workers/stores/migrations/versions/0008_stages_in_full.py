"""A stage has the name of an object in it, and with that any length; SQLite never minded."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Change the tables."""
    if op.get_context().dialect.name == "postgresql":
        op.alter_column("liftwright_plans", "stage", type_=sa.Text())
