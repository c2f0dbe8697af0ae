"""`boresight table`: the table on board without a store, parameters to bytes and bytes to parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from boresight.cli.output import REFUSED, aligned, check_writable, tell, write_bytes

SENSOR = click.option("--sensor", "sensor_file", type=click.Path(path_type=Path), required=True, help="Sensor file.")
DEFINITION = click.option(
    "--definition", "definition_file", type=click.Path(path_type=Path), required=True, help="Table definition, JSON."
)


@click.group()
def table() -> None:
    """Turn camera parameters into the bytes of a table on board, and back."""


@table.command()
@click.argument("parameters", type=click.Path(path_type=Path))
@SENSOR
@DEFINITION
@click.option("--out", "file", metavar="FILE", required=True, help="The image to write; - is standard output.")
def encode(parameters: Path, sensor_file: Path, definition_file: Path, file: str) -> None:
    """Lay PARAMETERS, a calibration JSON or names and values, into the table."""
    check_writable(file, "")
    from boresight.calibration.parameter_file import read_parameters
    from boresight.cameras import CAMERA_MODELS
    from boresight.telemetry.sensors import read_sensor
    from boresight.uplink import table_definition

    sensor = read_sensor(sensor_file)
    definition = table_definition.read_definition(definition_file, sensor)
    camera = CAMERA_MODELS[sensor.camera_model]
    values = dict(zip(camera.parameter_names, read_parameters(parameters, sensor)[0].tolist(), strict=True))
    image = table_definition.encode(definition, values)
    held = table_definition.quantised(definition, values)
    effect = table_definition.quantisation_effect(camera, sensor, values, held)
    write_bytes(image, file)
    tell(_shown(definition, image), file)
    tell(f"rounding moves a star by at most {effect['max_px']:.3g} px, {effect['max_arcsec']:.3g} arcsec", file)


@table.command()
@click.argument("image", type=click.Path(path_type=Path))
@SENSOR
@DEFINITION
@click.pass_context
def decode(context: click.Context, image: Path, sensor_file: Path, definition_file: Path) -> None:
    """Read IMAGE as the flight software does; exit code 1 when its CRC is not that of its bytes."""
    from boresight.telemetry.read.formats import read_bytes
    from boresight.telemetry.sensors import read_sensor
    from boresight.uplink import cfe, table_definition

    definition = table_definition.read_definition(definition_file, read_sensor(sensor_file))
    content = cfe.table_image(definition.cfe, definition.length_bytes, read_bytes(image, image.name))
    click.echo(_shown(definition, content))
    if table_definition.decode(definition, content).crc_ok is False:
        click.echo(f"boresight: the stored CRC of {image.name} is not that of its bytes.", err=True)
        context.exit(REFUSED)


def _shown(definition: Any, content: bytes) -> str:
    """Lay out every field, and the CRC."""
    from boresight.uplink.table_definition import decode

    decoded = decode(definition, content)
    rows = [("field", "byte", "type", "hex", "value")]
    for one in decoded.fields:
        field = one.field
        byte = f"{field.bit // 8}" if field.bit % 8 == 0 else f"{field.bit // 8} bit {field.bit % 8}"
        rows.append((field.name, byte, field.kind, one.hexadecimal, f"{one.value!r}"))
    crc = "" if definition.crc is None else f"\n{definition.crc.name} {definition.crc.text(decoded.crc)}"
    return f"{aligned(rows)}{crc}"
