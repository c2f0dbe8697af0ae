"""The database's transactions; the schema is brought up to date here too.

One request or job is one transaction: the code that starts it opens `open_reading` or `open_writing`, and everything inside sees
one state of the database. There is one writer at a time in both engines (`BEGIN IMMEDIATE` on SQLite, an advisory lock
on PostgreSQL), so that a rule proven by reading and then writing inside one transaction holds, whoever else is at work.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, TypeVar

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import Engine
from sqlalchemy.orm import Session as OrmSession

from boresight.errors import BoresightError, ConflictError, NotFoundError, RefusedInputError
from boresight.platform.audit.chain import forget, seal, seal_everything, write_before_reading
from boresight.platform.audit.seals import chain_new, note_flushed, refuse_bulk
from boresight.platform.audit.security_log import write_noted
from boresight.platform.db.declared import Base
from boresight.platform.db.engines import be_the_only_writer, open_engine
from boresight.platform.db.times import utc_after, utc_now, utc_text
from boresight.resources import folder

__all__ = [
    "Engine",
    "Session",
    "current_revision",
    "downgrade",
    "head_revision",
    "is_dry_run",
    "keep_despite_refusal",
    "list_downgrade_losses",
    "mark_dry_run",
    "migrate",
    "open_engine",
    "open_reading",
    "open_store",
    "open_writing",
    "upgrade_tables",
    "utc_after",
    "utc_now",
    "utc_text",
]

T = TypeVar("T")
R = TypeVar("R", bound=Base)

MIGRATION_WAIT_S = 600  # time to wait for another server that migrates at the same time
KEPT = "kept despite refusal"
DRY_RUN = "dry run"
FIRST_WITH_SEALS = "0003"
_ONE_MIGRATION = threading.Lock()  # Alembic's context belongs to the process


class Session(OrmSession):
    """A transaction on the store; its commit seals in the audit log what it changed."""

    def get_known(self, table: type[R], row_id: int) -> R:
        """Return a row by its id; refuse an unknown one."""
        row = self.get(table, row_id)
        if row is None:
            raise NotFoundError(f"There is no {table.noun} {row_id}; choose one from the list.")
        return row

    def put(self, row: T) -> T:
        """Insert a new row at once, which assigns its id."""
        self.add(row)
        self.flush()
        return row


sa.event.listen(Session, "before_flush", chain_new)
sa.event.listen(Session, "after_flush", note_flushed)
sa.event.listen(Session, "do_orm_execute", refuse_bulk)
sa.event.listen(Session, "do_orm_execute", write_before_reading)
sa.event.listen(Session, "before_commit", seal)
sa.event.listen(Session, "after_rollback", forget)


@contextmanager
def open_store(url: str) -> Iterator[Engine]:
    """Open the store at an address for one command, with its schema upgraded, and close it at the end."""
    engine = open_engine(url)
    try:
        migrate(engine)
        yield engine
    finally:
        engine.dispose()


@contextmanager
def open_reading(engine: Engine) -> Iterator[Session]:
    """Open a transaction that sees one state of the database and changes nothing."""
    options: dict[str, Any] = {}
    if engine.dialect.name == "postgresql":
        options = {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
    with Session(engine.execution_options(**options), expire_on_commit=False) as session:
        yield session


@contextmanager
def open_writing(engine: Engine) -> Iterator[Session]:
    """Open the one writing transaction; commits at the end, rolls back when an error passes.

    A refusal that a service marked with `keep_despite_refusal` is committed and passed on all the same.
    """
    with Session(engine.execution_options(begin="IMMEDIATE"), expire_on_commit=False) as session:
        be_the_only_writer(session.connection())
        try:
            yield session
        except BoresightError:
            if session.info.get(KEPT):
                session.commit()
                write_noted(session)
            raise
        _end(session)


def _end(session: Session) -> None:
    """Commit what was written; a dry run is checked against the schema and rolled back."""
    if session.info.get(DRY_RUN):
        seal(session)
        session.rollback()
    else:
        session.commit()
        write_noted(session)


def mark_dry_run(session: Session) -> None:
    """Make this transaction a dry run: every check is made, and it is rolled back at its end."""
    session.info[DRY_RUN] = True


def is_dry_run(session: Session) -> bool:
    """Whether this transaction is rolled back at its end, so that nothing outside of it may be stored."""
    return bool(session.info.get(DRY_RUN))


def keep_despite_refusal(session: Session) -> None:
    """Commit this transaction although a refusal is about to be raised, unless it is a dry run.

    For refusals that must leave a trace: a request found stale or overdue.
    """
    if not session.info.get(DRY_RUN):
        session.info[KEPT] = True


def _config(connection: sa.Connection | None = None) -> Config:
    """Configure Alembic from the folder that travels with the package; users need no file for it."""
    config = Config()
    config.set_main_option("script_location", str(folder("migrations")).replace("%", "%%"))
    config.attributes["connection"] = connection
    return config


@contextmanager
def _changing_schema(engine: Engine) -> Iterator[sa.Connection]:
    """Open an exclusive transaction for a migration, with SQLite's foreign keys checked at its end.

    SQLite alters a table by copying and dropping it, which with foreign keys on would take the rows that refer to it.
    """
    with engine.execution_options(begin="IMMEDIATE").connect() as connection:
        sqlite = connection.dialect.name == "sqlite"
        driver = connection.connection.driver_connection if sqlite else None
        if driver is not None:  # before BEGIN: inside a transaction the pragma does nothing
            driver.execute("PRAGMA foreign_keys=OFF")
        try:
            with connection.begin():
                be_the_only_writer(connection, wait_s=MIGRATION_WAIT_S)
                yield connection
                if sqlite and (broken := connection.exec_driver_sql("PRAGMA foreign_key_check").fetchall()):
                    raise ConflictError(
                        f"No migration was made, because rows would refer to nothing, {broken[:3]}: restore a backup."
                    )
        except CommandError as error:
            raise ConflictError(
                f"The database was made by a newer version of Boresight ({error}); install that version or restore a backup."
            ) from error
        finally:
            if driver is not None:
                driver.execute("PRAGMA foreign_keys=ON")


def migrate(engine: Engine) -> None:
    """Bring the schema up to date; does nothing when it is. Rows from before there were seals are sealed as they are."""
    with _changing_schema(engine) as connection:
        before = MigrationContext.configure(connection).get_current_revision()
        upgrade_tables(connection)
        if before is not None and before < FIRST_WITH_SEALS:
            with Session(connection, join_transaction_mode="rollback_only") as session:
                seal_everything(session)
                session.commit()  # commits the session; the connection's transaction goes on


def upgrade_tables(connection: sa.Connection) -> None:
    """Upgrade every table, index and trigger from any revision to the newest schema."""
    with _ONE_MIGRATION:
        command.upgrade(_config(connection), "head")


def downgrade(engine: Engine, revision: str) -> None:
    """Take the schema back to a revision; `base` removes every table."""
    _refuse_unknown_revision(engine, revision)
    with _changing_schema(engine) as connection, _ONE_MIGRATION:
        command.downgrade(_config(connection), revision)


@dataclass(frozen=True)
class DowngradeLoss:
    """What a downgrade would remove: the rows of a table, or the values of a column."""

    table: str
    column: str | None
    rows: int

    def __str__(self) -> str:
        """Name it."""
        return (
            f"{self.rows} rows of {self.table}"
            if self.column is None
            else f"{self.table}.{self.column} of {self.rows} rows"
        )


class _DryRunError(Exception):
    """Raised to roll back a trial."""


def list_downgrade_losses(engine: Engine, revision: str) -> list[DowngradeLoss]:
    """Downgrade to a revision, compare what is left, and roll back, which both engines can with tables too."""
    found: list[DowngradeLoss] = []
    _refuse_unknown_revision(engine, revision)
    with suppress(_DryRunError), _changing_schema(engine) as connection:
        before = _contents(connection)
        with _ONE_MIGRATION:
            command.downgrade(_config(connection), revision)
        after = _contents(connection)
        for table, columns in before.items():
            rows = columns[""] - after.get(table, {}).get("", 0)
            if rows:
                found.append(DowngradeLoss(table, None, rows))
            gone = columns.keys() - after.get(table, {}).keys() if table in after else set()
            found += [DowngradeLoss(table, column, columns[column]) for column in sorted(gone) if columns[column]]
        raise _DryRunError
    return found


def _contents(connection: sa.Connection) -> dict[str, dict[str, int]]:
    """Count the rows of each table, under an empty name, and the values that are not NULL in each column."""
    inspector, found = sa.inspect(connection), {}
    for name in sorted(set(inspector.get_table_names()) - {"alembic_version"}):
        columns = [column["name"] for column in inspector.get_columns(name)]
        table = sa.table(name, *(sa.column(column) for column in columns))
        counts = [sa.func.count(), *(sa.func.count(table.c[column]) for column in columns)]
        row = connection.execute(sa.select(*counts).select_from(table)).one()
        found[name] = dict(zip(["", *columns], row, strict=True))
    return found


def _refuse_unknown_revision(engine: Engine, revision: str) -> None:
    behind = _revisions_behind(current_revision(engine))
    if revision not in behind:
        raise RefusedInputError(
            f"There is no schema revision {revision!r} to go back to; name {' or '.join(behind)}.",
            code="unknown-revision",
        )


def _revisions_behind(current: str | None) -> list[str]:
    """Return the revisions from `base` to the schema's own; all of them where that is unknown."""
    known = [script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions()][::-1]
    if current is None:
        return ["base"]
    return ["base", *known[: known.index(current) + 1]] if current in known else ["base", *known]


def current_revision(engine: Engine) -> str | None:
    """Return the revision of the schema, None where there is none yet."""
    with engine.connect() as connection:
        return MigrationContext.configure(connection).get_current_revision()


def head_revision() -> str | None:
    """Return the newest revision that this version knows."""
    return ScriptDirectory.from_config(_config()).get_current_head()
