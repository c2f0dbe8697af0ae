"""A PostgreSQL server of a measurement's own, durable as its defaults are, on a socket in a temporary folder; gone at the end."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PLACES = Path("/usr/lib/postgresql")  # Debian keeps these programs off the path


def installed() -> bool:
    """Whether this machine has PostgreSQL's server, and this Python its driver."""
    from importlib.util import find_spec  # noqa: PLC0415 - beside its only use

    return find_spec("psycopg") is not None and _program("initdb") is not None


@contextmanager
def postgresql() -> Iterator[str]:
    """Run a server with one empty database; yields its address.

    Raises
    ------
    RuntimeError
        When a program of PostgreSQL fails, with what it said.
    """
    folder = Path(tempfile.mkdtemp(prefix="boresight-pg-"))  # a short name: socket addresses are
    account: list[str] = []
    if os.geteuid() == 0:  # PostgreSQL refuses to run as root: nobody does, whose folder this becomes
        shutil.chown(folder, "nobody")
        account = ["setpriv", "--reuid=nobody", "--clear-groups"]
    try:
        _run(folder, account, "initdb", "-D", f"{folder}/data", "-U", "boresight", "-A", "trust", "-E", "UTF8")
        _run(
            folder,
            account,
            "pg_ctl",
            "-D",
            f"{folder}/data",
            "-w",
            "-l",
            f"{folder}/log",
            "-o",
            f"-h '' -k {folder}",
            "start",
        )
        try:
            _run(folder, account, "createdb", "-h", str(folder), "-U", "boresight", "boresight")
            yield f"postgresql://boresight@/boresight?host={folder}"
        finally:
            _run(folder, account, "pg_ctl", "-D", f"{folder}/data", "-m", "immediate", "stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _program(name: str) -> str | None:
    return shutil.which(
        name, path=os.pathsep.join([os.environ.get("PATH", ""), *map(str, sorted(PLACES.glob("*/bin")))])
    )


def _run(folder: Path, account: list[str], program: str, *words: str) -> None:
    """Run a program without pipes, which a server that is started would keep open."""
    said = folder / "programs.log"
    with said.open("ab") as log:
        done = subprocess.run(  # noqa: S603 - words of our own
            [*account, str(_program(program)), *words], check=False, stdout=log, stderr=log, cwd="/"
        )
    if done.returncode:
        raise RuntimeError(f"{program} failed: {said.read_text(encoding='utf-8').strip()}")
