"""`boresight user`, `webhook`, `certificates`, `migrate` and `retention`: the administration of an installation."""

from __future__ import annotations

import os
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.shell_completion import CompletionItem

from boresight.errors import ConflictError, RefusedInputError
from boresight.settings import read_settings

MB = 1e6


def _complete_role(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete the name of a role."""
    from boresight.console.access.tables import ROLES

    return [CompletionItem(role) for role in ROLES if role.startswith(incomplete)]


@click.group()
def user() -> None:
    """Manage people who can log in."""


@user.command()
@click.argument("name")
@click.option(
    "--role",
    "roles",
    multiple=True,
    required=True,
    shell_complete=_complete_role,
    help="analyst, approver, ...; repeat it for several.",
)
@click.option("--printed-name", required=True, help="As signatures show it.")
@click.option("--password-stdin", is_flag=True, help="Read the password from standard input instead of asking.")
def add(name: str, roles: tuple[str, ...], printed_name: str, *, password_stdin: bool) -> None:
    """Add the person with the log-in NAME.

    Roles: viewer, analyst (uploads, launches, submits), operator (promotes, records uplinks), approver (signs),
    administrator (people and keys; cannot sign).
    """
    password = _password(from_stdin=password_stdin)
    from boresight.console.access import users
    from boresight.console.access.passwords import prepare
    from boresight.platform.actors import COMMAND_LINE
    from boresight.platform.db.sessions import open_store, open_writing

    prepared = prepare(password, name, printed_name)
    with open_store(read_settings().database_url) as engine, open_writing(engine) as session:
        made = users.create_user(
            session, COMMAND_LINE, name=name, printed_name=printed_name, password=prepared, roles=roles
        )
        click.echo(f"Added {made.name} ({made.printed_name}): {', '.join(made.roles)}")


@user.command(name="reset-second-factor")
@click.argument("name")
def reset_second_factor(name: str) -> None:
    """Remove every second factor of the person with the log-in NAME, and end their log-ins.

    Use this if the only administrator has lost their second factor. Otherwise another administrator can do it on the page Users
    and keys.
    """
    from boresight.console.access import queries, second_factors
    from boresight.platform.actors import COMMAND_LINE
    from boresight.platform.db.sessions import open_store, open_writing
    from boresight.platform.web.text_validation import comparison_key

    with open_store(read_settings().database_url) as engine, open_writing(engine) as session:
        found = queries.find_user(session, name, comparison_key(name))
        if found is None:
            raise RefusedInputError(f"Nobody has the log-in name {name!r}; check how it is written.")
        click.echo(f"The second factors of {second_factors.reset(session, COMMAND_LINE, found.id).name} were removed.")


def _password(*, from_stdin: bool) -> str:
    if not from_stdin:
        return str(click.prompt("Password", hide_input=True, confirmation_prompt=True, err=True))
    password = sys.stdin.readline().rstrip("\r\n")
    if not password:
        raise RefusedInputError("Standard input contains no password: pipe one line to --password-stdin.")
    return password


@click.group()
def webhook() -> None:
    """Manage webhooks."""


@webhook.command(name="rotate-key")
@click.option("--forget-old", is_flag=True, help="Also remove the previous keys (older backups need them).")
def rotate_key(*, forget_old: bool) -> None:
    """Create a new key and encrypt every secret of webhooks, authenticator apps and message addresses with it.

    Servers that share the file keep working. Secrets that no key here can decrypt stay as they are.
    """
    from boresight.console.access import second_factors
    from boresight.console.messages.service import encrypt_anew as encrypt_addresses
    from boresight.console.webhooks.secrets import encrypt_all, encrypt_anew
    from boresight.platform.db.sessions import open_store, open_writing

    settings = read_settings()
    box = settings.secret_box
    with open_store(settings.database_url) as engine:
        kept = encrypt_all(engine, box)
        box.add_key()
        with open_writing(engine) as session:
            count = encrypt_anew(session, box)
            factors = second_factors.encrypt_anew(session, box)
            addresses = encrypt_addresses(session, box)
    forgotten = box.forget_old_keys() if forget_old else 0
    click.echo(
        f"{box.file}: encrypted with a new key: {count} webhook secret{'s' * (count != 1)}, {factors} authenticator "
        f"app{'s' * (factors != 1)}, {addresses} message address{'es' * (addresses != 1)}; old keys removed: {forgotten}."
    )
    if kept.sentence is not None:
        click.echo(kept.sentence, err=True)


AUTHORITY, CERTIFICATE = "authority.pem", "boresight.pem"
CLOCKS_DIFFER = timedelta(days=1)


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--days", type=click.IntRange(1, 36_500), default=3650, show_default=True, help="Days that it is valid.")
def certificates(folder: Path, days: int) -> None:
    """Make a certificate for tls:// links, and the authority that signed it, in FOLDER.

    The authority's key is not kept, so it can never sign another certificate: copy both files to every machine of the
    cluster and nowhere else, because whoever has boresight.pem can run programs on all of them.
    """
    from boresight.workers.security import issue

    now = datetime.now(UTC)
    made = issue(now - CLOCKS_DIFFER, now + timedelta(days=days))
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _write(folder / AUTHORITY, made.authority)
        _write(folder / CERTIFICATE, made.certificate + made.key)
    except FileExistsError as error:
        raise RefusedInputError(
            f"{error.filename} already exists, and links that use it would break: name another folder, or remove it first."
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


if TYPE_CHECKING:
    from boresight.platform.backups.encryption import KeyFile
    from boresight.platform.db.sessions import Engine


@click.command()
@click.option("--down", "revision", metavar="REV", help="Go back to this revision; base removes every table.")
@click.option("--yes", is_flag=True, help="Go back even though this removes rows; needs --backup.")
@click.option("--backup", metavar="FILE", help="A backup made after the last change.")
def migrate(revision: str | None, backup: str | None, *, yes: bool) -> None:
    """Bring the database's schema up to date, or back to a revision.

    Going back first lists what it would remove. If that is anything, it needs --yes and a backup of the database as it is now.
    """
    from boresight.console.webhooks.secrets import encrypt_all
    from boresight.platform.db import sessions

    settings = read_settings()
    engine = sessions.open_engine(settings.database_url)
    keys = settings.backup_keys
    try:
        before = sessions.current_revision(engine)
        if revision is None:
            sessions.migrate(engine)
            encrypt_all(engine, settings.secret_box)
        else:
            _refuse_loss(engine, revision, backup, keys, yes=yes)
            sessions.downgrade(engine, revision)
        after = sessions.current_revision(engine)
    finally:
        engine.dispose()
    click.echo(f"schema {before or 'empty'} -> {after or 'empty'}")


def _refuse_loss(engine: Engine, revision: str, backup: str | None, keys: KeyFile, *, yes: bool) -> None:
    """Print what the downgrade removes, and refuse it without consent and a current backup."""
    from boresight.platform.db import backup as backups
    from boresight.platform.db import sessions

    lost = sessions.list_downgrade_losses(engine, revision)
    for loss in lost:
        click.echo(f"removes {loss}")
    if not lost:
        return
    if not yes or backup is None:
        raise ConflictError(
            f"Nothing was changed: going back to {revision} removes the above. Make a backup with `boresight backup --out FILE`, "
            "and confirm with --yes --backup FILE."
        )
    if not backups.is_of_now(Path(backup), engine, keys):
        raise ConflictError(
            f"Nothing was changed: {backup} is older than the last change to the database, or belongs to another database; make a "
            "new backup."
        )


@click.command()
@click.option("--days", type=click.FloatRange(0, min_open=True), help="Number of days to use instead of the policy's.")
@click.option("--apply", "is_applied", is_flag=True, help="Remove the files; if omitted, nothing is changed.")
def retention(days: float | None, *, is_applied: bool) -> None:
    """List telemetry whose files are no longer needed after BORESIGHT_TELEMETRY_KEEP_DAYS, and say why the rest is kept.

    Telemetry is always kept if it is used by a baseline, a parameter set, a request, an unarchived run with a result, a gate's
    held-out frames, an alignment or the prior of a later run. Database rows and results are always kept; removals are recorded
    in the audit log.
    """
    import boresight.console  # noqa: F401 - the tables of all nouns, whose rows the log seals
    from boresight.console.retention import service
    from boresight.platform.actors import COMMAND_LINE
    from boresight.platform.blobs.opening import open_blobs
    from boresight.platform.db.sessions import open_reading, open_store

    settings = read_settings()
    keep_days = days or settings.telemetry_keep_days
    if not keep_days:
        raise RefusedInputError("Telemetry is kept forever here: give --days N, or set BORESIGHT_TELEMETRY_KEEP_DAYS.")
    with open_store(settings.database_url) as engine:
        with open_reading(engine) as session:
            found = service.preview(session, keep_days)
        for one in found.sets:
            click.echo(
                f"{'keep' if one.reason else 'remove':6}  {one.row.id:>6}  {one.row.name}  {one.reason or ''}".rstrip()
            )
        if not is_applied:
            click.echo(
                f"{len(found.going)} sets would be removed, {found.going_bytes / MB:.1f} MB; nothing was changed.",
                err=True,
            )
            return
        blobs, freed, gone = open_blobs(settings.blob_location), 0, 0
        for one in found.going:
            try:
                freed += service.remove(engine, blobs, COMMAND_LINE, one.row.id, keep_days)
                gone += 1
            except ConflictError as error:
                click.echo(str(error), err=True)
    click.echo(f"The files of {gone} sets were removed, {freed / MB:.1f} MB.", err=True)
