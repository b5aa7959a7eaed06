"""Our tables as the first version had them, for tests of upgrades."""

from __future__ import annotations

import sqlalchemy as sa

from workers.stores.migrations import REVISION_TABLE, VERSION_TABLE

NEWER = (
    f"DROP TABLE {REVISION_TABLE}",
    "DROP INDEX liftwright_plans_external_id",
    "DROP INDEX liftwright_plans_newest_of_kind",
    "DROP INDEX liftwright_plans_newest_of_owner",
    "DROP INDEX liftwright_documents_outcome",
    "DROP INDEX liftwright_documents_physics",
    "DROP INDEX liftwright_plans_work_master",
    "DROP INDEX liftwright_plans_of_scene",
    *(f"ALTER TABLE liftwright_plans DROP COLUMN {name}" for name in ("work_master", "priority", "start_us", "end_us")),
    "ALTER TABLE liftwright_plans DROP COLUMN scene_id",
    "DROP INDEX liftwright_plans_in_cell",
    "ALTER TABLE liftwright_plans DROP COLUMN cell",
    "DROP TABLE liftwright_cells",
    "DROP INDEX liftwright_plans_of_study",
    "ALTER TABLE liftwright_plans DROP COLUMN study_id",
    "ALTER TABLE liftwright_documents DROP COLUMN certified_us",
    "ALTER TABLE liftwright_documents DROP COLUMN awaits_simulation",
    "ALTER TABLE liftwright_documents DROP COLUMN physics",
    "DROP TABLE liftwright_totals",
    "DROP TABLE liftwright_scenes",
    "DROP TABLE liftwright_studies",
    "DROP TABLE liftwright_study_points",
    "DROP TABLE liftwright_api_keys",
    "DROP TABLE liftwright_sessions",
    "DROP TABLE liftwright_audit",
    "DROP TABLE liftwright_webhooks",
    "DROP TABLE liftwright_webhook_deliveries",
    "DROP TABLE liftwright_webhook_attempts",
    "ALTER TABLE liftwright_plans DROP COLUMN owner",
    "ALTER TABLE liftwright_plans DROP COLUMN sent_fingerprint",
)
POSTGRES = "ALTER TABLE liftwright_plans ALTER COLUMN stage TYPE VARCHAR(64)"
"""SQLite does not mind lengths, and cannot change them."""


def back_to_the_first_version(engine: sa.Engine) -> None:
    """Take away what later versions have brought."""
    with engine.begin() as transaction:
        VERSION_TABLE.drop(transaction)
        for statement in NEWER:
            transaction.exec_driver_sql(statement)
        if engine.dialect.name == "postgresql":
            transaction.exec_driver_sql(POSTGRES)
