"""How a plan fared in physics is known without its document."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"


def upgrade() -> None:
    """Change the tables."""
    # What the version before writes has none, as what it has stored.
    op.add_column("liftwright_documents", sa.Column("physics", sa.String(32)))
    op.create_index("liftwright_documents_physics", "liftwright_documents", ["physics"])
