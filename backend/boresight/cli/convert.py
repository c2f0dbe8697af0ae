"""`boresight convert`: parameters of one camera model written in the other, with how closely that one can follow."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from boresight.cli.output import STANDARD_OUTPUT, check_one_stream, check_writable, json_option, write_json
from boresight.errors import RefusedInputError
from boresight.library.text import aligned


@click.command()
@click.argument("parameters", type=click.Path(path_type=Path))
@click.option(
    "--sensor", "sensor_file", type=click.Path(path_type=Path), required=True, help="Their sensor file, JSON."
)
@click.option("--to", "target", required=True, metavar="MODEL", help="The other camera model.")
@click.option("--out", "out_file", required=True, metavar="FILE", help="Parameter file to write, with its covariance.")
@click.option("--sensor-out", "sensor_out", metavar="FILE", help="Write a sensor file of the other model too.")
@click.option(
    "--allow-px",
    type=click.FloatRange(min=0),
    help="Largest misfit over the detector; 1 % of centroid_sigma_px if left out.",
)
@click.option(
    "--residual",
    is_flag=True,
    help="Follow the camera with what its calibration found it to leave over: its residual spline.",
)
@json_option
def convert(
    parameters: Path,
    sensor_file: Path,
    target: str,
    out_file: str,
    sensor_out: str | None,
    allow_px: float | None,
    json_file: str | None,
    *,
    residual: bool,
) -> None:
    """Write PARAMETERS in another camera model: values, covariance, and what is left of the fit.

    Refused where the other model cannot follow within the misfit allowed. `evaluate` and `match` take the parameter file, with
    the sensor file that --sensor-out writes.
    """
    check_one_stream(out_file, sensor_out, json_file)
    for place in (out_file, sensor_out, json_file):
        check_writable(place)
        _check_kept(place, parameters, sensor_file)
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


def _check_kept(place: str | None, *inputs: Path) -> None:
    for path in inputs:
        if (
            place not in {None, STANDARD_OUTPUT}
            and path.exists()
            and Path(str(place)).exists()
            and path.samefile(str(place))
        ):
            raise RefusedInputError(f"{place} is what is converted, and is kept: choose another name.")


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
            f"\nit follows the residual spline too: up to {left['max_px']:.2g} px, sigma up to {left['max_sigma_px']:.2g} px; "
            "the sigmas above are of the parameters alone"
        )
    if written["covariance"] is not None:
        yield f"\nuncertainty that {written['camera_model']} cannot express: at most {how['lost_sigma_px']:.2g} px (1 sigma)"
    if how["assumed"]:
        yield (
            f"not estimated: {', '.join(how['assumed'])}; before the conversion ten typical sigmas stand for each, "
            "so a sigma above may be theirs"
        )
