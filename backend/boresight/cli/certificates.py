"""`boresight certificates`: what server, scheduler and workers prove themselves with, where they are services of their own."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import click

from boresight.errors import RefusedInputError

AUTHORITY, CERTIFICATE = "authority.pem", "boresight.pem"
CLOCKS_DIFFER = timedelta(days=1)


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--days", type=click.IntRange(1, 36_500), default=3650, show_default=True, help="Valid for so long.")
def certificates(folder: Path, days: int) -> None:
    """Make a certificate for tls:// links, and the authority that signed it, in FOLDER.

    The authority's key is forgotten, so this is the only certificate it will ever sign: copy both files to every machine of the
    cluster, and to nobody else, for whoever has boresight.pem can run programs on all of them.
    """
    from boresight.workers.certificates import issue

    now = datetime.now(UTC)
    made = issue(now - CLOCKS_DIFFER, now + timedelta(days=days))
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _write(folder / AUTHORITY, made.authority)
        _write(folder / CERTIFICATE, made.certificate + made.key)
    except FileExistsError as error:
        raise RefusedInputError(
            f"{error.filename} is there already, and links that use it would break: name another folder, or remove it first."
        ) from error
    except OSError as error:
        raise RefusedInputError(
            f"{folder} cannot be written ({error.strerror or error}): name another folder."
        ) from error
    click.echo(f"BORESIGHT_TLS_AUTHORITY={folder / AUTHORITY}")
    click.echo(f"BORESIGHT_TLS_CERTIFICATE={folder / CERTIFICATE}")
    click.echo(f"Valid until {now + timedelta(days=days):%Y-%m-%d}.", err=True)


def _write(path: Path, text: str) -> None:
    """Write a new file that only this user can read."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(text)
