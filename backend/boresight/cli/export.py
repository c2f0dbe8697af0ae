"""`boresight export`: the uplink package of a parameter set, from the store of the data folder."""

from __future__ import annotations

import click

from boresight.cli.output import check_writable, tell, write_bytes
from boresight.settings import read_settings


@click.command()
@click.argument("parameter_set")
@click.option("--out", "file", metavar="FILE", required=True, help="The ZIP to write; - is standard output.")
@click.option("--flight-software", help="Version that the spacecraft has; the table is refused for another.")
@click.option("--table-id", help="Table that the spacecraft has; refused for another.")
def export(parameter_set: str, file: str, flight_software: str | None, table_id: str | None) -> None:
    """Write the uplink package of PARAMETER_SET, an approved set or the baseline: PS-<sensor>-<n>, or its number.

    The package holds the parameters, the table as the mission defined it, sheets for people, and the way back. Built
    again of the same set it is the same file.
    """
    check_writable(file, "ZIP")
    from boresight.console.uplinks import packages
    from boresight.platform.actors import COMMAND_LINE
    from boresight.platform.blobs.opening import open_blobs
    from boresight.platform.db.sessions import open_store, open_writing

    settings = read_settings()
    blobs = open_blobs(settings.blob_place)
    with open_store(settings.database_url) as engine, open_writing(engine) as session:
        row = packages.set_named(session, parameter_set)
        package = packages.build(
            session,
            COMMAND_LINE,
            blobs,
            row.id,
            flight_software_version=flight_software,
            table_id=table_id,
            policy=settings.policy,
        )
        content = packages.read(session, blobs, package.id)
    write_bytes(content, file)
    tell(f"{row.name}: {package.sha256}  {file}", file)
    tell(f"back to {package.inputs['backout']['name']}; audit head {package.inputs['first_built']['audit_head']}", file)
