"""The two sides of an alignment: a tracker by its stars and camera, or a reference by a table of attitudes.

A tracker's stars are matched under its parameters, and each exposure is solved (`estimation.attitude`) with what the camera's
covariance does to it (`evaluation.alignment.sensitivity_of_exposures`). A reference is a table of times and quaternions, ICRS to
its frame, each with its error: of every attitude again (`sigma_arcsec`, or a column of that name, or one an axis), and one that all
of them share (`bias_arcsec`), as of a reference that is itself aligned only so well.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD, FloatArray, IntArray, TimeArray
from boresight.calibration.corrections import put_right
from boresight.calibration.evaluation.alignment import sensitivity_of_exposures
from boresight.calibration.matching.rematch import rematch, square_root
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import make_problem
from boresight.errors import RefusedInputError
from boresight.estimation.alignment import AttitudeSeries
from boresight.estimation.arcs import angular_sigma
from boresight.estimation.attitude import attitudes, to_matrix
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.imports.ephemerides import Attitudes
from boresight.telemetry.imports.profile import Profile, Quaternion, Time
from boresight.telemetry.schema import TEMPERATURES_C, Telemetry, within
from boresight.telemetry.sensors import Sensor

#: What the columns of a reference are called where no mapping profile says it.
COLUMNS = Profile(
    name="attitudes", time=Time(column="time_utc"), quaternion=Quaternion(columns=("q_x", "q_y", "q_z", "q_w"))
)
SIGMA, SIGMAS = "sigma_arcsec", ("sigma_x_arcsec", "sigma_y_arcsec", "sigma_z_arcsec")
BESIDE = (SIGMA, *SIGMAS, "temperature_c")
#: Where nobody says how good a reference is.
REFERENCE_SIGMA_ARCSEC = 10.0
SMALLEST_ARCSEC, LARGEST_ARCSEC = 1e-4, 36_000.0
#: Attitudes of one side that are taken in.
MOST_ATTITUDES = 200_000

#: Where a camera's covariance comes from: a calibration, the typical spread of the sensor file, or nowhere.
Knowledge = Literal["calibration", "typical", "none", "reference"]
_EPOCH = np.datetime64("2000-01-01T12:00:00", "us")


@dataclass(frozen=True)
class Side:
    """One frame of an alignment.

    `name`: whose it is. `series`: its attitudes. `frame`, `exposure`: (n,) where each is from, -1 in a reference. `stars`: (n,)
    that each was made of, 0 in a reference. `parameters`: what its camera's covariance comes from. `exposures`: of the telemetry,
    with an attitude or without. `values`: the parameters that its attitudes were solved with, SI.
    """

    name: str
    series: AttitudeSeries
    frame: IntArray
    exposure: IntArray
    stars: IntArray
    parameters: Knowledge
    exposures: int
    values: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Camera:
    """A tracker's parameters: `x` (n_parameters,), `P` its covariance, SI, and where that comes from."""

    x: FloatArray
    P: FloatArray
    parameters: Knowledge


def make_camera(sensor: Sensor, known: tuple[FloatArray, FloatArray | None] | None) -> Camera:
    """Return the camera to solve attitudes with: the parameters that are known, else the sensor file's at their typical spread."""
    if known is None:
        return Camera(sensor.initial, np.diag(sensor.typical_sigma**2), "typical")
    x, P = known
    return Camera(x, np.zeros((len(x), len(x))), "none") if P is None else Camera(x, P, "calibration")


def to_seconds(time_utc: TimeArray) -> FloatArray:
    """Seconds from J2000.0, (n,): UTC without leap seconds."""
    return np.asarray((time_utc - _EPOCH) / np.timedelta64(1, "s"), np.float64)


def write_time(seconds: float) -> str:
    """Write seconds from J2000.0 in ISO 8601, to the millisecond."""
    moment = _EPOCH + np.timedelta64(round(seconds * 1e3), "ms")
    return f"{moment.astype('datetime64[ms]')}Z"


def tracker_side(
    telemetry: Telemetry,
    sensor: Sensor,
    camera: Camera,
    catalogue: Catalogue,
    settings: CalibrationSettings,
    cache_folder: Path | None = None,
) -> Side:
    """Solve a tracker's exposures; refuses telemetry without times, or with no exposure that can be solved."""
    if telemetry.time_utc is None or np.isnat(telemetry.time_utc).all():
        raise RefusedInputError(
            f"The telemetry of {sensor.name} has no times, which are needed to pair attitudes: add a time_utc column."
        )
    stars = put_right(telemetry, sensor, catalogue, camera.x)
    # what matching expects of a camera must not be less than what it is off: a ground calibration's where nobody knows
    spread = camera.P if camera.parameters == "calibration" else np.diag((3.0 * sensor.typical_sigma) ** 2)
    matches = rematch(stars, sensor, catalogue, camera.x, spread, settings, cache_folder)
    arcs = make_problem(stars, sensor, matches.s_i, settings.minimum_stars).arcs.whole()
    exposures = len(matches.exposure)
    if not arcs.n_exposures:
        raise RefusedInputError(
            f"No exposure of {sensor.name} can be solved: check the sensor file and parameters, or run `boresight diagnose`."
        )
    sigma = angular_sigma(arcs.camera, camera.x, arcs)
    s_d = arcs.camera.directions(camera.x, arcs.row_px, arcs.col_px, arcs.pitch)
    solved = attitudes(arcs.star_start, s_d, arcs.s_i, sigma, sensor.parity)
    J, _ = sensitivity_of_exposures(arcs, np.arange(arcs.n_stars), arcs.star_start[:-1], camera.x, sigma, sensor.parity)
    rows = arcs.source_row[arcs.star_start[:-1]]
    warmth = np.full(len(rows), np.nan) if telemetry.temperature_c is None else telemetry.temperature_c[rows]
    usable = solved.known & ~np.isnat(telemetry.time_utc[rows])
    seconds = to_seconds(telemetry.time_utc[rows])
    order = _ascending(seconds, usable)
    series = AttitudeSeries(
        time_s=seconds[order],
        C=solved.C[order],
        covariance=solved.covariance[order],
        shared=J[order] @ square_root(camera.P),
        temperature_c=within(warmth[order], TEMPERATURES_C),
    )
    _check_size(sensor.name, len(order))
    counts = np.diff(arcs.star_start)[order]
    return Side(
        sensor.name, series, telemetry.frame[rows][order], telemetry.exposure[rows][order], counts, camera.parameters,
        exposures, dict(zip(arcs.camera.parameter_names, camera.x.tolist(), strict=True)),
    )  # fmt: skip


def _ascending(seconds: FloatArray, usable: np.ndarray) -> IntArray:
    """Places of the usable in order of time, of equal times the first."""
    places = np.flatnonzero(usable)
    return np.asarray(places[np.unique(seconds[places], return_index=True)[1]])


def _check_size(name: str, attitudes: int) -> None:
    if not attitudes:
        raise RefusedInputError(f"{name} has no attitude at a known time: give times and quaternions.")
    if attitudes > MOST_ATTITUDES:
        raise RefusedInputError(f"{name} has {attitudes:,} attitudes: give at most {MOST_ATTITUDES:,}.")


def reference_side(
    name: str,
    found: Attitudes,
    beside: dict[str, FloatArray],
    *,
    sigma_arcsec: float | None = None,
    bias_arcsec: float = 0.0,
) -> Side:
    """Take a table of attitudes for a reference; `sigma_arcsec` counts where its columns say nothing."""
    n = len(found.time_utc)
    _check_size(name, n)
    stated = REFERENCE_SIGMA_ARCSEC if sigma_arcsec is None else sigma_arcsec
    for what, value, least in (("sigma", stated, SMALLEST_ARCSEC), ("bias", bias_arcsec, 0.0)):
        if not least <= value <= LARGEST_ARCSEC:
            raise RefusedInputError(
                f"The reference's {what} is {value:g} arcsec: choose a value from {least:g} to {LARGEST_ARCSEC:g}."
            )
    columns = SIGMAS if all(one in beside for one in SIGMAS) else (SIGMA,) * 3 if SIGMA in beside else ()
    sigma = np.column_stack([beside[one] for one in columns]) if columns else np.full((n, 3), np.nan)
    sigma = np.where(np.isfinite(sigma), sigma, stated)
    wrong = np.flatnonzero(((sigma < SMALLEST_ARCSEC) | (sigma > LARGEST_ARCSEC)).any(axis=1))
    if len(wrong):
        raise RefusedInputError(
            f"{name}: the sigma at {found.time_utc[wrong[0]]} is not between {SMALLEST_ARCSEC:g} and {LARGEST_ARCSEC:g} arcsec: "
            "correct it."
        )
    rad = sigma / ARCSEC_PER_RAD
    series = AttitudeSeries(
        time_s=to_seconds(found.time_utc),
        C=to_matrix(found.quaternion),
        covariance=rad[:, :, None] ** 2 * np.eye(3),
        shared=np.broadcast_to(bias_arcsec / ARCSEC_PER_RAD * np.eye(3), (n, 3, 3)),
        temperature_c=within(beside.get("temperature_c", np.full(n, np.nan)), TEMPERATURES_C),
    )
    none = np.full(n, -1)
    return Side(name, series, none, none, np.zeros(n, np.int64), "reference", n)
