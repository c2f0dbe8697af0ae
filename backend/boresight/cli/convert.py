"""`boresight convert`: a camera written in another camera model, or as a file of another program, with how closely that follows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from boresight.cli.input import INPUT_FILE
from boresight.cli.output import (
    STANDARD_OUTPUT,
    check_one_stream,
    check_writable,
    json_option,
    tell,
    write_bytes,
    write_json,
)
from boresight.errors import RefusedInputError
from boresight.library.text import aligned


def _complete_target(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete the name of a camera model or a format."""
    from boresight.calibration.exports import EXPORT_FORMATS
    from boresight.cameras import CAMERA_MODELS

    known = dict.fromkeys(CAMERA_MODELS, "camera model") | {n: f.program for n, f in EXPORT_FORMATS.items()}
    return [CompletionItem(name, help=said) for name, said in known.items() if name.startswith(incomplete)]


@click.command()
@click.argument("parameters", type=INPUT_FILE)
@click.option("--sensor", "sensor_file", type=INPUT_FILE, required=True, help="Sensor file of PARAMETERS, JSON.")
@click.option(
    "--to",
    "target",
    required=True,
    metavar="MODEL|FORMAT",
    shell_complete=_complete_target,
    help="The other camera model, or another program's format: opencv, ros, mrcal, colmap, tetra3, cedar, giant-brown, "
    "giant-owen, fits-sip, fits-tpv.",
)
@click.option("--out", "out_file", required=True, metavar="FILE", help="File to write; - is standard output.")
@click.option("--sensor-out", "sensor_out", metavar="FILE", help="Also write a sensor file with the other model.")
@click.option(
    "--telemetry",
    type=INPUT_FILE,
    help="Telemetry with the exposures for FITS headers; its stars are matched to get their attitudes.",
)
@click.option(
    "--allow-px",
    type=click.FloatRange(min=0),
    help="Maximum misfit over the detector; by default 1 % of centroid_sigma_px for a camera model, 10 % for a format, and "
    "100 % for tetra3 and cedar.",
)
@click.option(
    "--residual",
    is_flag=True,
    help="Include the residual spline of the calibration.",
)
@json_option
def convert(  # noqa: PLR0913 - an option each
    parameters: Path,
    sensor_file: Path,
    target: str,
    out_file: str,
    sensor_out: str | None,
    telemetry: Path | None,
    allow_px: float | None,
    json_file: str | None,
    *,
    residual: bool,
) -> None:
    """Write PARAMETERS in another camera model or in another program's format, and print the misfit.

    The conversion is refused if the misfit exceeds the limit. For a camera model, the output is a parameter file with
    covariance, accepted by `evaluate` and `match` with the sensor file of --sensor-out. For another program, the file extension
    selects the format; comments in the file give the misfit, the frame and the source.
    """
    from boresight.calibration.exports import EXPORT_FORMATS

    check_one_stream(out_file, sensor_out, json_file)
    form = EXPORT_FORMATS.get(target)
    _check_places(form, out_file, sensor_out, json_file, parameters, sensor_file)
    if form is not None:
        _export(form, parameters, sensor_file, out_file, telemetry, allow_px, json_file, residual=residual)
        return
    if telemetry is not None:
        raise RefusedInputError(
            f"--telemetry applies only to {' and '.join(name for name, one in EXPORT_FORMATS.items() if one.needs_attitudes)}: "
            f"omit it for {target}."
        )
    written, sensor = _converted(
        parameters, sensor_file, target, allow_px, sensor_wanted=sensor_out is not None, residual=residual
    )
    write_json(written, out_file)
    if sensor_out is not None:
        write_json(sensor, sensor_out)
    write_json(written, json_file)
    if STANDARD_OUTPUT not in {out_file, sensor_out, json_file}:
        click.echo("\n".join(_lines(written)))
        click.echo("\n".join(f"Wrote {place}" for place in (out_file, sensor_out) if place is not None))


def _check_places(
    form: Any, out_file: str, sensor_out: str | None, json_file: str | None, parameters: Path, sensor_file: Path
) -> None:
    """Refuse, before the work begins, files that cannot be written, would replace an input, or end otherwise."""
    if form is None:
        check_writable(out_file)
    else:
        if sensor_out is not None:
            raise RefusedInputError(f"{form.name} is not a camera model, so it has no sensor file: omit --sensor-out.")
        check_writable(out_file, forms=form.suffixes, title=form.name)
    for place in (sensor_out, json_file):
        check_writable(place)
    for place in (out_file, sensor_out, json_file):
        _check_kept(place, parameters, sensor_file)


def _export(
    form: Any,
    parameters: Path,
    sensor_file: Path,
    out_file: str,
    telemetry: Path | None,
    allow_px: float | None,
    json_file: str | None,
    *,
    residual: bool,
) -> None:
    """Write a file of another program and say how well it follows."""
    from boresight.library import functions as library
    from boresight.library.progress import progress

    if form.needs_attitudes and telemetry is None:
        raise RefusedInputError(
            f"{form.name} has a header for each exposure, with the attitude from its stars: give the telemetry with --telemetry."
        )
    suffix = Path(out_file).suffix.lower() if out_file != STANDARD_OUTPUT else None
    with progress("fitting") as report:
        found = library.export_camera(
            parameters, sensor_file, form.name, telemetry=telemetry, allow_px=allow_px, residual=residual, suffix=suffix,
            progress=report,
        )  # fmt: skip
    write_bytes(found.content, out_file)
    write_json(found.document, json_file)
    if json_file != STANDARD_OUTPUT:
        tell("\n".join(_export_lines(found.document, out_file)), out_file)


def _export_lines(document: dict[str, Any], out_file: str) -> Iterator[str]:
    yield f"{document['sensor']}: {document['camera_model']} as {document['format']}"
    if "lens" in document:
        sigma = document["sigma"]
        rows = [
            (name, f"{value:.9g}", "-" if sigma[name] is None else f"{sigma[name]:.3g}")
            for name, value in document["parameters"].items()
        ]
        yield f"\n{aligned([(document['lens'], 'value', 'sigma'), *rows])}"
        if document["mirrored"]:
            yield "\nparity +1: this is the camera of the image mirrored left to right"
        if any(document["turn_rad"]):
            turn = ", ".join(f"{1e6 * angle:.3f}" for angle in document["turn_rad"])
            yield f"\nits frame is turned by the rotation vector ({turn}) microradians: rotate attitudes by it"
    else:
        yield f"{document['exposures']:,} exposures, polynomials of order {document['order']}"
    px = document["misfit_px"]
    allowed = document["allowed_px"]
    yield f"\nmisfit over the detector: largest {px['max']:.2g} px, RMS {px['rms']:.2g} px; {allowed:.2g} px is allowed"
    yield f"Wrote {out_file}"


def _check_kept(place: str | None, *inputs: Path) -> None:
    for path in inputs:
        if (
            place not in {None, STANDARD_OUTPUT}
            and path.exists()
            and Path(str(place)).exists()
            and path.samefile(str(place))
        ):
            raise RefusedInputError(
                f"{place} is an input file and will not be overwritten: choose another name.",
                code="would-overwrite",
            )


def _converted(
    path: Path, sensor_file: Path, target: str, allow_px: float | None, *, sensor_wanted: bool, residual: bool
) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Read the files and convert; the second document is the sensor file."""
    from boresight.calibration.conversion import converted
    from boresight.calibration.conversion import sensor_file as described
    from boresight.calibration.parameter_file import read_document
    from boresight.telemetry.sensors import read_sensor

    sensor = read_sensor(sensor_file)
    written = converted(read_document(path), sensor, path.name, target, allow_px, with_residual=residual)
    return written, described(sensor, written) if sensor_wanted else None


def _lines(written: dict[str, Any]) -> Iterator[str]:
    how, sigma = written["conversion"], written["sigma"]
    yield f"{written['sensor']}: {how['camera_model']} in {written['camera_model']}"
    yield ""
    rows = [
        (name, f"{value:.9g}", "-" if sigma[name] is None else f"{sigma[name]:.3g}")
        for name, value in written["parameters"].items()
    ]
    yield aligned([("parameter", "value", "sigma"), *rows])
    yield ""
    px, arcsec = how["misfit_px"], how["misfit_arcsec"]
    yield aligned(
        [
            ("misfit over the detector", "px", "arcsec"),
            ("largest", f"{px['max']:.2g}", f"{arcsec['max']:.2g}"),
            ("RMS", f"{px['rms']:.2g}", f"{arcsec['rms']:.2g}"),
            ("allowed", f"{how['allowed_px']:.2g}", ""),
        ]
    )
    if "residual" in how:
        left = how["residual"]
        yield (
            f"\nthe residual spline is included: up to {left['max_px']:.2g} px, sigma up to {left['max_sigma_px']:.2g} px; "
            "the sigmas above are those of the parameters alone"
        )
    if written["covariance"] is not None:
        yield f"\nuncertainty that {written['camera_model']} cannot represent: at most {how['lost_sigma_px']:.2g} px (1 sigma)"
    if how["assumed"]:
        yield (
            f"not estimated: {', '.join(how['assumed'])}; each was given ten typical sigmas before the conversion, "
            "so a sigma above may come from them"
        )
