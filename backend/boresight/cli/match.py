"""`boresight match`: which star each detection is, found anew under any parameters, as a telemetry file of the same rows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from boresight.cli.output import (
    FORMATS,
    STANDARD_OUTPUT,
    aligned,
    check_one_stream,
    check_writable,
    json_option,
    opened_for_writing,
    progress,
    tell,
    write_json,
)
from boresight.errors import RefusedInputError
from boresight.estimation.blocks import computing_on
from boresight.settings import read_settings, use_kernel_folder


@click.command()
@click.argument("telemetry", type=click.Path(path_type=Path))
@click.option("--sensor", "sensor_file", type=click.Path(path_type=Path), required=True, help="Sensor file, JSON.")
@click.option(
    "--parameters", type=click.Path(path_type=Path), help="Calibration JSON, or names and values, to match with."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="File to write: .csv, .jsonl or .parquet; - is standard output, CSV.",
)
@click.option("--leave-out-doubles", is_flag=True, help="Match no double star and none with unreliable astrometry.")
@click.option("--flight", is_flag=True, help="Keep only what the simulated check of the flight code accepts.")
@json_option
def match(telemetry: Path, sensor_file: Path, parameters: Path | None, out: Path, **choices: Any) -> None:
    """Match the stars of TELEMETRY again and write its rows with `star_id` as found (empty = unmatched).

    Every other column stays as it is. With --json every exposure is listed with its attitude and covariance, or the reason
    why it has none.
    """
    check_writable(choices["json_file"])
    check_one_stream(out, choices["json_file"])
    _check_out(telemetry, out)
    use_kernel_folder(read_settings())
    with progress("reading the telemetry") as report, computing_on(read_settings().computing_threads):
        document = _match(telemetry, sensor_file, parameters, out, choices, report)
    write_json(document, choices["json_file"])
    if choices["json_file"] != STANDARD_OUTPUT:
        tell("\n".join(_lines(document)), out)


def _check_out(telemetry: Path, out: Path) -> None:
    """Refuse a place that cannot be written, the input itself, and a suffix that says no format."""
    if str(out) == STANDARD_OUTPUT:
        return
    check_writable(out, FORMATS.get(out.suffix.lower(), ""))
    if out.suffix.lower() not in {".csv", ".jsonl", ".ndjson", ".parquet"}:
        raise RefusedInputError(f"{out.name} says no format: end the name with .csv, .jsonl or .parquet.")
    if out.exists() and telemetry.exists() and out.samefile(telemetry):
        raise RefusedInputError(f"{out} is the telemetry itself, which is never overwritten: choose another name.")


def _match(
    telemetry: Path, sensor_file: Path, parameters: Path | None, out: Path, choices: dict[str, Any], report: Any
) -> dict[str, Any]:
    """Read the files, match, and write the rows again."""
    from boresight.calibration.matching.match_report import match_report, matched_stars
    from boresight.calibration.matching.matched_frames import apply_flight_check
    from boresight.calibration.matching.rematch import ground_covariance, rematch
    from boresight.calibration.options import CalibrationSettings
    from boresight.calibration.parameter_file import read_parameters
    from boresight.sky.catalogue import load_catalogue
    from boresight.telemetry.quality.detector import check_against_sensor
    from boresight.telemetry.read.readers import read_table, read_telemetry, write_with_stars
    from boresight.telemetry.sensors import read_sensor

    settings = CalibrationSettings(match="rematch", leave_out_doubles=choices["leave_out_doubles"])
    sensor, folder = read_sensor(sensor_file), read_settings().catalogue_folder
    x, P = (sensor.initial, None) if parameters is None else read_parameters(parameters, sensor)
    stars = read_telemetry(telemetry, limits=read_settings().telemetry_limits)
    off = check_against_sensor(stars, sensor)
    report("loading the star catalogue")
    catalogue = load_catalogue(folder)
    report("matching the stars")
    P = ground_covariance(sensor, settings.initial_sigma_scale) if P is None else P
    matches = rematch(stars, sensor, catalogue, x, P, settings, folder)
    seen = apply_flight_check(stars, sensor, matches, x, settings) if choices["flight"] else None
    table, found = (
        read_table(telemetry, telemetry.name, read_settings().telemetry_limits),
        matched_stars(matches, seen)[0],
    )
    with opened_for_writing(out) as stream:
        write_with_stars(table, found, stream, out.suffix.lower())
    document = match_report(stars, sensor, matches, seen)
    return document | {"advice": document["advice"] + off.sentences(), "stars_off_detector": off.document()}


def _lines(document: dict[str, Any]) -> Iterator[str]:
    """Lay the counts out for a terminal."""
    keys = ("given", "kept", "changed", "added", "removed", "matched")
    yield f"{document['sensor']}: {document['rows']:,} detections"
    if document["flight_tolerance_rad"] is not None:
        yield f"accepted: arcs that agree within {document['flight_tolerance_rad'] * 1e6:.0f} µrad (simulated flight tolerance)"
    yield ""
    yield aligned([keys, [f"{document[key]:,}" for key in keys]], left=())
    yield ""
    yield f"frames valid: {document['valid_frames']:,} of {document['frames']:,}"
    for sentence in document["advice"]:
        yield f"\n- {sentence}"
    for title, key in (
        ("frames not valid", "frame_reasons"),
        ("given stars removed", "removed_reasons"),
        ("detections without a star", "unmatched_reasons"),
        ("exposures by where their attitude came from", "starts"),
    ):
        if document[key]:
            yield f"\n{title}:"
            yield aligned([(f"  {count:,}", phrase) for phrase, count in document[key].items()], left=(1,))
