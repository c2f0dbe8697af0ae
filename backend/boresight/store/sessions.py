"""Opening the database and its transactions; the schema is brought up to date here too.

One request or job is one transaction: the door that starts it opens `reading` or `writing`, and everything inside sees
one state of the database. There is one writer at a time in both engines (`BEGIN IMMEDIATE` on SQLite, an advisory lock
on PostgreSQL), so that a rule proven by reading and then writing inside one transaction holds, whoever else is at work.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import Engine
from sqlalchemy.orm import Session as OrmSession

from boresight.errors import BoresightError, ConflictError, RefusedInputError
from boresight.resources import folder
from boresight.store.chain import forget, seal, seal_everything, write_before_reading
from boresight.store.seals import note_flushed, refuse_bulk
from boresight.store.times import utc_after, utc_now, utc_text

__all__ = [
    "Engine",
    "Session",
    "current_revision",
    "downgrade",
    "head_revision",
    "keep_despite_refusal",
    "migrate",
    "only_try",
    "open_engine",
    "reading",
    "utc_after",
    "utc_now",
    "utc_text",
    "writing",
]

PRAGMAS = (
    "PRAGMA journal_mode=WAL",
    "PRAGMA synchronous=NORMAL",
    "PRAGMA foreign_keys=ON",
    "PRAGMA busy_timeout=10000",
    "PRAGMA journal_size_limit=67108864",
)
WRITER_LOCK = 0x626F7265  # "bore": the advisory lock that makes one writer at a time on PostgreSQL
KEPT = "kept despite refusal"
TRIED = "only tried"
FIRST_WITH_SEALS = "0003"


class Session(OrmSession):
    """A transaction on the store; its commit seals in the audit log what it changed."""


sa.event.listen(Session, "after_flush", note_flushed)
sa.event.listen(Session, "do_orm_execute", refuse_bulk)
sa.event.listen(Session, "do_orm_execute", write_before_reading)
sa.event.listen(Session, "before_commit", seal)
sa.event.listen(Session, "after_rollback", forget)


def open_engine(url: str) -> Engine:
    """Open the store at a SQLAlchemy address, `sqlite:///path` or `postgresql://user@host/name`.

    Raises
    ------
    RefusedInputError
        When the address is not one of these two engines, or the PostgreSQL driver is not installed.
    """
    try:
        address = sa.make_url(url)
    except sa.exc.ArgumentError as error:
        raise RefusedInputError(f"The database address {url!r} cannot be read; expected sqlite:///path.") from error
    backend = address.get_backend_name()
    if backend == "sqlite" and address.database:
        return _open_sqlite(address)
    if backend in {"postgresql", "postgres"}:
        return _open_postgresql(address)
    raise RefusedInputError(f"The database address {url!r} names neither a SQLite file nor a PostgreSQL database.")


def _open_sqlite(address: sa.URL) -> Engine:
    """Open a SQLite file, making its folder, with the pragmas on every connection."""
    path = Path(str(address.database)).expanduser()
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not path.exists():
        path.touch(mode=0o600)
    with suppress(PermissionError):  # of a file that another account owns and shares
        path.chmod(0o600)  # it holds password hashes; SQLite gives its journals the same mode
    engine = sa.create_engine(address)
    sa.event.listen(engine, "connect", _on_sqlite_connect)
    sa.event.listen(engine, "begin", _on_sqlite_begin)
    return engine


def _on_sqlite_connect(connection: Any, record: Any) -> None:  # noqa: ARG001 - SQLAlchemy gives both
    """Set the pragmas, and take transactions out of the driver's hands: it would begin them too late."""
    connection.isolation_level = None
    for pragma in PRAGMAS:
        connection.execute(pragma).close()


def _on_sqlite_begin(connection: sa.Connection) -> None:
    """Begin as the session asked: a writer takes the lock now, not at its first write, when it might be too late."""
    connection.exec_driver_sql(f"BEGIN {connection.get_execution_options().get('begin', 'DEFERRED')}")


def _open_postgresql(address: sa.URL) -> Engine:
    """Open a PostgreSQL database through psycopg."""
    try:
        return sa.create_engine(address.set(drivername="postgresql+psycopg"), pool_pre_ping=True)
    except ImportError as error:
        raise RefusedInputError("PostgreSQL needs its driver: pip install 'boresight[postgresql]'.") from error


@contextmanager
def reading(engine: Engine) -> Iterator[Session]:
    """Open a transaction that sees one state of the database and changes nothing."""
    options: dict[str, Any] = {}
    if engine.dialect.name == "postgresql":
        options = {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
    with Session(engine.execution_options(**options), expire_on_commit=False) as session:
        yield session


@contextmanager
def writing(engine: Engine) -> Iterator[Session]:
    """Open the one writing transaction; commits at the end, rolls back when an error passes.

    A refusal that a service marked with `keep_despite_refusal` is committed and passed on all the same.
    """
    with Session(engine.execution_options(begin="IMMEDIATE"), expire_on_commit=False) as session:
        _be_the_only_writer(session.connection())
        try:
            yield session
        except BoresightError:
            if session.info.get(KEPT):
                session.commit()
            raise
        _end(session)


def _end(session: Session) -> None:
    """Commit what was written; what was only tried is checked against the schema and rolled back."""
    if session.info.get(TRIED):
        seal(session)
        session.rollback()
    else:
        session.commit()


def only_try(session: Session) -> None:
    """Make this transaction a trial: every check is made, and nothing of it is kept at its end."""
    session.info[TRIED] = True


def keep_despite_refusal(session: Session, *, of_a_trial: bool = False) -> None:
    """Keep what this transaction wrote although a refusal is about to be raised.

    For the refusals whose trace must survive: a failed log-in that counts, a request found stale or overdue.

    Parameters
    ----------
    of_a_trial
        Also when the transaction only tries: or passwords could be guessed without being counted.
    """
    if of_a_trial or not session.info.get(TRIED):
        session.info[KEPT] = True


def _be_the_only_writer(connection: sa.Connection) -> None:
    """Wait until no other writer is at work; SQLite's `BEGIN IMMEDIATE` already did."""
    if connection.dialect.name == "postgresql":
        connection.execute(sa.select(sa.func.pg_advisory_xact_lock(WRITER_LOCK)))


def _config(connection: sa.Connection | None = None) -> Config:
    """Configure Alembic from the folder that travels with the package; users need no file for it."""
    config = Config()
    config.set_main_option("script_location", str(folder("migrations")).replace("%", "%%"))
    config.attributes["connection"] = connection
    return config


@contextmanager
def _changing_schema(engine: Engine) -> Iterator[sa.Connection]:
    """Open a transaction for a migration: alone, all or nothing, with SQLite's foreign keys checked at its end.

    SQLite alters a table by copying and dropping it, which with foreign keys on would take the rows that refer to it.

    Raises
    ------
    ConflictError
        When the database was written by a newer version of Boresight, or its rows would no longer refer to anything.
    """
    with engine.execution_options(begin="IMMEDIATE").connect() as connection:
        sqlite = connection.dialect.name == "sqlite"
        driver = connection.connection.driver_connection if sqlite else None
        if driver is not None:  # before BEGIN: inside a transaction the pragma does nothing
            driver.execute("PRAGMA foreign_keys=OFF")
        try:
            with connection.begin():
                _be_the_only_writer(connection)
                yield connection
                if sqlite and (broken := connection.exec_driver_sql("PRAGMA foreign_key_check").fetchall()):
                    raise ConflictError(f"The migration would leave rows that refer to nothing: {broken[:3]}.")
        except CommandError as error:
            raise ConflictError(
                f"The database is of a newer version of Boresight ({error}); install that version or restore a backup."
            ) from error
        finally:
            if driver is not None:
                driver.execute("PRAGMA foreign_keys=ON")


def migrate(engine: Engine) -> None:
    """Bring the schema up to date; does nothing when it is. Rows from before there were seals are sealed as they are.

    Raises
    ------
    ConflictError
        When the database was written by a newer version of Boresight.
    """
    with _changing_schema(engine) as connection:
        before = MigrationContext.configure(connection).get_current_revision()
        command.upgrade(_config(connection), "head")
        if before is not None and before < FIRST_WITH_SEALS:
            with Session(connection, join_transaction_mode="rollback_only") as session:
                seal_everything(session)
                session.commit()  # its own part; the connection's transaction goes on


def downgrade(engine: Engine, revision: str) -> None:
    """Take the schema back to a revision; `base` removes every table.

    Raises
    ------
    RefusedInputError
        When there is no such revision on the way back; names those there are.
    ConflictError
        When the database was written by a newer version of Boresight.
    """
    behind = _revisions_behind(current_revision(engine))
    if revision not in behind:
        raise RefusedInputError(f"There is no schema revision {revision!r} to go back to; name {' or '.join(behind)}.")
    with _changing_schema(engine) as connection:
        command.downgrade(_config(connection), revision)


def _revisions_behind(current: str | None) -> list[str]:
    """Return the revisions from `base` to the schema's own; all there are where the schema's own is not known."""
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
