"""`boresight migrate`: the database's schema, forwards and back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from boresight.errors import ConflictError
from boresight.settings import read_settings

if TYPE_CHECKING:
    from boresight.store.sessions import Engine


@click.command()
@click.option("--down", "revision", metavar="REV", help="Go back to this revision; base removes every table.")
@click.option("--yes", is_flag=True, help="Go back although rows are removed by it; needs --backup.")
@click.option("--backup", metavar="FILE", help="A backup that was made after the last change.")
def migrate(revision: str | None, backup: str | None, *, yes: bool) -> None:
    """Bring the database's schema up to date, or back to a revision.

    The way back says what it would remove. Where that is anything, it wants --yes, and a backup of the database as it is now.
    """
    from boresight.services.webhook_secrets import encrypt_all
    from boresight.store import sessions

    settings = read_settings()
    engine = sessions.open_engine(settings.database_url)
    try:
        before = sessions.current_revision(engine)
        if revision is None:
            sessions.migrate(engine)
            encrypt_all(engine, settings.secret_box)
        else:
            _refuse_loss(engine, revision, backup, yes=yes)
            sessions.downgrade(engine, revision)
        after = sessions.current_revision(engine)
    finally:
        engine.dispose()
    click.echo(f"schema {before or 'empty'} -> {after or 'empty'}")


def _refuse_loss(engine: Engine, revision: str, backup: str | None, *, yes: bool) -> None:
    """Say what the way back removes, and refuse it unless that was agreed to and there is a backup of just now.

    Raises
    ------
    ConflictError
        When `--yes` or the backup is missing, or the backup is not of the database as it is.
    """
    from boresight.store import backup as backups
    from boresight.store import sessions

    lost = sessions.losses(engine, revision)
    for loss in lost:
        click.echo(f"removes {loss}")
    if not lost:
        return
    if not yes or backup is None:
        raise ConflictError(
            f"Nothing was changed: going back to {revision} removes the above. Make a backup with `boresight backup --out FILE`, "
            "and agree with --yes --backup FILE."
        )
    if not backups.is_of_now(Path(backup), engine):
        raise ConflictError(
            f"Nothing was changed: {backup} is older than the last change of the database, or of another one; make a new backup."
        )
