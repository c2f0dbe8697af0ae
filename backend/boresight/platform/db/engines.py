"""Opening the database on either engine, and turning its failures into sentences."""

from __future__ import annotations

import sqlite3
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Engine

from boresight.disks import Opened, absent, failing, full, read_only, refuse_unwritable, storage_error
from boresight.errors import NotFoundError, RefusedInputError, StorageError, UnavailableError

BUSY_S = 10  # wait for another writer of SQLite
LOCKED = ("SQLITE_BUSY", "SQLITE_LOCKED")  # how SQLite's names of errors begin where another holds the lock
WRITE_AHEAD = "PRAGMA journal_mode=WAL"
PRAGMAS = (
    f"PRAGMA busy_timeout={BUSY_S * 1000}",
    "PRAGMA synchronous=NORMAL",
    "PRAGMA foreign_keys=ON",
    "PRAGMA journal_size_limit=67108864",
)
MEMORY = ":memory:"
OPENED = "opened"  # key in a connection's info
WRITER_LOCK = 0x626F7265  # "bore": the advisory lock that makes one writer at a time on PostgreSQL
WAIT_S = 30  # wait for another writer; a migration waits longer
IDLE_S = 600  # idle time in a transaction that holds the lock, after which its server counts as dead
CONNECTIONS, MORE_AT_TIMES = 8, 16  # of one server; PostgreSQL allows a hundred in all unless told otherwise
CONNECT = {
    "connect_timeout": 10,
    "keepalives_idle": 30,
    "keepalives_interval": 10,
    "keepalives_count": 3,
    "tcp_user_timeout": 60_000,  # ms
}
GONE = (
    "The database does not answer: check that PostgreSQL runs and that BORESIGHT_DATABASE_URL names it, and try again."
)
NUMBER_OUT_OF_RANGE, UNTRANSLATABLE = "22003", "22021"  # states of SQL
NO_SUCH_NUMBER = "Nothing has this number; choose one from the list."
TOO_LARGE = "A number is larger than 64 bits; send a smaller one."
UNWRITABLE = "A text contains a character that cannot be stored: NUL, or half of a surrogate pair; remove it."
OF_DISK = {
    "SQLITE_FULL": full,
    "SQLITE_IOERR": failing,
    "SQLITE_READONLY": read_only,
    "SQLITE_CANTOPEN": absent,
}  # SQLite's error name, and our sentence
DISK_FULL = "53100"  # of PostgreSQL
BUSY = "Another writer is using the database for longer than usual; try again in a moment."


def open_engine(url: str) -> Engine:
    """Open the store at a SQLAlchemy address, `sqlite:///path` or `postgresql://user@host/name`.

    What is executed on it raises UnavailableError when the database does not answer, or stays locked.
    """
    try:
        address = sa.make_url(url)
    except sa.exc.ArgumentError as error:
        raise RefusedInputError(
            f"The database address {url!r} cannot be read; give one such as sqlite:///path."
        ) from error
    backend = address.get_backend_name()
    if backend == "sqlite" and address.database:
        return _open_sqlite(address)
    if backend in {"postgresql", "postgres"}:
        return _open_postgresql(address)
    raise RefusedInputError(
        f"The database address {url!r} names neither a SQLite file nor a PostgreSQL database; give one such as sqlite:///path."
    )


def _open_sqlite(address: sa.URL) -> Engine:
    """Open a SQLite file, making its folder, with the pragmas on every connection."""
    if address.database == MEMORY:
        return _listening(sa.create_engine(address, hide_parameters=True), Path(MEMORY))
    path = Path(str(address.database)).expanduser().absolute()
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not path.exists():
            path.touch(mode=0o600)
        opened = Opened(path)
    except OSError as error:
        raise storage_error(error, path) or error from error
    with suppress(OSError):  # a file owned and shared by another account
        path.chmod(0o600)  # it holds password hashes; SQLite gives its journals the same mode
    engine = sa.create_engine(address, hide_parameters=True)  # errors must not show values, because some are secrets
    sa.event.listen(engine, "do_connect", partial(_connect_to, opened))
    sa.event.listen(engine, "connect", partial(_remember, opened))
    sa.event.listen(engine, "begin", lambda _connection: opened.refuse_another())
    return _listening(engine, path)


def _listening(engine: Engine, path: Path) -> Engine:
    """Attach the listeners of a SQLite engine: pragmas, BEGIN, and sentences for failures."""
    sa.event.listen(engine, "connect", _on_sqlite_connect)
    sa.event.listen(engine, "begin", _on_sqlite_begin)
    sa.event.listen(engine, "handle_error", partial(_say_what_sqlite_lacks, path))
    sa.event.listen(engine, "handle_error", _say_what_cannot_be_held)
    return engine


def _connect_to(opened: Opened, dialect: Any, record: Any, _arguments: Any, options: dict[str, Any]) -> Any:  # noqa: ARG001 - SQLAlchemy gives all
    """Connect to the existing file, and never create one."""
    opened.refuse_another()
    return dialect.connect(f"{opened.place.as_uri()}?mode=rw", **options, uri=True)


def _remember(opened: Opened, connection: Any, record: Any) -> None:  # noqa: ARG001 - SQLAlchemy gives both
    """Store the database file in a connection's info, for use outside transactions."""
    record.info[OPENED] = opened


def _on_sqlite_connect(connection: Any, record: Any) -> None:  # noqa: ARG001 - SQLAlchemy gives both
    """Set the pragmas, and turn off the driver's own transactions, which would begin too late."""
    connection.isolation_level = None
    for pragma in PRAGMAS:
        connection.execute(pragma).close()
    _write_ahead(connection)


def _write_ahead(connection: Any) -> None:
    """Turn on the write-ahead log; of servers that do so at once on a new file SQLite refuses all but one without waiting."""
    until = time.monotonic() + BUSY_S
    while True:
        try:
            connection.execute(WRITE_AHEAD).close()
        except sqlite3.OperationalError as error:
            if not error.sqlite_errorname.startswith(LOCKED) or time.monotonic() > until:
                raise
            time.sleep(0.01)
        else:
            return


def _on_sqlite_begin(connection: sa.Connection) -> None:
    """Begin the transaction; a writer takes the lock now and not at its first write, when that could fail."""
    connection.exec_driver_sql(f"BEGIN {connection.get_execution_options().get('begin', 'DEFERRED')}")


def _say_what_sqlite_lacks(path: Path, context: sa.engine.ExceptionContext) -> UnavailableError | None:
    """Turn lock timeouts and disk failures into sentences."""
    name = getattr(context.original_exception, "sqlite_errorname", "")
    if name.startswith(LOCKED):
        return UnavailableError(BUSY, code="database-busy")
    if name.startswith("SQLITE_CANTOPEN"):  # also the error of a read-only disk
        try:
            refuse_unwritable(path)
        except StorageError as error:
            return error
    said = next((said for begins, said in OF_DISK.items() if name.startswith(begins)), None)
    return None if said is None else StorageError(said("the database"))


def _say_what_cannot_be_held(context: sa.engine.ExceptionContext) -> NotFoundError | RefusedInputError | None:
    """Refuse in a sentence a value that no column can hold: a number beyond 64 bits, a lone surrogate, a NUL on PostgreSQL."""
    error = context.original_exception
    state = getattr(error, "sqlstate", None)
    if isinstance(error, OverflowError) or state == NUMBER_OUT_OF_RANGE:
        asked = (context.statement or "").startswith("SELECT")
        return NotFoundError(NO_SUCH_NUMBER) if asked else RefusedInputError(TOO_LARGE)
    unwritable = isinstance(error, UnicodeEncodeError) or "NUL (0x00)" in str(error) or state == UNTRANSLATABLE
    return RefusedInputError(UNWRITABLE) if unwritable else None


def _open_postgresql(address: sa.URL) -> Engine:
    try:
        engine = sa.create_engine(
            address.set(drivername="postgresql+psycopg"),
            pool_pre_ping=True,
            hide_parameters=True,
            pool_size=CONNECTIONS,
            max_overflow=MORE_AT_TIMES,
            connect_args=CONNECT,
        )
    except ImportError as error:
        raise RefusedInputError("PostgreSQL needs its driver: pip install 'boresight[postgresql]'.") from error
    sa.event.listen(engine, "handle_error", _say_what_postgresql_lacks)
    sa.event.listen(engine, "handle_error", _say_what_cannot_be_held)
    return engine


def _say_what_postgresql_lacks(context: sa.engine.ExceptionContext) -> UnavailableError | None:
    """Turn lost or refused connections and lock timeouts into sentences, by their SQL state (class 08, 57, 53)."""
    state = getattr(context.original_exception, "sqlstate", None)
    if state == "55P03":  # lock not available
        return UnavailableError(BUSY, code="database-busy")
    unconnected = context.connection is None and isinstance(context.sqlalchemy_exception, sa.exc.OperationalError)
    gone = context.is_disconnect or unconnected or (state or "").startswith(("08", "57P", "53"))
    if state == DISK_FULL:
        return StorageError(full("the database"))
    return UnavailableError(GONE, code="database-unreachable") if gone else None


def be_the_only_writer(connection: sa.Connection, *, wait_s: int = WAIT_S) -> None:
    """Wait for the lock of the one writer on PostgreSQL; SQLite's `BEGIN IMMEDIATE` has it already."""
    if connection.dialect.name != "postgresql":
        return
    limits = {"lock_timeout": wait_s, "idle_in_transaction_session_timeout": IDLE_S}
    connection.execute(sa.select(*(sa.func.set_config(name, f"{limit}s", True) for name, limit in limits.items())))
    connection.execute(sa.select(sa.func.pg_advisory_xact_lock(WRITER_LOCK)))


def refuse_unwritable_store(engine: Engine) -> None:
    """Refuse a SQLite database whose file, folder or disk cannot take a write now; PostgreSQL looks after its own."""
    if engine.dialect.name == "sqlite":
        refuse_unwritable(Path(str(engine.url.database)).expanduser())
