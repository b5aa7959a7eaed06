"""Cells of one's own are kept, and it is known which plans are in them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"


def upgrade() -> None:
    """Change the tables."""
    op.create_table(
        "liftwright_cells",
        sa.Column("id", sa.String(64), primary_key=True),
        sa.Column("created_us", sa.BigInteger, nullable=False),
        sa.Column("owner", sa.String(64)),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("hash", sa.String(64), nullable=False),
        sa.Column("figures", sa.Text, nullable=False),
        sa.Column("zip", sa.LargeBinary, nullable=False),
        sa.Column("deleted_us", sa.BigInteger),
        sa.UniqueConstraint("owner", "name", "version"),
    )
    op.create_index("liftwright_cells_by_name", "liftwright_cells", ["name", "version"])
    op.add_column("liftwright_plans", sa.Column("cell", sa.String(64)))
    op.create_index("liftwright_plans_in_cell", "liftwright_plans", ["cell"])
