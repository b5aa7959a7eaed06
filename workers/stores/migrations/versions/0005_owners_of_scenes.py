"""Scenes belong to whoever posted them, are listed and deleted, and stay while a plan names them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Change the tables."""
    plans, scenes = "liftwright_plans", "liftwright_scenes"
    op.add_column(scenes, sa.Column("owner", sa.String(64)))
    op.add_column(scenes, sa.Column("posted_us", sa.BigInteger))
    op.add_column(scenes, sa.Column("points", sa.LargeBinary))
    op.create_index("liftwright_scenes_newest", scenes, ["created_us", "id"])
    op.create_index("liftwright_scenes_newest_of_owner", scenes, ["owner", "created_us", "id"])
    op.add_column(plans, sa.Column("scene_id", sa.String(64)))
    op.create_index("liftwright_plans_of_scene", plans, ["scene_id"])
