"""Of a plan it is known of which study it plans a point."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"


def upgrade() -> None:
    """Change the tables."""
    op.add_column("liftwright_plans", sa.Column("study_id", sa.String(64)))
    op.create_index("liftwright_plans_of_study", "liftwright_plans", ["study_id"])
    # Of what was planned before, studies know the plan of their best point; owners' keys of the others are hashed.
    plans = sa.table("liftwright_plans", sa.column("id"), sa.column("study_id"))
    studies = sa.table("liftwright_studies", sa.column("id"), sa.column("best_plan_id"))
    known = sa.select(studies.c.id).where(studies.c.best_plan_id == plans.c.id).limit(1).scalar_subquery()
    best = sa.select(studies.c.best_plan_id).where(studies.c.best_plan_id.is_not(None))
    op.execute(sa.update(plans).where(plans.c.id.in_(best)).values(study_id=known))
