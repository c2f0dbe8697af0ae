"""A PostgreSQL server of the tests' own, on a socket in a temporary folder, with databases made from a migrated one.

Started when first asked for, once a process (each of pytest's workers has its own), and stopped at the end. Nothing it
holds is to survive, so it waits for no disk. A database is a copy of one that was migrated once.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from boresight.platform.db.sessions import migrate, open_engine

PROGRAMS = os.pathsep.join([os.environ["PATH"], *map(str, Path("/usr/lib/postgresql").glob("*/bin"))])  # Debian's place
TEMPLATE = "migrated"
FIRST_WITH_STRATEGY = 150000  # before, copying files was the only way to copy a database
COLLATION = ("--locale", "C.UTF-8", "--locale-provider", "icu", "--icu-locale", "en-US")  # sorts a, B: unlike SQLite
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


_connections: dict[
    str, list[Any]
] = {}  # that this process opened, by database: one that is lost with its engine would warn


class Server:
    """The server, while it runs."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="pg-"))  # a short name: socket addresses are
        self._account = _account(self.folder)
        self._run(
            "initdb", "-D", f"{self.folder}/data", "-U", "boresight", "-A", "trust", "-N", "-E", "UTF8", *COLLATION
        )
        self.start()
        self._quickly = "" if self._version() < FIRST_WITH_STRATEGY else "STRATEGY file_copy"
        self.make(TEMPLATE, "template0")
        engine = open_engine(self.url(TEMPLATE))
        migrate(engine)
        engine.dispose()

    def start(self) -> None:
        """Start, or start again."""
        options = " ".join(f"-c {name}={value}" for name, value in OPTIONS.items())
        words = ("-w", "-l", f"{self.folder}/log", "-o", f"-h '' -k {self.folder} {options}", "start")
        self._run("pg_ctl", "-D", f"{self.folder}/data", *words)

    def stop(self) -> None:
        """Stop at once, as a failing machine does."""
        self._run("pg_ctl", "-D", f"{self.folder}/data", "-m", "immediate", "stop")

    def remove(self) -> None:
        """Stop for good."""
        for connection in [connection for opened in _connections.values() for connection in opened]:
            connection.close()
        self.stop()
        shutil.rmtree(self.folder, ignore_errors=True)

    def url(self, name: str) -> str:
        """Return the address of a database."""
        return f"postgresql://boresight@/{name}?host={self.folder}"

    def make(self, name: str, template: str = TEMPLATE) -> str:
        """Make a database, a copy of another one that nobody is connected to after this; return its address."""
        end = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s"
        self._execute((end, (template,)), (f'CREATE DATABASE "{name}" TEMPLATE "{template}" {self._quickly}', None))
        return self.url(name)

    def drop(self, name: str) -> None:
        """Remove a database, whoever is connected to it; what tests left open is closed with it."""
        for connection in _connections.pop(name, ()):
            connection.close()
        self._execute((f'DROP DATABASE IF EXISTS "{name}" WITH (FORCE)', None))

    def _execute(self, *statements: tuple[str, tuple[str] | None]) -> None:
        import psycopg  # noqa: PLC0415 - the tests of the rest run without it

        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            for statement, values in statements:
                connection.execute(statement, values)

    def _version(self) -> int:
        import psycopg  # noqa: PLC0415 - likewise

        with psycopg.connect(self.url("postgres")) as connection:
            return connection.info.server_version

    def _run(self, program: str, *words: str) -> None:
        """Run a program without pipes, which a server that is started would keep open."""
        path = shutil.which(program, path=PROGRAMS)
        assert path, f"there is no {program} on this machine"
        with (self.folder / "programs.log").open("ab") as log:
            done = subprocess.run([*self._account, path, *words], check=False, stdout=log, stderr=log, cwd="/")
        assert done.returncode == 0, (self.folder / "programs.log").read_text()


def _account(folder: Path) -> list[str]:
    """PostgreSQL refuses to run as root: then it runs as nobody, whose folder this becomes."""
    if os.geteuid() != 0:
        return []
    shutil.chown(folder, "nobody")
    return ["setpriv", "--reuid=nobody", "--clear-groups"]


@cache
def server() -> Server:
    """Return this process's server; a test that needs one is skipped where PostgreSQL is not installed."""
    pytest.importorskip("psycopg")
    if not shutil.which("initdb", path=PROGRAMS):
        pytest.skip("no PostgreSQL server on this machine")
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
