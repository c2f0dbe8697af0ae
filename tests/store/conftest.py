"""Databases to act on: real SQLite files, and PostgreSQL where the machine has it."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from boresight.store.sessions import Engine, migrate, open_engine


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path}/store.sqlite3"


@pytest.fixture
def engine(url: str) -> Iterator[Engine]:
    engine = open_engine(url)
    migrate(engine)
    yield engine
    engine.dispose()


@pytest.fixture(scope="session")
def postgresql_cluster() -> Iterator[str]:
    """Start a PostgreSQL server of our own on a socket; skip where there is none."""
    pytest.importorskip("psycopg")
    if not shutil.which("initdb") or not shutil.which("pg_ctl"):
        pytest.skip("no PostgreSQL server on this machine")
    with tempfile.TemporaryDirectory(prefix="pg-") as folder:  # a short name: socket addresses are
        account = _account(Path(folder))
        start = ("-w", "-l", f"{folder}/log", "-o", f"-h '' -k {folder} -F", "start")
        made = _run(account, "initdb", "-D", f"{folder}/data", "-U", "boresight", "-A", "trust", "-N", "-E", "UTF8")
        if made != 0 or _run(account, "pg_ctl", "-D", f"{folder}/data", *start) != 0:
            pytest.skip("PostgreSQL does not start here")
        yield f"postgresql://boresight@/postgres?host={folder}"
        _run(account, "pg_ctl", "-D", f"{folder}/data", "-m", "immediate", "stop")


def _account(folder: Path) -> list[str]:
    """PostgreSQL refuses to run as root: then it runs as nobody, whose folder this becomes."""
    if os.geteuid() != 0:
        return []
    shutil.chown(folder, "nobody")
    return ["setpriv", "--reuid=nobody", "--clear-groups"]


def _run(account: list[str], *command: str) -> int:
    """Run a program without pipes, which a server that is started would keep open."""
    quiet = subprocess.DEVNULL
    return subprocess.run([*account, *command], check=False, stdout=quiet, stderr=quiet, cwd="/").returncode


@pytest.fixture
def postgresql(postgresql_cluster: str) -> Iterator[Engine]:
    """An empty, migrated PostgreSQL database."""
    engine = open_engine(postgresql_cluster)
    with engine.begin() as connection:
        connection.exec_driver_sql("DROP SCHEMA public CASCADE")
        connection.exec_driver_sql("CREATE SCHEMA public")
    migrate(engine)
    yield engine
    engine.dispose()
