"""How Alembic runs the revisions: on the connection that `boresight.platform.db.sessions` opened, inside its transaction."""

from __future__ import annotations

from alembic import context

from boresight.platform.db.declared import Base

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=Base.metadata,
    render_as_batch=True,
    transactional_ddl=True,
)
with context.begin_transaction():
    context.run_migrations()
