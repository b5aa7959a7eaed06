"""Our own tables, beside the job engine's in the same database, so that one transaction can write both."""

from __future__ import annotations

import sqlalchemy as sa

METADATA = sa.MetaData()

PLANS = sa.Table(
    "liftwright_plans",
    METADATA,
    sa.Column("id", sa.String(64), primary_key=True),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("kind", sa.String(32), nullable=False),
    sa.Column("external_id", sa.String(128)),
    sa.Column("idempotency_key", sa.String(255), unique=True),
    sa.Column("fingerprint", sa.String(64), nullable=False),
    sa.Column("task", sa.Text, nullable=False),
    sa.Column("started_us", sa.BigInteger),
    sa.Column("finished_us", sa.BigInteger),
    sa.Column("attempts", sa.Integer, nullable=False, default=0),
    sa.Column("crashes", sa.Integer, nullable=False, default=0),
    sa.Column("stage", sa.String(64)),
    sa.Column("fraction", sa.Float, nullable=False, default=0.0),
    sa.Index("liftwright_plans_newest", "created_us", "id"),
)

EVENTS = sa.Table(
    "liftwright_plan_events",
    METADATA,
    sa.Column("plan_id", sa.String(64), primary_key=True),
    sa.Column("sequence", sa.Integer, primary_key=True),
    sa.Column("event", sa.Text, nullable=False),
)

DOCUMENTS = sa.Table(
    "liftwright_documents",
    METADATA,
    sa.Column("plan_id", sa.String(64), primary_key=True),
    sa.Column("outcome", sa.String(32), nullable=False),
    sa.Column("sha256", sa.String(64), nullable=False),
    sa.Column("gzip", sa.LargeBinary, nullable=False),
)

MESHES = sa.Table(
    "liftwright_meshes",
    METADATA,
    sa.Column("id", sa.String(64), primary_key=True),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("gzip", sa.LargeBinary, nullable=False),
)

SCENES = sa.Table(
    "liftwright_scenes",
    METADATA,
    sa.Column("id", sa.String(64), primary_key=True),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("gzip", sa.LargeBinary, nullable=False),
    sa.Column("preview", sa.LargeBinary, nullable=False),
)
