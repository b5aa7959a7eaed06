"""Plans belong to whoever holds the key they were posted with, those of before to nobody; webhooks are told of them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Change the tables."""
    op.add_column("liftwright_plans", sa.Column("owner", sa.String(64)))
    op.create_index("liftwright_plans_newest_of_owner", "liftwright_plans", ["owner", "created_us", "id"])
    op.create_table(
        "liftwright_api_keys",
        sa.Column("id", sa.String(16), primary_key=True),
        sa.Column("owner", sa.String(64), nullable=False),
        sa.Column("scope", sa.String(16), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("created_us", sa.BigInteger, nullable=False),
        sa.Column("expires_us", sa.BigInteger),
        sa.Column("last_used_us", sa.BigInteger),
        sa.Column("revoked_us", sa.BigInteger),
    )
    op.create_table(
        "liftwright_sessions",
        sa.Column("digest", sa.String(64), primary_key=True),
        sa.Column("key_id", sa.String(16), nullable=False),
        sa.Column("expires_us", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "liftwright_audit",
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("at_us", sa.BigInteger, nullable=False),
        sa.Column("key_id", sa.String(16)),
        sa.Column("owner", sa.String(64)),
        sa.Column("address", sa.String(64)),
        sa.Column("action", sa.String(64), nullable=False),
        sa.Column("target", sa.String(300), nullable=False),
        sa.Column("status", sa.Integer, nullable=False),
    )
    op.create_table(
        "liftwright_webhooks",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("created_us", sa.BigInteger, nullable=False),
        sa.Column("owner", sa.String(64)),
        sa.Column("url", sa.String(2000), nullable=False),
        sa.Column("plans", sa.String(8), nullable=False),
        sa.Column("secret", sa.String(64), nullable=False),
        sa.Column("previous_secret", sa.String(64)),
        sa.Column("previous_until_us", sa.BigInteger),
        sa.Column("disabled_us", sa.BigInteger),
    )
    op.create_index("liftwright_webhooks_of_owner", "liftwright_webhooks", ["owner"])
    deliveries = "liftwright_webhook_deliveries"
    op.create_table(
        deliveries,
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("created_us", sa.BigInteger, nullable=False),
        sa.Column("webhook_id", sa.String(32), nullable=False),
        sa.Column("plan_id", sa.String(64), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("body", sa.Text),
    )
    op.create_index("liftwright_webhook_deliveries_newest", deliveries, ["webhook_id", "created_us", "id"])
    op.create_index("liftwright_webhook_deliveries_by_state", deliveries, ["state"])
    op.create_table(
        "liftwright_webhook_attempts",
        sa.Column("delivery_id", sa.String(32), primary_key=True),
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("at_us", sa.BigInteger, nullable=False),
        sa.Column("status", sa.Integer),
        sa.Column("failure", sa.String(300)),
    )
