"""A PostgreSQL server of the tests' own, with databases made from a migrated one.

Started when first asked for, once a process (each of pytest's workers has its own), and stopped at the end. Nothing it
holds is to survive, so it waits for no disk. A database is a copy of one that was migrated once.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest
import sqlalchemy as sa

from benchmarks.servers import PostgreSQL
from boresight.platform.db.sessions import migrate, open_engine

TEMPLATE = "migrated"
FIRST_WITH_STRATEGY = 150000  # before, copying files was the only way to copy a database
INITDB = ("-N", "--locale", "C.UTF-8", "--locale-provider", "icu", "--icu-locale", "en-US")  # sorts a, B: unlike SQLite
OPTIONS = {
    "fsync": "off",
    "synchronous_commit": "off",
    "full_page_writes": "off",
    "wal_level": "minimal",
    "max_wal_senders": "0",
    "autovacuum": "off",  # it would hold on to databases that are copied and dropped
    "jit": "off",
    "max_connections": "400",
    "shared_buffers": "32MB",
    "timezone": "Asia/Kathmandu",  # an odd one: no time may depend on it
}

#: That this process opened, by database: one that is lost with its engine would warn.
_connections: dict[str, list[Any]] = {}


class Server(PostgreSQL):
    """The server, while it runs."""

    def __init__(self) -> None:
        super().__init__(OPTIONS, INITDB)
        ((version,),) = self.execute("SELECT current_setting('server_version_num')::int")
        self._quickly = "" if version < FIRST_WITH_STRATEGY else "STRATEGY file_copy"
        self.make(TEMPLATE, "template0")
        engine = open_engine(self.url(TEMPLATE))
        migrate(engine)
        engine.dispose()

    def remove(self) -> None:
        """Stop for good."""
        for connection in [connection for opened in _connections.values() for connection in opened]:
            connection.close()
        super().remove()

    def make(self, name: str, template: str = TEMPLATE) -> str:
        """Make a database, a copy of another one that nobody is connected to after this; return its address."""
        self.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s", template)
        self.execute(f'CREATE DATABASE "{name}" TEMPLATE "{template}" {self._quickly}')
        return self.url(name)

    def drop(self, name: str) -> None:
        """Remove a database, whoever is connected to it; what tests left open is closed with it."""
        for connection in _connections.pop(name, ()):
            connection.close()
        self.execute(f'DROP DATABASE IF EXISTS "{name}" WITH (FORCE)')


@cache
def server() -> Server:
    """Return this process's server; a test that needs one is skipped where PostgreSQL is not installed."""
    if not PostgreSQL.installed():
        pytest.skip("no PostgreSQL server, or no driver of it, on this machine")
    sa.event.listen(sa.pool.Pool, "connect", _remember)
    return Server()


def _remember(connection: Any, record: Any) -> None:  # noqa: ARG001 - SQLAlchemy gives both
    """Keep a connection until its database goes."""
    if hasattr(connection, "pgconn"):
        _connections.setdefault(connection.info.dbname, []).append(connection)


def remove_server() -> None:
    """Stop this process's server, if there is one."""
    if server.cache_info().currsize:
        server().remove()
        server.cache_clear()
