"""`boresight retention`: what the policy for telemetry would remove, why the rest stays, and its removal."""

from __future__ import annotations

import click

from boresight.errors import ConflictError, RefusedInputError
from boresight.settings import read_settings

MB = 1e6


@click.command()
@click.option("--days", type=click.FloatRange(0, min_open=True), help="Days to try instead of those of the policy.")
@click.option("--apply", "is_applied", is_flag=True, help="Remove the files; without it nothing is changed.")
def retention(days: float | None, *, is_applied: bool) -> None:
    """List the telemetry whose files nothing needs after BORESIGHT_TELEMETRY_KEEP_DAYS, and say why the rest stays.

    What a baseline, a parameter set, a request, a run with a result that is not archived, a gate's held-out frames, an alignment or
    a later run's prior rests on always stays. Rows and results stay in any case; a removal is on the audit log.
    """
    import boresight.console  # noqa: F401 - the tables of all nouns, whose rows the log seals
    from boresight.console.retention import service
    from boresight.platform.actors import COMMAND_LINE
    from boresight.platform.blobs.opening import open_blobs
    from boresight.platform.db.sessions import open_reading, open_store

    settings = read_settings()
    keep_days = days or settings.telemetry_keep_days
    if not keep_days:
        raise RefusedInputError("Telemetry is kept for ever here: give --days N, or set BORESIGHT_TELEMETRY_KEEP_DAYS.")
    with open_store(settings.database_url) as engine:
        with open_reading(engine) as session:
            found = service.preview(session, keep_days)
        for one in found.sets:
            click.echo(
                f"{'stays' if one.reason else 'goes ':5}  {one.row.id:>6}  {one.row.name}  {one.reason or ''}".rstrip()
            )
        if not is_applied:
            click.echo(
                f"{len(found.going)} sets would go, {found.going_bytes / MB:.1f} MB; nothing was changed.", err=True
            )
            return
        blobs, freed, gone = open_blobs(settings.blob_place), 0, 0
        for one in found.going:
            try:
                freed += service.remove(engine, blobs, COMMAND_LINE, one.row.id, keep_days)
                gone += 1
            except ConflictError as error:
                click.echo(str(error), err=True)
    click.echo(f"The files of {gone} sets were removed, {freed / MB:.1f} MB.", err=True)
