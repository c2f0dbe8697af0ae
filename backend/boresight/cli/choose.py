"""`boresight choose`: which camera model, with which free parameters, a telemetry set asks for."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from boresight.cli.calibrate import chosen, parse_settings, setting_option
from boresight.cli.input import INPUT_FILE
from boresight.cli.output import STANDARD_OUTPUT, check_one_stream, check_writable, json_option, write_json
from boresight.cli.remote import first_message, open_client, server_option
from boresight.cli.sensor import place_sensor, refuse_site_on_server, site_option
from boresight.errors import RefusedInputError
from boresight.library import functions as library
from boresight.library.progress import progress
from boresight.library.text import aligned, camera_rows, written

if TYPE_CHECKING:
    from boresight.calibration.choice.result import Choice, TermTest


@click.command()
@click.argument("telemetry", type=INPUT_FILE)
@click.option("--sensor", "sensor_file", type=INPUT_FILE, required=True, help="Sensor file, JSON.")
@site_option
@click.option(
    "--validate",
    type=INPUT_FILE,
    help="Telemetry to compare the candidate models on; held-out frames of TELEMETRY if omitted.",
)
@setting_option("match")
@setting_option("minimum_stars")
@click.option(
    "--out", "out_file", metavar="FILE", help="Write the sensor file with the chosen camera and its parameters."
)
@server_option
@json_option
def choose(
    telemetry: Path,
    sensor_file: Path,
    site: str | None,
    validate: Path | None,
    out_file: str | None,
    server_url: str | None,
    json_file: str | None,
    **choices: Any,
) -> None:
    """Choose the simplest camera model that suffices for TELEMETRY: every model and its terms are tested on the same stars.

    Prints the choice in a sentence, the simplest sufficient candidate of each camera model, and the test of every term.

    With --server the files are uploaded and calibrated there, the choice is made for that run, and its JSON is returned; --sensor
    may be the name of a sensor of that server.
    """
    check_one_stream(out_file, json_file)
    for place in (out_file, json_file):
        check_writable(place)
    if out_file is not None and sensor_file.exists() and Path(out_file).exists() and sensor_file.samefile(out_file):
        raise RefusedInputError(
            f"{out_file} is an input file and will not be overwritten: choose another name.",
            code="would-overwrite",
        )
    refuse_site_on_server(site, server_url)
    settings = chosen(choices)
    parse_settings(settings)
    with progress(first_message(server_url)) as report:
        if server_url is None:
            sensor = library.read_sensor(place_sensor(sensor_file, site))
            found = library.choose(telemetry, sensor, validate=validate, progress=report, **settings)
        else:
            with open_client(server_url) as server:
                known = server.sensor(str(sensor_file))
                sensor = library.read_sensor(known.document)
                found = server.choose(telemetry, known, validate=validate, progress=report, **settings)
    write_json(found.to_dict(), json_file)
    if out_file is not None:
        from boresight.telemetry.sensors import sensor_document

        write_json(sensor_document(found.describe_sensor(sensor)), out_file)
    if STANDARD_OUTPUT not in {json_file, out_file}:
        click.echo("\n".join(_lines(found)))


def _lines(found: Choice) -> Iterator[str]:
    yield f"{found.sensor}: {found.frames:,} frames, {found.stars:,} stars, {found.arcs:,} arcs"
    yield ""
    yield found.sentence
    yield ""
    yield aligned(list(camera_rows(found)), left=(0, 1))
    yield ""
    yield aligned(list(_terms(found)), left=(0, 1))
    for sentence in found.advice:
        yield f"\n- {sentence}"


def _terms(found: Choice) -> Iterator[tuple[str, ...]]:
    """Return the table of tests: the terms that are needed, then those that are not."""
    yield "", "term of the chosen camera", "chi2 drop", "df", "p, corrected", "held-out RMS", "change px", "± 3σ"
    for word, tests in (("needed", found.needed), ("beyond", found.beyond)):
        for one in tests:
            yield word, *_tested(one)


def _tested(one: TermTest) -> tuple[str, ...]:
    from boresight.calibration.choice.result import write_p

    return (
        " + ".join(one.terms),
        f"{one.chi2_difference:.1f}",
        str(one.df),
        write_p(one.log10_p_corrected),
        "-" if one.held_out_ratio is None else f"{100 * (one.held_out_ratio - 1):+.2f} %",
        written(one.change_px, ".3f"),
        written(one.change_3_sigma_px, ".3f"),
    )
