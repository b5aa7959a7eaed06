"""The plans of one kind are listed without a look at the others."""

from __future__ import annotations

from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Change the tables."""
    op.create_index("liftwright_plans_newest_of_kind", "liftwright_plans", ["kind", "created_us", "id"])
