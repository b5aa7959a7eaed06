"""A document is kept before its plan is simulated, and webhooks may be told of it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"


def upgrade() -> None:
    """Change the tables."""
    op.add_column("liftwright_documents", sa.Column("certified_us", sa.BigInteger))
    # The version before writes neither of them: what it stores is final, and its webhooks are told of ends alone.
    awaits = sa.Column("awaits_simulation", sa.Boolean, nullable=False, server_default=sa.false())
    op.add_column("liftwright_documents", awaits)
    op.add_column("liftwright_webhooks", sa.Column("certified", sa.Boolean, nullable=False, server_default=sa.false()))
