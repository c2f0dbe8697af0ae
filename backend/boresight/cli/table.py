"""`boresight export` and `table`: the uplink package of a parameter set, and the table on board without a store."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import click

from boresight.cli.input import INPUT_FILE
from boresight.cli.output import REFUSED, check_writable, tell, write_bytes
from boresight.cli.remote import find_set, open_client, server_option
from boresight.library.text import aligned
from boresight.settings import read_settings


@click.command()
@click.argument("parameter_set")
@click.option("--out", "file", metavar="FILE", required=True, help="The ZIP to write; - is standard output.")
@click.option(
    "--flight-software", help="Flight software version on board; the command fails if the table is for another version."
)
@click.option("--table-id", help="Table ID on board; the command fails if it differs.")
@server_option
def export(
    parameter_set: str, file: str, flight_software: str | None, table_id: str | None, server_url: str | None
) -> None:
    """Write the uplink package of PARAMETER_SET, an approved set or the baseline: PS-<sensor>-<n>, or its number.

    The package contains the parameters, the table in the format that the mission defined, verification sheets, and the
    back-out. Rebuilding the package of the same set gives an identical file.
    """
    check_writable(file, "ZIP")
    if server_url is not None:
        with open_client(server_url) as server:
            named = find_set(server, parameter_set)
            content = server.export(named, flight_software_version=flight_software, table_id=table_id)
        write_bytes(content, file)
        tell(f"{named.name}: {hashlib.sha256(content).hexdigest()}  {file}", file)
        return
    from boresight.console.uplinks import packages
    from boresight.platform.actors import COMMAND_LINE
    from boresight.platform.blobs.opening import open_blobs
    from boresight.platform.db.sessions import open_reading, open_store, open_writing

    settings = read_settings()
    blobs = open_blobs(settings.blob_location)
    policy, said = settings.policy, {"flight_software_version": flight_software, "table_id": table_id}
    with open_store(settings.database_url) as engine:
        with open_reading(engine) as session:
            row = packages.set_named(session, parameter_set)
            made = packages.prepare(session, COMMAND_LINE, blobs, row.id, policy=policy, key=settings.own_key)
        with open_writing(engine) as session:
            package = packages.build(session, COMMAND_LINE, blobs, row.id, made, policy=policy, **said)
            content = packages.read(session, blobs, package.id)
    write_bytes(content, file)
    tell(f"{row.name}: {package.sha256}  {file}", file)
    tell(f"back to {package.inputs['backout']['name']}; audit head {package.inputs['first_built']['audit_head']}", file)


SENSOR = click.option("--sensor", "sensor_file", type=INPUT_FILE, required=True, help="Sensor file.")
DEFINITION = click.option(
    "--definition", "definition_file", type=INPUT_FILE, required=True, help="Table definition, JSON."
)


@click.group()
def table() -> None:
    """Convert camera parameters to the bytes of a table on board, and back."""


@table.command()
@click.argument("parameters", type=INPUT_FILE)
@SENSOR
@DEFINITION
@click.option(
    "--alignment", type=INPUT_FILE, help="Alignment JSON, for a table that contains one; made with PARAMETERS."
)
@click.option("--out", "file", metavar="FILE", required=True, help="The image to write; - is standard output.")
def encode(parameters: Path, sensor_file: Path, definition_file: Path, alignment: Path | None, file: str) -> None:
    """Write PARAMETERS, a calibration JSON or names and values, into the table."""
    check_writable(file, "")
    from boresight.calibration.alignment.result import check_loaded, parse_alignment
    from boresight.calibration.parameter_file import read_document, read_parameters
    from boresight.cameras import CAMERA_MODELS
    from boresight.telemetry.sensors import read_sensor
    from boresight.uplink import table_definition

    sensor = read_sensor(sensor_file)
    definition = table_definition.read_definition(definition_file, sensor)
    camera = CAMERA_MODELS[sensor.camera_model]
    values = dict(zip(camera.parameter_names, read_parameters(parameters, sensor)[0].tolist(), strict=True))
    turn = None
    if alignment is not None:
        found = parse_alignment(read_document(alignment, "an alignment"), alignment.name)
        check_loaded(found, sensor.name, values)
        turn = table_definition.alignment_numbers(found.to_load.quaternion)
    image = table_definition.encode(definition, values, turn)
    held = table_definition.quantised(definition, values)
    effect = table_definition.quantisation_effect(camera, sensor, values, held)
    write_bytes(image, file)
    tell(_format_fields(definition, image), file)
    tell(f"rounding moves a star by at most {effect['max_px']:.3g} px, {effect['max_arcsec']:.3g} arcsec", file)


@table.command()
@click.argument("image", type=INPUT_FILE)
@SENSOR
@DEFINITION
@click.pass_context
def decode(context: click.Context, image: Path, sensor_file: Path, definition_file: Path) -> None:
    """Read IMAGE as the flight software does; exit code 1 if its CRC does not match its bytes."""
    from boresight.telemetry.read.formats import read_bytes
    from boresight.telemetry.sensors import read_sensor
    from boresight.uplink import cfe, table_definition

    definition = table_definition.read_definition(definition_file, read_sensor(sensor_file))
    content = cfe.table_image(definition.cfe, definition.length_bytes, read_bytes(image, image.name))
    click.echo(_format_fields(definition, content))
    if table_definition.decode(definition, content).crc_ok is False:
        click.echo(f"boresight: the stored CRC of {image.name} does not match its bytes.", err=True)
        context.exit(REFUSED)


def _format_fields(definition: Any, content: bytes) -> str:
    from boresight.uplink.table_definition import decode

    decoded = decode(definition, content)
    rows = [("field", "byte", "type", "hex", "value")]
    for one in decoded.fields:
        field = one.field
        byte = f"{field.bit // 8}" if field.bit % 8 == 0 else f"{field.bit // 8} bit {field.bit % 8}"
        rows.append((field.name, byte, field.kind, one.hexadecimal, f"{one.value!r}"))
    crc = "" if definition.crc is None else f"\n{definition.crc.name} {definition.crc.text(decoded.crc)}"
    return f"{aligned(rows)}{crc}"
