"""`boresight migrate`: the database's schema, forwards and back."""

from __future__ import annotations

import click

from boresight.settings import read_settings


@click.command()
@click.option("--down", "revision", metavar="REV", help="Go back to this revision; base removes every table.")
def migrate(revision: str | None) -> None:
    """Bring the database's schema up to date, or back to a revision."""
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
            sessions.downgrade(engine, revision)
        after = sessions.current_revision(engine)
    finally:
        engine.dispose()
    click.echo(f"schema {before or 'empty'} -> {after or 'empty'}")
