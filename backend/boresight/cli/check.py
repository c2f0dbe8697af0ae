"""`boresight check`: what a telemetry file is worth, before any run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from boresight.cli.output import aligned, check_writable, json_option, progress, write_json
from boresight.settings import read_settings


@click.command()
@click.argument("telemetry", type=click.Path(path_type=Path))
@click.option("--sensor", "sensor_file", type=click.Path(path_type=Path), required=True, help="Sensor file, JSON.")
@json_option
def check(telemetry: Path, sensor_file: Path, json_file: str | None) -> None:
    """Report on the quality of TELEMETRY: counts, gaps, coverage, magnitudes, matches."""
    from boresight.sky.catalogue import load_catalogue
    from boresight.telemetry.quality.report import QualityParts
    from boresight.telemetry.read.readers import read_chunks
    from boresight.telemetry.sensors import read_sensor

    check_writable(json_file)
    settings = read_settings()
    with progress("reading the telemetry") as report:
        sensor = read_sensor(sensor_file)
        found = QualityParts(sensor, load_catalogue(settings.catalogue_folder))
        for part in read_chunks(telemetry, limits=settings.telemetry_limits):
            found.add(part)
            report(f"reading the telemetry, up to frame {part.frame[-1]}")
        quality = found.report()
    write_json(quality, json_file)
    if json_file != "-":
        click.echo(aligned(list(_rows(quality)), left=(0, 1)))
        for finding in quality["findings"]:
            click.echo(f"\n{finding['severity']}: {finding['sentence']}")


def _rows(document: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Walk the report as lines of name and value; long tables of numbers stay in the JSON."""
    for key, value in document.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _rows(value, f"{name}.")
        elif isinstance(value, list) and value and isinstance(value[0], str):
            yield from ((name if i == 0 else "", line) for i, line in enumerate(value))
        elif not isinstance(value, list):
            yield name, _text(value)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,.6g}" if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else str(value)
