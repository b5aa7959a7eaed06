"""What Alembic starts for each of its commands: the history, on the connection that `migrate` has opened."""

from __future__ import annotations

from alembic import context

from workers.stores.migrations import REVISION_TABLE

context.configure(connection=context.config.attributes["connection"], version_table=REVISION_TABLE)
context.run_migrations()
