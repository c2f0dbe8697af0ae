"""Where a test's store is: a SQLite file in the test's folder, or with `--store postgresql` a database of that folder's.

Tests name the folder and open what `url_in` returns, so each of them runs on either engine.
"""

import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import sqlalchemy as sa

from boresight.platform.db.declared import Base
from boresight.platform.db.sessions import Engine, migrate, open_engine
from tests.postgresql import server

FILE = "boresight.sqlite3"  # the name that an installation gives it

_of_folders: dict[Path, str] = {}  # databases that were made, by the folder that they stand for
_chosen = ["sqlite"]


def choose(engine: str) -> None:
    _chosen[0] = engine


def on_postgresql() -> bool:
    return _chosen[0] == "postgresql"


def url_in(folder: Path) -> str:
    if not on_postgresql():
        return f"sqlite:///{folder}/{FILE}"
    folder = folder.resolve()
    if folder not in _of_folders:
        server().make(_name(folder))
        _of_folders[folder] = _name(folder)
    return server().url(_of_folders[folder])


def open_migrated(url: str) -> Engine:
    if url.startswith("sqlite"):
        path = Path(url.removeprefix("sqlite:///"))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(_migrated())
    return open_engine(url)


@contextmanager
def own(kind: str, folder: Path) -> Iterator[Engine]:
    """A migrated store on SQLite or PostgreSQL, whichever is asked for and whatever was chosen."""
    name = _name(folder)
    engine = open_migrated(f"sqlite:///{folder}/store.sqlite3" if kind == "sqlite" else server().make(name))
    yield engine
    engine.dispose()
    if kind == "postgresql":
        server().drop(name)


@cache
def _migrated() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        engine = open_engine(f"sqlite:///{folder}/{FILE}")
        migrate(engine)
        engine.dispose()  # the last connection folds the write-ahead log into the file
        return Path(folder, FILE).read_bytes()


def environment_in(folder: Path) -> dict[str, str]:
    return {"BORESIGHT_DATABASE_URL": url_in(folder)} if on_postgresql() else {}


def copied(source: Path, target: Path) -> str:
    if not on_postgresql():
        target.mkdir(parents=True, exist_ok=True)
        shutil.copy(source / FILE, target / FILE)
        return url_in(target)
    target = target.resolve()
    _of_folders[target] = _name(target)
    return server().make(_name(target), _of_folders[source.resolve()])


def drop_under(folder: Path) -> None:
    folder = folder.resolve()
    for made in [path for path in _of_folders if path.is_relative_to(folder)]:
        server().drop(_of_folders.pop(made))


def drop_triggers(connection: sa.Connection) -> None:
    if connection.dialect.name == "sqlite":
        for name in connection.exec_driver_sql("SELECT name FROM sqlite_master WHERE type = 'trigger'").scalars().all():
            connection.exec_driver_sql(f"DROP TRIGGER {name}")
    else:
        for name in Base.metadata.tables:
            connection.exec_driver_sql(f"ALTER TABLE {name} DISABLE TRIGGER USER")


@contextmanager
def triggers_aside(connection: sa.Connection) -> Iterator[None]:
    query = "SELECT sql FROM sqlite_master WHERE type = 'trigger'"
    on_sqlite = connection.dialect.name == "sqlite"
    triggers = connection.exec_driver_sql(query).scalars().all() if on_sqlite else ()
    drop_triggers(connection)
    yield
    for words in triggers:
        connection.exec_driver_sql(words)
    for name in () if on_sqlite else Base.metadata.tables:
        connection.exec_driver_sql(f"ALTER TABLE {name} ENABLE TRIGGER USER")


def _name(folder: Path) -> str:
    return f"t{hashlib.sha256(str(folder).encode()).hexdigest()[:20]}"
