"""`boresight audit`: the hash chain of the audit log."""

from __future__ import annotations

import click

from boresight.cli.refusals import REFUSED
from boresight.settings import read_settings


@click.group()
def audit() -> None:
    """Look after the audit log."""


@audit.command()
@click.option("--head", metavar="HASH", help="A head from an earlier export, which must still be in the chain.")
@click.pass_context
def verify(context: click.Context, head: str | None) -> None:
    """Walk the whole chain; exit code 1 when a record is not as it was written."""
    from boresight.services import audit as chain
    from boresight.store.sessions import migrate, open_engine, reading

    engine = open_engine(read_settings().database_url)
    migrate(engine)
    with reading(engine) as session:
        found = chain.verify(session, head)
    if not found.ok:
        click.echo(f"boresight: {found.sentence}", err=True)
        context.exit(REFUSED)
    click.echo(f"{found.sentence}\nhead {found.head}")
