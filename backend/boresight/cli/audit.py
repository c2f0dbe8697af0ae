"""`boresight audit`: the audit log verified, exported and signed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from boresight.cli.output import REFUSED, STANDARD_OUTPUT, check_writable, opened_for_writing
from boresight.errors import ConflictError, RefusedInputError
from boresight.settings import read_settings

if TYPE_CHECKING:
    from boresight.platform.db.sessions import Engine


@click.group()
def audit() -> None:
    """Manage the audit log."""


@audit.command()
@click.option(
    "--head", metavar="HASH", help="Head from an earlier export; the command fails if it is no longer in the chain."
)
@click.option(
    "--public-keys",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Public keys (PEM) that you kept; anchors by any other key count as forged. If omitted, those in the key file are used.",
)
@click.option("--no-blobs", is_flag=True, help="Skip the stored files; otherwise every one of them is read.")
@click.pass_context
def verify(context: click.Context, head: str | None, public_keys: Path | None, *, no_blobs: bool) -> None:
    """Check the chain, its anchors, every row that it seals and every stored file; exit code 1 if any of them was altered.

    The head that the server stores in BORESIGHT_AUDIT_HEAD_FILE must exist and be in the chain.
    """
    import boresight.console  # noqa: F401 - the tables of all nouns, whose rows the log seals
    from boresight.platform.audit import log as chain
    from boresight.platform.audit.anchors import TrustedKeys
    from boresight.platform.audit.external_head import read_head
    from boresight.platform.audit.signing import read_public_keys
    from boresight.platform.blobs.opening import open_blobs
    from boresight.platform.db.sessions import open_engine, open_reading

    settings = read_settings()
    service = settings.time_stamps
    if public_keys is None:
        keys, source = settings.own_key.list_public_keys(), settings.own_key.name
    else:
        keys, source = read_public_keys(public_keys.read_text(), public_keys), str(public_keys)
    trust = TrustedKeys(keys, source, () if service is None else service.authorities)
    engine = open_engine(settings.database_url)
    try:
        _require_schema(engine)  # without migrating, which could fail on the very defects to be reported
        with open_reading(engine) as session:
            file = settings.kept_head_file
            kept = None if file is None else read_head(file)
            blobs = None if no_blobs else open_blobs(settings.blob_location)
            found = chain.verify(session, head, blobs, kept=kept, head_file=file, trust=trust)
    finally:
        engine.dispose()
    if not found.ok:
        click.echo(f"boresight: {found.sentence}", err=True)
        for bad in found.bad_files[1:]:
            click.echo(f"  {bad}", err=True)
        context.exit(REFUSED)
    click.echo(f"{found.sentence}\nhead {found.head}")


def _require_schema(engine: Engine) -> None:
    from boresight.platform.db.sessions import current_revision, head_revision

    found, known = current_revision(engine), head_revision()
    if found is None:
        raise ConflictError(
            "This database has no tables yet; check its address, or create them with `boresight migrate`."
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
    """Write the whole log to FILE, so that others can keep it and verify it without Boresight."""
    form = "jsonl" if file == STANDARD_OUTPUT or Path(file).suffix.lower() == ".jsonl" else "zip"
    check_writable(file, "JSON Lines" if form == "jsonl" else "ZIP")
    import boresight.console  # noqa: F401 - the tables of all nouns, whose rows the log seals
    from boresight.platform.audit.export import write_export
    from boresight.platform.db.sessions import open_reading, open_store

    settings = read_settings()
    with (
        open_store(settings.database_url) as engine,
        open_reading(engine) as session,
        opened_for_writing(file) as stream,
    ):
        write_export(session, stream, form, settings.policy)
    if file != STANDARD_OUTPUT:
        click.echo(file)


@audit.command()
def anchor() -> None:
    """Sign the newest head now, and have it time-stamped where a service is set."""
    import boresight.console  # noqa: F401 - the tables of all nouns, whose rows the log seals
    from boresight.console.audit.service import anchor_now
    from boresight.console.jobs.anchoring import Anchoring
    from boresight.platform.actors import COMMAND_LINE
    from boresight.platform.audit import log as chain
    from boresight.platform.db.sessions import open_reading, open_store, open_writing

    settings = read_settings()
    with open_store(settings.database_url) as engine:
        anchoring = Anchoring(engine, settings.own_key, settings.time_stamps, 0.0)
        with open_reading(engine) as session:
            found = chain.verify(session, trust=anchoring.trust())
        with open_writing(engine) as session:
            anchor_now(session, COMMAND_LINE, anchoring.key, "" if found.ok else found.sentence)
        anchoring.stamp()
        with open_reading(engine) as session:
            made = chain.list_anchors(session, limit=1)[0]
    stamped = "" if made.stamped_utc is None else f", time-stamped {made.stamped_utc}"
    click.echo(f"Anchor {made.id} signs record {made.record_id} with the key {made.key}{stamped}.\nhead {made.head}")


@audit.command()
@click.option("--out", "file", metavar="FILE", default=STANDARD_OUTPUT, help="The PEM file to write.")
def keys(file: str) -> None:
    """Write the public keys that verify anchors and uplink packages, the current one first; keep them where those are verified."""
    own = read_settings().own_key
    own.load()  # made, where nothing was signed yet: it can be given away before
    with opened_for_writing(file) as stream:
        stream.write("".join(key.pem for key in own.list_public_keys()).encode())


@audit.command(name="rotate-key")
def rotate_key() -> None:
    """Create a new signing key.

    Only the public part of the previous key is kept, so that its signatures can still be verified.
    """
    import boresight.console  # noqa: F401 - the tables of all nouns, whose rows the log seals
    from boresight.platform.actors import COMMAND_LINE
    from boresight.platform.audit import log as chain
    from boresight.platform.db.sessions import open_store, open_writing

    settings = read_settings()
    own = settings.own_key
    with open_store(settings.database_url) as engine, open_writing(engine) as session:
        before = next((key.id for key in own.list_public_keys()), None)
        made = own.rotate()
        told = {"key": made.id, "public_key": made.text}
        chain.append(session, COMMAND_LINE, "rotated", "signing-key", {"key": before}, told)
    click.echo(
        f"{own.name}: from now on, key {made.id} signs. Give its public key (`boresight audit keys`) to everyone who verifies."
    )


@audit.command()
@click.argument("public_key")
def trust(public_key: str) -> None:
    """Add PUBLIC_KEY, base64 as shown with an anchor, to the key file.

    What the lost private key signed can then be verified.
    """
    from boresight.platform.audit.signing import PublicKey

    own = read_settings().own_key
    try:
        key = PublicKey.decode(public_key)
        own.trust(key)
    except ValueError as error:
        raise RefusedInputError(
            f"{public_key!r} is not a public key: give the 44 characters shown with an anchor."
        ) from error
    click.echo(f"{own.name}: signatures by key {key.id} are trusted; the key is no longer used to sign.")
