"""Messages about a plan are found by it, when it is deleted."""

from __future__ import annotations

from alembic import op

revision = "0014"
down_revision = "0013"


def upgrade() -> None:
    """Change the tables."""
    op.create_index("liftwright_webhook_deliveries_of_plan", "liftwright_webhook_deliveries", ["plan_id"])
