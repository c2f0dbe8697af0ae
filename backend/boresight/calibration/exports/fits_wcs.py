"""FITS headers with the world coordinate system of each exposure: gnomonic, with SIP or TPV polynomials.

FITS counts columns and rows from 1 at the centre of the first pixel. With u = column + 1 - CRPIX1, v = row + 1 - CRPIX2, and xi
(east), eta (north) the tangents about CRVAL, degrees,

    SIP   (xi, eta) = CD (u + A(u, v), v + B(u, v)),    A, B of order 2 and more          (Shupe et al. 2005)
    TPV   (x, y) = CD (u, v),   xi = sum PV1_k x^i y^j,   eta = sum PV2_k y^i x^j          (Registered FITS Conventions, TPV)

which both are one polynomial of (u, v): it is fitted by linear least squares to the directions of an even grid of pixels, written
one way or the other, at the least order that will do. CRPIX is the principal point, or the middle of a detector that does not
contain it, and CRVAL its direction. AP and BP of SIP, for readers that do not iterate, are fitted the other way round.

The directions are the camera's, turned by the exposure's attitude, and brought from what a moving observer sees to ICRS by the
Lorentz transformation with -v, the inverse of `sky.apparent.aberrated`. Where a file gives its own apparent directions and no
time there is no v to undo, and the header says so. Parallax and proper motion belong to stars and are not in it: move a catalogue
to DATE-OBS.

CRDER is the sigma of the attitude across the boresight, CSYER the misfit: random, and systematic error of a coordinate.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.conversion import undone
from boresight.calibration.exports.export import Export, ExportFormat, ExposureAttitude, Written, provenance
from boresight.calibration.exports.lenses import AMPLE, FITTED, JUDGED
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import to_matrix
from boresight.sky.apparent import aberrated

if TYPE_CHECKING:
    from astropy.io import fits

#: Orders that are tried, by kind of polynomial: those that readers have.
ORDERS = {"SIP": range(2, 10), "TPV": range(1, 8)}
#: Headers that a file may have: each takes 10 kB.
MOST_EXPOSURES = 5_000
MJD_ZERO = np.datetime64("1858-11-17")
#: Number k of PV1_k for the term x^i y^j; the numbers left out belong to powers of the radius.
FIRST_OF_DEGREE = {0: 0, 1: 1, 2: 4, 3: 7, 4: 12, 5: 17, 6: 24, 7: 31}


@dataclass(frozen=True)
class _Grid:
    """Places over the detector: rows and columns (n,), their directions (n, 3) in the triad of D, and the size of a pixel, rad."""

    row: FloatArray
    column: FloatArray
    s: FloatArray
    pixel_rad: FloatArray


@dataclass(frozen=True)
class _Polynomial:
    """xi and eta, degrees, as a polynomial of (u, v): coefficients (n_terms, 2) of the terms u^i v^j."""

    powers: list[tuple[int, int]]
    c: FloatArray

    @property
    def CD(self) -> FloatArray:
        """Linear part (2, 2): d(xi, eta) / d(u, v)."""
        return np.stack([self.c[self.powers.index(power)] for power in ((1, 0), (0, 1))], axis=-1)

    def __call__(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return (n, 2) xi and eta."""
        return _terms(u, v, self.powers) @ self.c


def _grid(asked: Export, count: int) -> _Grid:
    sensor, camera = asked.sensor, CAMERA_MODELS[asked.sensor.camera_model]
    row, column = np.meshgrid(
        np.linspace(-0.5, sensor.rows - 0.5, count), np.linspace(-0.5, sensor.columns - 0.5, count), indexing="ij"
    )
    place = row.ravel(), column.ravel()
    s = _directions(asked, place)
    pixel = np.sqrt(camera.solid_angle(asked.x, *place, sensor.pixel_pitch_m))
    return _Grid(*place, s, pixel)


def _directions(asked: Export, place: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Directions (n, 3) in the right-handed triad of D, what the camera leaves over included."""
    sensor, camera = asked.sensor, CAMERA_MODELS[asked.sensor.camera_model]
    at = place if asked.residual is None else undone(place, asked.residual)
    return np.asarray(
        camera.directions(asked.x, *at, sensor.pixel_pitch_m) * np.array([1.0, float(sensor.parity), 1.0])
    )


def _reference(asked: Export) -> tuple[float, float]:
    """Row and column of CRPIX."""
    sensor = asked.sensor
    row, column = CAMERA_MODELS[sensor.camera_model].principal_point(asked.x)
    inside = -0.5 <= row <= sensor.rows - 0.5 and -0.5 <= column <= sensor.columns - 0.5
    return (row, column) if inside else (0.5 * (sensor.rows - 1), 0.5 * (sensor.columns - 1))


def _on_sky(s: FloatArray, exposure: ExposureAttitude) -> FloatArray:
    """Directions (n, 3) of the triad in ICRS, at rest where the observer's velocity is known."""
    seen = s @ to_matrix(exposure.quaternion)
    return seen if exposure.velocity_c is None else aberrated(seen, -exposure.velocity_c)


def _axes(centre: FloatArray) -> FloatArray:
    """East, north and the direction itself, (3, 3) rows; at a pole, where east is any, that of right ascension 0."""
    ra, dec = math.atan2(centre[1], centre[0]), math.asin(max(-1.0, min(1.0, centre[2])))
    east = [-math.sin(ra), math.cos(ra), 0.0]
    north = [-math.sin(dec) * math.cos(ra), -math.sin(dec) * math.sin(ra), math.cos(dec)]
    return np.array([east, north, [math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)]])


def _terms(u: FloatArray, v: FloatArray, powers: Iterable[tuple[int, int]]) -> FloatArray:
    return np.stack([u**i * v**j for i, j in powers], axis=-1)


def _powers(order: int, least: int = 1) -> list[tuple[int, int]]:
    """Powers (i, j) of degree `least` to `order`, highest i first."""
    return [(degree - j, j) for degree in range(least, order + 1) for j in range(degree + 1)]


def _solved(u: FloatArray, v: FloatArray, powers: list[tuple[int, int]], goal: FloatArray) -> FloatArray:
    """Least squares (n_terms, k) of goals (n, k), terms brought to one size first."""
    A = _terms(u, v, powers)
    size = np.abs(A).max(axis=0)
    return np.asarray(np.linalg.lstsq(A / size, goal, rcond=None)[0] / size[:, None])


@dataclass(frozen=True)
class _Fit:
    """An exposure's polynomial about `axes`, CRVAL their last row, with its misfit."""

    polynomial: _Polynomial
    axes: FloatArray
    misfit_px: float
    rms_px: float


def _fit(asked: Export, grids: tuple[_Grid, _Grid], exposure: ExposureAttitude, order: int) -> _Fit:
    """Fit the polynomial of an order on one grid, and judge it on the other."""
    row0, column0 = _reference(asked)
    centre = _on_sky(_directions(asked, (np.array([row0]), np.array([column0]))), exposure)[0]
    axes = _axes(centre)
    fitted, judged = grids
    local = _on_sky(fitted.s, exposure) @ axes.T
    powers = _powers(order)
    goal = np.degrees(local[:, :2] / local[:, 2:])
    polynomial = _Polynomial(powers, _solved(fitted.column - column0, fitted.row - row0, powers, goal))
    seen = np.radians(polynomial(judged.column - column0, judged.row - row0))
    seen = np.column_stack([seen, np.ones(len(seen))]) / np.sqrt(1.0 + np.sum(seen**2, axis=-1, keepdims=True))
    away = np.linalg.norm(seen - _on_sky(judged.s, exposure) @ axes.T, axis=-1) / judged.pixel_rad
    away = np.where(np.isfinite(away), away, np.inf)
    return _Fit(polynomial, axes, float(away.max()), float(np.sqrt(np.mean(away**2))))


def _order(asked: Export, kind: str, grids: tuple[_Grid, _Grid]) -> int:
    """Return the least order that follows the camera amply, else the one that follows best, by the first exposure."""
    misfits = {}
    for order in ORDERS[kind]:
        misfits[order] = _fit(asked, grids, asked.exposures[0], order).misfit_px
        if misfits[order] <= AMPLE * asked.allowed_px:
            return order
    return min(misfits, key=lambda order: misfits[order])


def _sip(header: fits.Header, fit: _Fit, grid: _Grid, reference: tuple[float, float]) -> None:
    """Write A and B, and AP and BP for the way back."""
    polynomial = fit.polynomial
    order = max(i + j for i, j in polynomial.powers)
    c = polynomial.c @ np.linalg.inv(polynomial.CD).T
    header["A_ORDER"], header["B_ORDER"] = order, order
    for (i, j), (a, b) in zip(polynomial.powers, c.tolist(), strict=True):
        if i + j >= 2:
            header[f"A_{i}_{j}"], header[f"B_{i}_{j}"] = a, b
    u, v = grid.column - reference[1], grid.row - reference[0]
    U, V = (polynomial(u, v) @ np.linalg.inv(polynomial.CD).T).T
    powers = _powers(min(order + 1, max(ORDERS["SIP"])), least=0)
    back = _solved(U, V, powers, np.column_stack([u - U, v - V]))
    header["AP_ORDER"], header["BP_ORDER"] = powers[-1][1], powers[-1][1]
    for (i, j), (a, b) in zip(powers, back.tolist(), strict=True):
        header[f"AP_{i}_{j}"], header[f"BP_{i}_{j}"] = a, b


def _tpv(header: fits.Header, fit: _Fit, grid: _Grid, reference: tuple[float, float]) -> None:
    """Write PV1 in x, y and PV2 in y, x, degrees."""
    polynomial = fit.polynomial
    u, v = grid.column - reference[1], grid.row - reference[0]
    x, y = (np.column_stack([u, v]) @ polynomial.CD.T).T
    c = _solved(x, y, polynomial.powers, polynomial(u, v))
    for (i, j), (xi, eta) in zip(polynomial.powers, c.tolist(), strict=True):
        header[f"PV1_{FIRST_OF_DEGREE[i + j] + j}"] = xi
        header[f"PV2_{FIRST_OF_DEGREE[i + j] + i}"] = eta


def _header(asked: Export, kind: str, exposure: ExposureAttitude, fit: _Fit, grid: _Grid) -> fits.Header:
    """Write one exposure's header."""
    from astropy.io import fits  # noqa: PLC0415 - 0.3 s, which only this format takes

    row0, column0 = _reference(asked)
    header = fits.Header()
    header["EXTNAME"] = f"F{exposure.frame}E{exposure.exposure}"
    header["FRAME"], header["EXPOSURE"] = exposure.frame, exposure.exposure
    header["WCSAXES"] = 2
    suffix = "-SIP" if kind == "SIP" else ""
    projection = f"TAN{suffix}" if kind == "SIP" else "TPV"
    header["CTYPE1"], header["CTYPE2"] = f"RA---{projection}", f"DEC--{projection}"
    header["CUNIT1"], header["CUNIT2"] = "deg", "deg"
    centre = fit.axes[2]
    header["CRVAL1"] = math.degrees(math.atan2(centre[1], centre[0])) % 360.0
    header["CRVAL2"] = math.degrees(math.asin(max(-1.0, min(1.0, centre[2]))))
    header["CRPIX1"], header["CRPIX2"] = column0 + 1.0, row0 + 1.0
    for i, line in enumerate(fit.polynomial.CD.tolist()):
        header[f"CD{i + 1}_1"], header[f"CD{i + 1}_2"] = line
    header["LONPOLE"] = 180.0  # north up at the celestial pole too, where its default is another
    header["RADESYS"] = "ICRS"
    if exposure.time_utc is not None:
        header["DATE-OBS"], header["TIMESYS"] = exposure.time_utc, "UTC"
        header["MJD-OBS"] = float((np.datetime64(exposure.time_utc) - MJD_ZERO) / np.timedelta64(1, "D"))
    across = math.degrees(math.sqrt(max(exposure.covariance[0, 0], exposure.covariance[1, 1], 0.0)))
    systematic = fit.misfit_px * math.degrees(float(grid.pixel_rad.mean()))
    for axis in (1, 2):
        header[f"CRDER{axis}"], header[f"CSYER{axis}"] = across, systematic
    header["IMAGEW"], header["IMAGEH"] = asked.sensor.columns, asked.sensor.rows
    header["NSTARS"] = (exposure.stars, "matched stars of the attitude")
    header["MISFIT"] = (fit.misfit_px, "largest over the detector, pixels")
    (_sip if kind == "SIP" else _tpv)(header, fit, grid, (row0, column0))
    header["COMMENT"] = (
        "Directions are apparent: aberration is not removed, because there is no time"
        if exposure.velocity_c is None
        else "Aberration is removed; move catalogue positions by proper motion and parallax"
    )
    return header


def _write(asked: Export, kind: str) -> Written:
    """Write a FITS file with an extension for each exposure, which has a header and no image."""
    from astropy.io import fits  # noqa: PLC0415 - 0.3 s, which only this format takes

    if len(asked.exposures) > MOST_EXPOSURES:
        raise RefusedInputError(
            f"The telemetry has {len(asked.exposures):,} exposures with an attitude, and a FITS file may have {MOST_EXPOSURES:,} "
            "headers: give it in parts."
        )
    grids = _grid(asked, FITTED), _grid(asked, JUDGED)
    if not all(np.isfinite(grid.s).all() for grid in grids):
        raise RefusedInputError(
            f"The camera of {asked.source.name} has no direction in a part of the detector, so no header can be written: give "
            "parameters that cover the detector."
        )
    order = _order(asked, kind, grids)
    primary = fits.PrimaryHDU()
    for line in provenance(asked):
        primary.header["COMMENT"] = line.encode("ascii", "replace").decode()
    primary.header["SHA256"] = asked.source.sha256 or ""
    parts: list[Any] = [primary]
    worst, squares = 0.0, 0.0
    for exposure in asked.exposures:
        fit = _fit(asked, grids, exposure, order)
        parts.append(fits.ImageHDU(header=_header(asked, kind, exposure, fit, grids[0])))
        worst, squares = max(worst, fit.misfit_px), squares + fit.rms_px**2
    stream = io.BytesIO()
    fits.HDUList(parts).writeto(stream, output_verify="exception")
    told = {"order": order, "exposures": len(asked.exposures)}
    return Written(stream.getvalue(), worst, math.sqrt(squares / len(asked.exposures)), told)


def _format(kind: str) -> ExportFormat:
    return ExportFormat(
        f"fits-{kind.lower()}", "readers of FITS WCS", (".fits", ".fit", ".fts"), "application/fits",
        lambda asked: _write(asked, kind), needs_attitudes=True,
        why=f"an extension for each exposure whose header has the WCS with {kind} polynomials, ICRS",
    )  # fmt: skip


SIP, TPV = _format("SIP"), _format("TPV")
