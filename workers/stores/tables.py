"""Our own tables, beside the job engine's in the same database, so that one transaction can write both."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, TypedDict

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql

NUL = "\0"
REPLACEMENT = "\N{REPLACEMENT CHARACTER}"
METADATA = sa.MetaData()
Position = tuple[int, str]
"""(created_us, id) of the last item of a page: the next one begins behind it."""


class StoredText(sa.TypeDecorator[str]):
    """A column of text of at most so many characters: what one database takes, every one does.

    PostgreSQL knows no NUL and refuses whatever has one, also where it is only looked for. Such text is stored, and
    looked for, with U+FFFD in its place: an id that cannot exist is not found, and what somebody asked for is told.
    """

    impl = sa.String
    cache_ok = True

    def process_bind_param(self, value: str | None, dialect: sa.Dialect) -> str | None:
        """Return what is stored in place of `value`."""
        return stored_text(value)


def stored_text(value: str | None) -> str | None:
    """Return what is stored in place of `value`."""
    return None if value is None else value.replace(NUL, REPLACEMENT)


def now_us() -> int:
    """Return the time as our tables have it, in microseconds since 1970, UTC."""
    return time.time_ns() // 1000


def newest_first(query: sa.Select[Any], table: sa.Table, most: int, before: Position | None) -> sa.Select[Any]:
    """Return a query of at most `most` rows of a table, newest first, from behind the row at `before`."""
    query = query.order_by(table.c.created_us.desc(), table.c.id.desc()).limit(most)
    if before is None:
        return query
    return query.where(sa.tuple_(table.c.created_us, table.c.id) < sa.tuple_(*map(sa.literal, before)))


def created_before(table: sa.Table, time_us: int, after: Position, most: int) -> sa.Select[Any, Any]:
    """Return a query of places of at most `most` rows of a table made before a time, oldest first, behind `after`."""
    key = table.c.created_us, table.c.id
    older = sa.select(*key).where(table.c.created_us < time_us, sa.tuple_(*key) > sa.tuple_(*map(sa.literal, after)))
    return older.order_by(*key).limit(most)


PLANS = sa.Table(
    "liftwright_plans",
    METADATA,
    sa.Column("id", StoredText(64), primary_key=True),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("kind", StoredText(32), nullable=False),
    sa.Column("external_id", StoredText(128)),
    sa.Column("owner", StoredText(64)),
    sa.Column("idempotency_key", StoredText(255), unique=True),
    sa.Column("fingerprint", StoredText(64), nullable=False),
    sa.Column("sent_fingerprint", StoredText(64)),
    sa.Column("task", sa.Text, nullable=False),
    sa.Column("started_us", sa.BigInteger),
    sa.Column("finished_us", sa.BigInteger),
    sa.Column("attempts", sa.Integer, nullable=False, default=0),
    sa.Column("crashes", sa.Integer, nullable=False, default=0),
    sa.Column("stage", sa.Text),
    sa.Column("fraction", sa.Float, nullable=False, default=0.0),
    sa.Column("scene_id", StoredText(64)),
    sa.Column("work_master", StoredText(128)),
    sa.Column("priority", sa.Integer),
    sa.Column("start_us", sa.BigInteger),
    sa.Column("end_us", sa.BigInteger),
    sa.Column("cell", StoredText(64)),
    sa.Column("study_id", StoredText(64)),
    sa.Index("liftwright_plans_newest", "created_us", "id"),
    sa.Index("liftwright_plans_newest_of_owner", "owner", "created_us", "id"),
    sa.Index("liftwright_plans_newest_of_kind", "kind", "created_us", "id"),
    sa.Index("liftwright_plans_work_master", "work_master", "created_us", "id"),
    sa.Index("liftwright_plans_external_id", "external_id", "created_us"),
    sa.Index("liftwright_plans_of_scene", "scene_id"),
    sa.Index("liftwright_plans_in_cell", "cell"),
    sa.Index("liftwright_plans_of_study", "study_id"),
)

EVENTS = sa.Table(
    "liftwright_plan_events",
    METADATA,
    sa.Column("plan_id", StoredText(64), primary_key=True),
    sa.Column("sequence", sa.Integer, primary_key=True),
    sa.Column("event", sa.Text, nullable=False),
)

DOCUMENTS = sa.Table(
    "liftwright_documents",
    METADATA,
    sa.Column("plan_id", StoredText(64), primary_key=True),
    sa.Column("outcome", StoredText(32), nullable=False),
    sa.Column("sha256", StoredText(64), nullable=False),
    sa.Column("gzip", sa.LargeBinary, nullable=False),
    sa.Column("certified_us", sa.BigInteger),
    sa.Column("awaits_simulation", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.Column("physics", StoredText(32)),
    sa.Index("liftwright_documents_outcome", "outcome"),
    sa.Index("liftwright_documents_physics", "physics"),
)

MESHES = sa.Table(
    "liftwright_meshes",
    METADATA,
    sa.Column("id", StoredText(64), primary_key=True),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("gzip", sa.LargeBinary, nullable=False),
)

CELLS = sa.Table(
    "liftwright_cells",
    METADATA,
    sa.Column("id", StoredText(64), primary_key=True),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("owner", StoredText(64)),
    sa.Column("name", StoredText(64), nullable=False),
    sa.Column("version", sa.Integer, nullable=False),
    sa.Column("hash", StoredText(64), nullable=False),
    sa.Column("figures", sa.Text, nullable=False),
    sa.Column("zip", sa.LargeBinary, nullable=False),
    sa.Column("deleted_us", sa.BigInteger),
    sa.UniqueConstraint("owner", "name", "version"),
    sa.Index("liftwright_cells_by_name", "name", "version"),
)

SCENES = sa.Table(
    "liftwright_scenes",
    METADATA,
    sa.Column("id", StoredText(64), primary_key=True),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("gzip", sa.LargeBinary, nullable=False),
    sa.Column("preview", sa.LargeBinary, nullable=False),
    sa.Column("owner", StoredText(64)),
    sa.Column("posted_us", sa.BigInteger),
    sa.Column("points", sa.LargeBinary),
    sa.Index("liftwright_scenes_newest", "created_us", "id"),
    sa.Index("liftwright_scenes_newest_of_owner", "owner", "created_us", "id"),
)

STUDIES = sa.Table(
    "liftwright_studies",
    METADATA,
    sa.Column("id", StoredText(64), primary_key=True),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("kind", StoredText(32), nullable=False),
    sa.Column("external_id", StoredText(128)),
    sa.Column("owner", StoredText(64)),
    sa.Column("idempotency_key", StoredText(255), unique=True),
    sa.Column("sent_fingerprint", StoredText(64), nullable=False),
    sa.Column("study", sa.Text, nullable=False),
    sa.Column("count", sa.Integer, nullable=False),
    sa.Column("parts", sa.Integer, nullable=False),
    sa.Column("started_us", sa.BigInteger),
    sa.Column("finished_us", sa.BigInteger),
    sa.Column("best_plan_id", StoredText(64)),
    sa.Index("liftwright_studies_newest", "created_us", "id"),
    sa.Index("liftwright_studies_newest_of_owner", "owner", "created_us", "id"),
)

STUDY_POINTS = sa.Table(
    "liftwright_study_points",
    METADATA,
    sa.Column("study_id", StoredText(64), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("sequence", sa.Integer, nullable=False),
    sa.Column("outcome", StoredText(32), nullable=False),
    sa.Column("point", sa.Text, nullable=False),
    sa.UniqueConstraint("study_id", "sequence"),
)

API_KEYS = sa.Table(
    "liftwright_api_keys",
    METADATA,
    sa.Column("id", StoredText(16), primary_key=True),
    sa.Column("owner", StoredText(64), nullable=False),
    sa.Column("scope", StoredText(16), nullable=False),
    sa.Column("digest", StoredText(64), nullable=False),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("expires_us", sa.BigInteger),
    sa.Column("last_used_us", sa.BigInteger),
    sa.Column("revoked_us", sa.BigInteger),
)

SESSIONS = sa.Table(
    "liftwright_sessions",
    METADATA,
    sa.Column("digest", StoredText(64), primary_key=True),
    sa.Column("key_id", StoredText(16), nullable=False),
    sa.Column("expires_us", sa.BigInteger, nullable=False),
)

AUDIT = sa.Table(
    "liftwright_audit",
    METADATA,
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=True),
    sa.Column("at_us", sa.BigInteger, nullable=False),
    sa.Column("key_id", StoredText(16)),
    sa.Column("owner", StoredText(64)),
    sa.Column("address", StoredText(64)),
    sa.Column("action", StoredText(64), nullable=False),
    sa.Column("target", StoredText(300), nullable=False),
    sa.Column("status", sa.Integer, nullable=False),
)


def insert_rows(transaction: sa.Connection, table: sa.TableClause, rows: Sequence[Mapping[str, Any]]) -> None:
    """Insert rows, at least one, each of which names the same columns; on PostgreSQL in one statement.

    Its text is the same for any number of rows, so that it is compiled and planned once.
    """
    if transaction.dialect.name != "postgresql":
        transaction.execute(sa.insert(table), rows)
        return
    names = tuple(rows[0])
    transaction.execute(_insert_of_arrays(table, names), {name: [row[name] for row in rows] for name in names})


@cache
def _insert_of_arrays(table: sa.TableClause, names: tuple[str, ...]) -> sa.Insert:
    """Return what inserts rows on PostgreSQL, given the values of each column as an array."""
    arrays = [sa.func.unnest(sa.bindparam(name, type_=postgresql.ARRAY(table.c[name].type))) for name in names]
    return sa.insert(table).from_select(names, sa.select(*arrays))


class AuditRow(TypedDict):
    """A row of `AUDIT` before it has its number."""

    at_us: int
    key_id: str | None
    owner: str | None
    address: str | None
    action: str
    target: str
    status: int


WEBHOOKS = sa.Table(
    "liftwright_webhooks",
    METADATA,
    sa.Column("id", StoredText(32), primary_key=True),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("owner", StoredText(64)),
    sa.Column("url", StoredText(2000), nullable=False),
    sa.Column("plans", StoredText(8), nullable=False),
    sa.Column("secret", StoredText(64), nullable=False),
    sa.Column("previous_secret", StoredText(64)),
    sa.Column("previous_until_us", sa.BigInteger),
    sa.Column("disabled_us", sa.BigInteger),
    sa.Column("certified", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.Index("liftwright_webhooks_of_owner", "owner"),
)

DELIVERIES = sa.Table(
    "liftwright_webhook_deliveries",
    METADATA,
    sa.Column("id", StoredText(32), primary_key=True),
    sa.Column("created_us", sa.BigInteger, nullable=False),
    sa.Column("webhook_id", StoredText(32), nullable=False),
    sa.Column("plan_id", StoredText(64), nullable=False),
    sa.Column("state", StoredText(16), nullable=False),
    sa.Column("body", sa.Text),
    sa.Index("liftwright_webhook_deliveries_newest", "webhook_id", "created_us", "id"),
    sa.Index("liftwright_webhook_deliveries_by_state", "state"),
    sa.Index("liftwright_webhook_deliveries_of_plan", "plan_id"),
)

DELIVERY_ATTEMPTS = sa.Table(
    "liftwright_webhook_attempts",
    METADATA,
    sa.Column("delivery_id", StoredText(32), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("at_us", sa.BigInteger, nullable=False),
    sa.Column("status", sa.Integer),
    sa.Column("failure", StoredText(300)),
)

TOTALS = sa.Table(
    "liftwright_totals",
    METADATA,
    sa.Column("name", StoredText(64), primary_key=True),
    sa.Column("label", StoredText(64), primary_key=True),
    sa.Column("count", sa.BigInteger, nullable=False),
    sa.Column("seconds", sa.Float, nullable=False),
)
