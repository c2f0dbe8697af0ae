"""What a file for another program is made of: the fitted lens, its misfit, and where its numbers come from.

A misfit is the same in every frame, so it adds to what a star tells as a bias does. Up to a tenth of the centroid's sigma it makes
the error of a star half a percent larger (the sum of squares), which is what is allowed unless the user says another limit; a
format whose reader only identifies stars allows as much as the sigma itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

import boresight
from boresight.arrays import ARCSEC_PER_RAD, FloatArray
from boresight.calibration.exports.lenses import E_FROM_TRIAD, FittedLens, Lens, fit_lens
from boresight.calibration.parameter_file import parse_parameters
from boresight.calibration.residual_spline import require_in
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import rotation_vector, to_quaternion
from boresight.telemetry.sensors import Sensor

if TYPE_CHECKING:
    from boresight.estimation.residual_spline import Surface

SCHEMA = "boresight.export/1"
#: Misfit that is allowed, as a share of the sensor's centroid_sigma_px, where a format names no other.
ALLOWED_SHARE = 0.1


@dataclass(frozen=True)
class Source:
    """Where numbers come from: the name of their document, its SHA-256 where it has one, and its sensor."""

    name: str
    sha256: str | None
    sensor: Sensor


@dataclass(frozen=True)
class ExposureAttitude:
    """An exposure's attitude, and what it takes to undo aberration.

    `quaternion`: (4,) x y z w, ICRS to the right-handed triad of D. `covariance`: (3, 3) about the axes of that triad, rad^2.
    `time_utc`: ISO 8601 or None. `velocity_c`: (3,) of the observer in units of c, ICRS axes; None where no time tells it.
    """

    frame: int
    exposure: int
    stars: int
    quaternion: FloatArray
    covariance: FloatArray
    time_utc: str | None = None
    velocity_c: FloatArray | None = None


@dataclass(frozen=True)
class Export:
    """Everything that a writer may say.

    `x`: (n_parameters,) of the sensor's camera model, SI. `fitted`: the lens, None for a format that has none. `exposures`: their
    attitudes, for a format that needs them. `suffix`: ending of the file's name, by which a format may have several spellings.
    """

    source: Source
    x: FloatArray
    allowed_px: float
    suffix: str
    fitted: FittedLens | None = None
    residual: Surface | None = None
    exposures: Sequence[ExposureAttitude] = ()

    @property
    def sensor(self) -> Sensor:
        """Whose camera it is."""
        return self.source.sensor

    @property
    def lens(self) -> FittedLens:
        """The fitted lens, for formats that declare one."""
        if self.fitted is None:
            raise ValueError("Expected a fitted lens; received a format that declares none")
        return self.fitted


@dataclass(frozen=True)
class Written:
    """A file, and what is told beside it: `misfit_px`, `rms_px` over the detector, and what the format alone has to say."""

    content: bytes
    misfit_px: float
    rms_px: float
    others: Mapping[str, Any]


@dataclass(frozen=True)
class ExportFormat:
    """A file that another program reads; one row is the command, the REST download, the list of the page and the documentation.

    `name`: as it is asked for. `program`: what reads it. `suffixes`: endings of its name, the usual one first. `media_type`: of a
    download. `write`: makes the file. `lenses`: what may stand in it, the simplest first; empty where the writer fits something
    else. `needs_attitudes`: whether there is something a frame, which takes telemetry. `share`: of the centroid's sigma that its
    misfit may be. `why`: what it says besides, for the documentation.
    """

    name: str
    program: str
    suffixes: tuple[str, ...]
    media_type: str
    write: Callable[[Export], Written]
    lenses: tuple[Lens, ...] = ()
    needs_attitudes: bool = False
    share: float = ALLOWED_SHARE
    why: str = ""


def export(
    form: ExportFormat,
    source: Source,
    x: FloatArray,
    *,
    P: FloatArray | None = None,
    residual: Surface | None = None,
    allowed_px: float | None = None,
    suffix: str | None = None,
    exposures: Sequence[ExposureAttitude] = (),
) -> tuple[bytes, dict[str, Any]]:
    """Write a camera for another program: the file, and its description, schema `boresight.export/1`.

    `x`: (n_parameters,) of the sensor's camera model, SI; `P`: (n_parameters, n_parameters) their covariance. `residual`: what the
    camera leaves over, to be followed too. `allowed_px`: largest misfit over the detector; the format's share of the sensor's
    centroid_sigma_px where None. `suffix`: ending of the file's name. Raises RefusedInputError where the format cannot follow the
    camera closely enough, or lacks what it needs; says by how much, and what to do.
    """
    sensor = source.sensor
    allowed = form.share * sensor.centroid_sigma_px if allowed_px is None else allowed_px
    if form.needs_attitudes and not exposures:
        raise RefusedInputError(
            f"{form.name} has a header for each exposure, but no exposure has an attitude: give telemetry "
            "whose stars can be matched."
        )
    fitted = fit_lens(form.lenses, sensor, x, allowed, P=P, residual=residual) if form.lenses else None
    if fitted is not None:
        _refuse_misfit(form, source, fitted.misfit_px, allowed, by_rule=allowed_px is None)
    asked = Export(source, np.asarray(x, dtype=float), allowed, suffix or form.suffixes[0], fitted, residual, exposures)
    written = form.write(asked)
    _refuse_misfit(form, source, written.misfit_px, allowed, by_rule=allowed_px is None)
    return written.content, _described(form, asked, written)


def export_document(
    form: ExportFormat,
    document: Mapping[str, Any],
    source: Source,
    *,
    residual: bool = False,
    allowed_px: float | None = None,
    suffix: str | None = None,
    exposures: Callable[[FloatArray, FloatArray | None], Sequence[ExposureAttitude]] | None = None,
) -> tuple[bytes, dict[str, Any]]:
    """Write the camera of a calibration, a parameter set, or names and values, as `export` does.

    `residual`: follow its residual spline too. `exposures`: lists the attitudes under parameters and their covariance, for formats
    that need them.
    """
    x, P = parse_parameters(document, source.sensor, source.name)
    spline = require_in(document, source.name) if residual else None
    return export(
        form,
        source,
        x,
        P=P,
        residual=None if spline is None else spline.surface,
        allowed_px=allowed_px,
        suffix=suffix,
        exposures=exposures(x, P) if form.needs_attitudes and exposures is not None else (),
    )


def _refuse_misfit(form: ExportFormat, source: Source, misfit_px: float, allowed_px: float, *, by_rule: bool) -> None:
    """Refuse what does not follow the camera."""
    if misfit_px <= allowed_px:
        return
    size = f"differs by up to {misfit_px:.4g} px" if math.isfinite(misfit_px) else "does not cover the whole detector"
    rule = f" ({100 * form.share:g} % of the sensor's centroid_sigma_px)" if by_rule else ""
    raise RefusedInputError(
        f"{source.name} cannot be exported as {form.name}: the closest {form.program} camera {size}, where {allowed_px:.4g} px "
        f"is allowed{rule}; choose a format with more terms, calibrate under a camera model nearer to that program's, or allow "
        "more."
    )


def _described(form: ExportFormat, asked: Export, written: Written) -> dict[str, Any]:
    """Describe a file for machines."""
    fitted, sensor = asked.fitted, asked.sensor
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "format": form.name,
        "program": form.program,
        "source": {"name": asked.source.name, "sha256": asked.source.sha256},
        "sensor": sensor.name,
        "camera_model": sensor.camera_model,
        "version": boresight.__version__,
        "misfit_px": {"max": written.misfit_px, "rms": written.rms_px},
        "allowed_px": asked.allowed_px,
    }
    if fitted is not None:
        names = fitted.lens.parameters
        sigma = [None] * len(names) if fitted.sigma is None else fitted.sigma.tolist()
        document |= {
            "lens": fitted.lens.name,
            "parameters": fitted.values,
            "sigma": dict(zip(names, sigma, strict=True)),
            "mirrored": fitted.mirrored,
            "turn_rad": rotation_vector(to_quaternion(fitted.turn)).tolist(),
            "camera_from_triad": (fitted.turn @ E_FROM_TRIAD).tolist(),
        }
    return document | dict(written.others)


def pack_lens(asked: Export, content: str | bytes, **others: Any) -> Written:
    """Return what a writer of a lens has written."""
    fitted = asked.lens
    return Written(content.encode() if isinstance(content, str) else content, fitted.misfit_px, fitted.rms_px, others)


def provenance(asked: Export) -> list[str]:
    """Say in lines where a file's numbers come from, how well they follow, and what the frame is; for comments."""
    sensor, source = asked.sensor, asked.source
    lines = [
        f"Written by Boresight {boresight.__version__} from {one_line(source.name)}",
        f"SHA-256 of the source: {source.sha256 or 'none'}",
        f"Sensor: {one_line(sensor.name)}, {sensor.rows} rows, {sensor.columns} columns; its camera model: {sensor.camera_model}",
    ]
    fitted = asked.fitted
    if fitted is None:
        return lines
    lines.append(
        f"Largest misfit over the detector: {fitted.misfit_px:.2g} px "
        f"(RMS {fitted.rms_px:.2g} px; {asked.allowed_px:.2g} px was allowed)"
    )
    if asked.residual is not None:
        lines.append("It also includes the residual spline of the calibration")
    if fitted.sigma is not None:
        told = ", ".join(
            f"{name} {value:.2g}" for name, value in zip(fitted.lens.parameters, fitted.sigma, strict=True)
        )
        lines.append(f"One sigma, in pixels and powers of the tangent: {told}")
    lines.append("Frame: X along columns, Y along rows, Z along the boresight")
    if fitted.mirrored:
        lines.append(
            f"Parity +1: this is the camera of the image MIRRORED left to right, column' = {sensor.columns - 1} - column"
        )
    if fitted.turned:
        turn = rotation_vector(to_quaternion(fitted.turn)) * ARCSEC_PER_RAD
        lines.append(
            "The frame is rotated from the detector's by the rotation vector "
            f"({turn[0]:.6g}, {turn[1]:.6g}, {turn[2]:.6g}) arcsec: rotate attitudes by it"
        )
    return lines


def one_line(text: str) -> str:
    """Return a text without line ends and control characters, so that it stays within a comment."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def number(value: float) -> str:
    """Write a number in the digits that read back as the same, as YAML 1.1 reads a float: a point, a sign in the exponent."""
    text = repr(float(value))
    return text if "e" not in text or "." in text else text.replace("e", ".0e")
