"""`boresight audit`: the hash chain of the audit log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from boresight.cli.output import STANDARD_OUTPUT, check_writable, opened_for_writing
from boresight.cli.refusals import REFUSED
from boresight.errors import ConflictError
from boresight.settings import read_settings

if TYPE_CHECKING:
    from boresight.store.sessions import Engine


@click.group()
def audit() -> None:
    """Look after the audit log."""


@audit.command()
@click.option("--head", metavar="HASH", help="A head from an earlier export, which must still be in the chain.")
@click.option("--no-blobs", is_flag=True, help="Leave the stored files out; otherwise every one of them is read.")
@click.pass_context
def verify(context: click.Context, head: str | None, *, no_blobs: bool) -> None:
    """Walk the whole chain, every row that it seals and every stored file; exit code 1 when one is not as it was written.

    The head that the server keeps in BORESIGHT_AUDIT_HEAD_FILE must be there, and in the chain.
    """
    from boresight.services import audit as chain
    from boresight.services.kept_heads import read_head
    from boresight.store.blobs import open_blobs
    from boresight.store.sessions import open_engine, reading

    settings = read_settings()
    engine = open_engine(settings.database_url)
    try:
        _require_schema(engine)  # and change nothing: a migration may stumble over what is to be named here
        with reading(engine) as session:
            file = settings.kept_head_file
            kept = None if file is None else read_head(file)
            blobs = None if no_blobs else open_blobs(settings.blob_place)
            found = chain.verify(session, head, blobs, kept=kept, head_file=file)
    finally:
        engine.dispose()
    if not found.ok:
        click.echo(f"boresight: {found.sentence}", err=True)
        for bad in found.bad_files[1:]:
            click.echo(f"  {bad}", err=True)
        context.exit(REFUSED)
    click.echo(f"{found.sentence}\nhead {found.head}")


def _require_schema(engine: Engine) -> None:
    """Refuse a schema that is not this version's.

    Raises
    ------
    ConflictError
        When there are no tables yet, or they are of another version.
    """
    from boresight.store.sessions import current_revision, head_revision

    found, known = current_revision(engine), head_revision()
    if found is None:
        raise ConflictError(
            "This database has no tables yet; check its address, or make them with `boresight migrate`."
        )
    if found != known:
        raise ConflictError(
            f"The database has schema {found}, and this version of Boresight verifies {known}: keep a backup and run "
            "`boresight migrate` first, or verify with the version that wrote it."
        )


@audit.command()
@click.option(
    "--out",
    "file",
    metavar="FILE",
    required=True,
    help="A .zip with the verifier, or the .jsonl alone; - is standard output, .jsonl.",
)
def export(file: str) -> None:
    """Write the whole log to FILE, for others to keep and to verify without Boresight."""
    form = "jsonl" if file == STANDARD_OUTPUT or Path(file).suffix.lower() == ".jsonl" else "zip"
    check_writable(file, "JSON Lines" if form == "jsonl" else "ZIP")
    from boresight.services.audit_export import write_export
    from boresight.store.sessions import opened, reading

    settings = read_settings()
    with opened(settings.database_url) as engine, reading(engine) as session, opened_for_writing(file) as stream:
        write_export(session, stream, form, settings.policy)
    if file != STANDARD_OUTPUT:
        click.echo(file)
