"""`boresight choose`: which camera model, with which free parameters, a telemetry set asks for."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from boresight.cli.calibrate import chosen, parse_settings, setting_option
from boresight.cli.output import (
    STANDARD_OUTPUT,
    aligned,
    check_one_stream,
    check_writable,
    json_option,
    progress,
    write_json,
)
from boresight.errors import RefusedInputError
from boresight.estimation.blocks import computing_on
from boresight.settings import read_settings, use_kernel_folder

if TYPE_CHECKING:
    from boresight.calibration.choice.result import Choice, Model, TermTest


@click.command()
@click.argument("telemetry", type=click.Path(path_type=Path))
@click.option("--sensor", "sensor_file", type=click.Path(path_type=Path), required=True, help="Sensor file, JSON.")
@click.option(
    "--validate",
    type=click.Path(path_type=Path),
    help="Telemetry that candidates are held out against; left out, frames of TELEMETRY are.",
)
@setting_option("match")
@setting_option("minimum_stars")
@click.option(
    "--out", "out_file", metavar="FILE", help="Write the sensor file with the chosen camera and what it found."
)
@json_option
def choose(
    telemetry: Path,
    sensor_file: Path,
    validate: Path | None,
    out_file: str | None,
    json_file: str | None,
    **choices: Any,
) -> None:
    """Choose the least camera model that suffices for TELEMETRY: every model and its terms, tested on the same stars.

    Prints the choice in a sentence, each camera's least sufficient candidate, and the test of every term.
    """
    check_one_stream(out_file, json_file)
    for place in (out_file, json_file):
        check_writable(place)
    if out_file is not None and sensor_file.exists() and Path(out_file).exists() and sensor_file.samefile(out_file):
        raise RefusedInputError(f"{out_file} is the sensor file that is read, and is kept: choose another name.")
    use_kernel_folder(read_settings())
    settings = parse_settings(chosen(choices))
    with progress("reading the telemetry") as report, computing_on(read_settings().computing_threads):
        found = _chosen(telemetry, sensor_file, validate, settings, report)
    write_json(found.document(), json_file)
    if out_file is not None:
        write_json(found.sensor_file(), out_file)
    if STANDARD_OUTPUT not in {json_file, out_file}:
        click.echo("\n".join(_lines(found)))


def _chosen(telemetry: Path, sensor_file: Path, validate: Path | None, settings: Any, report: Any) -> Choice:
    from boresight.calibration.choice.choose import choose as find
    from boresight.calibration.telemetry_pieces import TelemetryFile
    from boresight.sky.catalogue import load_catalogue
    from boresight.telemetry.sensors import read_sensor

    sensor = read_sensor(sensor_file)
    limits = read_settings().telemetry_limits
    stars = TelemetryFile(telemetry, limits=limits).opened()
    validation = None if validate is None else TelemetryFile(validate, limits=limits).opened()
    report("loading the star catalogue")
    folder = read_settings().catalogue_folder
    return find(
        stars, sensor, load_catalogue(folder), settings, validation=validation, report=report, cache_folder=folder
    )


def _lines(found: Choice) -> Iterator[str]:
    yield f"{found.sensor.name}: {found.frames:,} frames, {found.stars:,} stars, {found.arcs:,} arcs"
    yield ""
    yield found.sentence
    yield ""
    yield aligned(list(_cameras(found)), left=(0, 1))
    yield ""
    yield aligned(list(_terms(found)), left=(0, 1))
    for sentence in found.advice:
        yield f"\n- {sentence}"


def _cameras(found: Choice) -> Iterator[tuple[str, ...]]:
    """Give a row a camera: its least sufficient candidate."""
    yield "", "camera and free terms", "free", "chi2/dof", "BIC above", "held-out RMS µrad", "change px", "± 3σ"
    shown = {id(one.fitted) for one in found.others}
    rows = [found.model, *sorted((m for m in found.models if id(m.fitted) in shown), key=lambda one: one.bic)]
    for one in rows:
        fitted = one.fitted
        words = ", ".join(fitted.subset.term_names) or "focal length alone"
        yield (
            "->" if one is found.model else "",
            f"{fitted.camera.name}: {words}",
            str(fitted.n_free),
            f"{fitted.chi2 / fitted.dof:.4f}",
            f"{one.bic - found.model.bic:.1f}",
            _scored(one),
            *_changed(one),
        )


def _terms(found: Choice) -> Iterator[tuple[str, ...]]:
    """Give a row a test: the terms that are needed, then those that are not."""
    yield "", "term of the chosen camera", "chi2 drop", "df", "p, corrected", "held-out RMS", "change px", "± 3σ"
    for word, tests in (("needed", found.needed), ("beyond", found.beyond)):
        for one in tests:
            yield (
                word,
                " + ".join(one.test.terms),
                f"{one.test.drop:.1f}",
                str(one.test.df),
                f"{one.test.p_corrected:.2g}",
                "-" if one.held_out is None else f"{100 * (one.held_out.rms_arc_rad - 1):+.2f} %",
                *_changed(one),
            )


def _scored(one: Model) -> str:
    """Held-out RMS with its interval."""
    if one.held_out is None:
        return "-"
    low, high = one.held_out.interval
    interval = "" if low is None or high is None else f" ({low * 1e6:.2f} to {high * 1e6:.2f})"
    return f"{one.held_out.rms_arc_rad * 1e6:.2f}{interval}"


def _changed(one: Model | TermTest) -> tuple[str, str]:
    if one.change is None:
        return "-", "-"
    size, three_sigma = one.change.largest
    return f"{size:.3f}", f"{three_sigma:.3f}"
