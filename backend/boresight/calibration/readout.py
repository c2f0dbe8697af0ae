"""Rolling shutter: centroids moved back to the time of the first line, by the rate of the attitude.

Line l is read at t_0 + l tau, tau the line time. Let v be a star's direction in the right-handed detector triad and w the rate of
the attitude about its axes, C(t + dt) = C(w dt) C(t). The star was then seen at

    v(t_0 + l tau) = C(w l tau) v(t_0)            so            v(t_0) = C(-w l tau) v,

with l the row (or column) of the centroid itself, for the star is where its own line sees it. Pixels become directions and
directions pixels under a state x of the camera: only the displacement depends on x, in proportion, so that a focal length off
by 1 % leaves 1 % of it; a calibration repeats the correction at its result (`calibration.corrections`). Left in, the displacement
is linear in l at a constant rate: along the rows it is a scale of the rows, which a camera with that freedom takes up whole.

The rate comes from attitudes q_k at times t_k, those of the telemetry or else solved from identified stars:

    w_k = rotation(q_b q_a^-1) / (t_b - t_a)

from the neighbours before and after where both are about as near, else from the nearer one and the exposure itself. Two exposures
of a frame, dt apart, have each an attitude good to about sigma / sqrt(n) pixels, so the correction at the last line L adds an
error of sqrt(2 / n) (L tau / dt) sigma: 0.12 sigma for eleven stars read in 0.07 s and taken 0.25 s apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from boresight.arrays import BoolArray, FloatArray, IntArray, TimeArray
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.attitude import (
    attitudes,
    conjugate,
    product,
    rotation_vector,
    to_matrix,
    triad,
    vector_to_quaternion,
)
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import star_directions
from boresight.telemetry.schema import Telemetry, find_exposures
from boresight.telemetry.sensors import Sensor

#: Seconds between exposures beyond which nothing is known of the rate between them.
MOST_GAP_S = 60.0
#: Gaps before and after an exposure that differ by more than this factor are not taken together.
ABOUT_AS_NEAR = 3.0
FEWEST_STARS = 3
FROM_QUATERNIONS, FROM_STARS = "the quaternions of the telemetry", "attitudes solved from the stars"


@dataclass(frozen=True)
class Rates:
    """Rates of the attitude.

    `w`: (n_exposures, 3) about the axes of the detector triad, rad/s, NaN where unknown. `source`: what they come from.
    """

    w: FloatArray
    source: str

    @property
    def known(self) -> BoolArray:
        """(n_exposures,) of which exposures the rate is known."""
        return np.isfinite(self.w[:, 0])


def compute_rates(quaternion: FloatArray, time_utc: TimeArray) -> FloatArray:
    """Rates (n, 3), rad/s, of attitudes (n, 4) at times (n,) that ascend; NaN where no neighbour is near enough in time."""
    n = len(quaternion)
    usable = np.isfinite(quaternion).all(axis=1) & ~np.isnat(time_utc)
    at = np.flatnonzero(usable)
    w = np.full((n, 3), np.nan)
    if len(at) < 2:
        return w
    t = (time_utc[at] - time_utc[at[0]]) / np.timedelta64(1, "us") * 1e-6
    first, last = _neighbours(t)
    turned = rotation_vector(product(quaternion[at[last]], conjugate(quaternion[at[first]])))
    dt = t[last] - t[first]
    near = (dt > 0) & (dt <= 2 * MOST_GAP_S)
    w[at[near]] = turned[near] / dt[near, None]
    return w


def _neighbours(t: FloatArray) -> tuple[IntArray, IntArray]:
    """Places of the exposures before and after that each rate comes from, of times (n,) in seconds."""
    place, gap = np.arange(len(t)), np.diff(t)
    gap = np.where((gap > 0) & (gap <= MOST_GAP_S), gap, np.inf)
    before, after = np.append(np.inf, gap), np.append(gap, np.inf)
    nearest = np.minimum(before, after)
    known = np.isfinite(nearest)
    use_before = known & (before <= ABOUT_AS_NEAR * nearest)
    use_after = known & (after <= ABOUT_AS_NEAR * nearest)
    return place - use_before, place + use_after


def find_rates(telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue, x: FloatArray) -> Rates | None:
    """Rates of a set's exposures, from its quaternions, else from its identified stars; None where neither tells them.

    `x`: (n_parameters,) state that solves attitudes.
    """
    if telemetry.time_utc is None:
        return None
    exposures = find_exposures(telemetry)
    time_utc = telemetry.time_utc[exposures.start]
    if telemetry.quaternion is not None:
        w = compute_rates(telemetry.quaternion[exposures.start], time_utc)
        if np.isfinite(w).any():
            return Rates(w, FROM_QUATERNIONS)
    solved = _solved(telemetry, sensor, catalogue, x)
    if solved is None:
        return None
    w = compute_rates(solved, time_utc)
    return Rates(w, FROM_STARS) if np.isfinite(w).any() else None


def _solved(telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue, x: FloatArray) -> FloatArray | None:
    """Attitudes (n_exposures, 4) from identified stars, NaN where there are too few; None where no star is identified."""
    if telemetry.star_id is None and telemetry.ra_rad is None:
        return None
    s_i = star_directions(
        telemetry.star_id, telemetry.ra_rad, telemetry.dec_rad, telemetry.time_utc, telemetry.velocity_m_s, catalogue,
        telemetry.site,
    )  # fmt: skip
    exposure = find_exposures(telemetry).of_entry
    camera = CAMERA_MODELS[sensor.camera_model]
    s_d = camera.directions(x, telemetry.row_px, telemetry.col_px, sensor.pixel_pitch_m)
    rows = np.flatnonzero(np.isfinite(s_i[:, 0]) & np.isfinite(s_d[:, 0]))
    if not len(rows):
        return None
    counts = np.bincount(exposure[rows], minlength=exposure[-1] + 1)
    starts = np.append(0, np.cumsum(counts))
    found = attitudes(starts, s_d[rows], s_i[rows], np.ones(len(rows)), sensor.parity)
    quaternion = found.quaternion
    quaternion[counts < FEWEST_STARS] = np.nan
    return quaternion


@dataclass(frozen=True)
class ReadoutCorrection:
    """What was done about a rolling shutter.

    `source`: what the rates came from; empty where there were none, and nothing was moved. `exposures`, `moved`: of the set, and
    those whose centroids were moved. `largest_px`: the largest displacement. `rate_deg_s`: median rate.
    """

    source: str = ""
    exposures: int = 0
    moved: int = 0
    largest_px: float = 0.0
    rate_deg_s: float = 0.0

    def with_part(self, other: ReadoutCorrection) -> ReadoutCorrection:
        """Add another part of the same set."""
        return ReadoutCorrection(
            source=self.source or other.source,
            exposures=self.exposures + other.exposures,
            moved=self.moved + other.moved,
            largest_px=max(self.largest_px, other.largest_px),
            rate_deg_s=max(self.rate_deg_s, other.rate_deg_s),
        )


def correct_readout(
    telemetry: Telemetry, sensor: Sensor, rates: Rates | None, x: FloatArray
) -> tuple[Telemetry, ReadoutCorrection]:
    """Move centroids back to the time of the first line; `x` (n_parameters,) turns pixels into directions."""
    exposures = find_exposures(telemetry)
    readout = sensor.readout
    if readout is None or readout.line_time_s is None or rates is None:
        return telemetry, ReadoutCorrection(exposures=len(exposures))
    w = rates.w[exposures.of_entry]
    rows = np.flatnonzero(np.isfinite(w[:, 0]))
    line = (telemetry.row_px if readout.axis == "rows" else telemetry.col_px)[rows]
    turn = -w[rows] * (line * readout.line_time_s)[:, None]
    row, col = turned_px(sensor, x, telemetry.row_px[rows], telemetry.col_px[rows], turn)
    moved = np.isfinite(row) & np.isfinite(col)
    rows, row, col = rows[moved], row[moved], col[moved]
    far = np.hypot(row - telemetry.row_px[rows], col - telemetry.col_px[rows])
    row_px, col_px = telemetry.row_px.copy(), telemetry.col_px.copy()
    row_px[rows], col_px[rows] = row, col
    speed = np.linalg.norm(rates.w[rates.known], axis=1)
    return replace(telemetry, row_px=row_px, col_px=col_px), ReadoutCorrection(
        source=rates.source,
        exposures=len(exposures),
        moved=int(rates.known.sum()),
        largest_px=float(far.max(initial=0.0)),
        rate_deg_s=float(np.degrees(np.median(speed))) if len(speed) else 0.0,
    )


def turned_px(
    sensor: Sensor, x: FloatArray, row_px: FloatArray, col_px: FloatArray, turn: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Places (n,) of centroids (n,) once the triad is turned by rotation vectors (n, 3), rad."""
    camera, pitch = CAMERA_MODELS[sensor.camera_model], sensor.pixel_pitch_m
    v = triad(camera.directions(x, row_px, col_px, pitch), sensor.parity)
    turned = np.einsum("nij,nj->ni", to_matrix(vector_to_quaternion(turn)), v)
    return camera.project(x, triad(turned, sensor.parity), pitch)


def find_speed_px_s(sensor: Sensor, x: FloatArray, row_px: FloatArray, col_px: FloatArray, w: FloatArray) -> FloatArray:
    """How fast stars (n,) move over the detector at rates w (n, 3) rad/s, (n,) pixels a second; NaN where a rate is."""
    step_s = 1e-3
    row, col = turned_px(sensor, x, row_px, col_px, np.nan_to_num(w) * step_s)
    speed = np.hypot(row - row_px, col - col_px) / step_s
    return np.where(np.isfinite(w[:, 0]), speed, np.nan)
