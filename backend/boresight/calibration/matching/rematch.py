"""Matching a telemetry set again under any parameters: the ground's re-run of the flight software's matching.

`sky.matching` does the work and derives it; here a telemetry set and a sensor are made into the detections that matching takes
(directions, their errors, given stars, times), once, and then matched as often as its
parameters change. The tolerance comes from P, the covariance of the parameters matched with: that of a ground
calibration is `ground_covariance`, (initial_sigma_scale typical sigmas)^2, that of a result its own, with the ground's
for what it held fixed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.attitude import to_quaternion, triad
from boresight.sky import identification, matching
from boresight.sky.catalogue import Catalogue
from boresight.sky.directions import star_directions
from boresight.sky.guide_stars import (
    FAINTER_MAG,
    LARGEST_PULL,
    GuideStars,
    compute_pulls,
    guide_stars,
    observer_motion,
    star_flags,
)
from boresight.sky.matching import Detections
from boresight.telemetry.quality.detector import on_detector
from boresight.telemetry.schema import Telemetry, find_exposures
from boresight.telemetry.sensors import Sensor

#: Stars move by proper motion and aberration while the catalogue stands still: margin of the field.
CONE_MARGIN_RAD = float(np.radians(0.3))
#: Where a sensor file gives no limit: this much fainter than the faintest star named in the set.
MARGIN_MAG = 0.5
#: Rows whose derivatives are taken at a time.
CHUNK_ROWS = 2_048


def given_stars(telemetry: Telemetry, catalogue: Catalogue) -> tuple[IntArray, FloatArray, NDArray[np.bool_]]:
    """Star numbers given in the file, (n_rows,), 0 = none; their directions (n_rows, 3); whether these are the file's own."""
    n = len(telemetry)
    if telemetry.star_id is None or not (telemetry.star_id > 0).any():
        return np.zeros(n, np.int64), np.full((n, 3), np.nan), np.zeros(n, np.bool_)
    own = np.zeros(n, np.bool_) if telemetry.ra_rad is None else np.isfinite(telemetry.ra_rad)
    given_s = star_directions(
        telemetry.star_id, telemetry.ra_rad, telemetry.dec_rad, telemetry.time_utc, telemetry.velocity_m_s, catalogue,
        telemetry.site,
    )  # fmt: skip
    return np.maximum(telemetry.star_id, 0), given_s, own & (telemetry.star_id > 0)


def measured_directions(
    telemetry: Telemetry, rows: slice, sensor: Sensor, x: FloatArray, P: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions of some rows in the right-handed triad, their derivative times P^(1/2), and their errors.

    Returns
    -------
    s
        (n, 3) unit vectors.
    G
        (n, 3, p) ds/dx P^(1/2), p the rank of P.
    sigma_rad
        (n,) isotropic direction error.
    """
    camera, pitch, n = CAMERA_MODELS[sensor.camera_model], sensor.pixel_pitch_m, rows.stop - rows.start
    root = square_root(P)
    s, G, sigma = np.empty((n, 3)), np.empty((n, 3, root.shape[1])), centroid_sigma_px(telemetry, sensor)[rows].copy()
    sign = np.array([1.0, float(sensor.parity), 1.0])[:, None]
    for begin in range(0, n, CHUNK_ROWS):
        part = slice(begin, min(begin + CHUNK_ROWS, n))
        whole = slice(rows.start + part.start, rows.start + part.stop)
        row, col = telemetry.row_px[whole], telemetry.col_px[whole]
        directions, jacobian = camera.directions_and_jacobian(x, row, col, pitch)
        s[part] = triad(directions, sensor.parity)
        G[part] = (jacobian.reshape(-1, len(x)) @ root).reshape(*jacobian.shape[:2], root.shape[1]) * sign
        sigma[part] *= np.sqrt(camera.solid_angle(x, row, col, pitch))
    return s, G, sigma


def centroid_sigma_px(telemetry: Telemetry, sensor: Sensor) -> FloatArray:
    """One-axis centroid error of every row, (n_rows,) pixels: the file's, else the sensor's."""
    common = np.full(len(telemetry), sensor.centroid_sigma_px)
    if telemetry.sigma_px is None:
        return common
    return np.where(np.isfinite(telemetry.sigma_px), telemetry.sigma_px, common)


def square_root(P: FloatArray) -> FloatArray:
    """P^(1/2), (n_parameters, p) with P = root root^T and p its rank; scaled first, for the units differ by 10^16."""
    scale = np.sqrt(np.maximum(np.diag(P), 0.0))
    free = np.flatnonzero(scale > 0)
    root = np.zeros((len(P), len(free)))
    if len(free):
        values, vectors = np.linalg.eigh(P[np.ix_(free, free)] / np.outer(scale[free], scale[free]))
        root[free] = scale[free, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def pixel_rad(sensor: Sensor, x: FloatArray) -> float:
    """Angle of a pixel in the middle of the detector, rad."""
    middle = np.array([(sensor.rows - 1) / 2]), np.array([(sensor.columns - 1) / 2])
    omega = CAMERA_MODELS[sensor.camera_model].solid_angle(x, *middle, sensor.pixel_pitch_m)
    return float(np.sqrt(omega[0]))


def cone_rad(sensor: Sensor, x: FloatArray) -> float:
    """Angle from the z axis of D to the farthest corner of the detector, with a margin, rad."""
    camera = CAMERA_MODELS[sensor.camera_model]
    return camera.cone_rad(x, sensor.rows, sensor.columns, sensor.pixel_pitch_m) + CONE_MARGIN_RAD


def magnitude_limit(telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue, given: IntArray) -> float:
    """Faintest star that may be matched, Hp: the sensor's limit, else beyond the faintest named, else by how many are detected."""
    return compute_magnitude_limit(
        sensor, catalogue, np.unique(given[given > 0]), float(np.median(find_exposures(telemetry).count))
    )


def compute_magnitude_limit(sensor: Sensor, catalogue: Catalogue, named: IntArray, typical_stars: float) -> float:
    """As `magnitude_limit`, of a set that names these stars (n,) and detects so many an exposure."""
    if sensor.magnitude_limit is not None:
        return sensor.magnitude_limit
    index = catalogue.find_index(named)
    magnitude = catalogue.magnitude[index[index >= 0]]
    if len(magnitude):
        return float(magnitude.max() + MARGIN_MAG)
    field = 2 * np.pi * (1 - np.cos(cone_rad(sensor, sensor.initial)))
    wanted = 2 * typical_stars * 4 * np.pi / field
    return float(np.sort(catalogue.magnitude)[min(int(wanted), len(catalogue) - 1)])


def seconds(times: NDArray[np.datetime64], epoch: np.datetime64 | None = None) -> FloatArray:
    """Seconds from an epoch, or from the first known time, (n,); NaN where unknown."""
    known = ~np.isnat(times)
    elapsed = np.full(len(times), np.nan)
    if known.any():
        elapsed[known] = (times[known] - (times[known].min() if epoch is None else epoch)) / np.timedelta64(1, "s")
    return elapsed


#: Of two stars closer than this on the detector, one image shows the brighter.
BLEND_PX = 5.0


@dataclass(frozen=True)
class Matches:
    """A set as matched under some parameters; rows and exposures in file order.

    `star_id`: (n_rows,) Hipparcos number, 0 = unmatched. `s_i`: (n_rows, 3) apparent direction of the matched star, ICRS; NaN
    where unmatched. `row_reason`: (n_rows,) place in `sky.matching.ROW_REASONS`. `tolerance_rad`: (n_rows,) radius of the gate
    each match had to fall in; NaN where unmatched. `exposure_start`: (n_exposures + 1,) first row of each exposure. `frame`,
    `exposure`: (n_exposures,) their numbers. `start`: (n_exposures,) place in `sky.matching.STARTS`: where the attitude came
    from. `reason`: (n_exposures,) place in `sky.matching.EXPOSURE_REASONS`. `quaternion`: (n_exposures, 4) attitude under the
    parameters matched with, x y z w, ICRS to the right-handed triad of D; NaN where none. `attitude_covariance`: (n_exposures,
    3, 3) about the axes of that triad, rad^2: centroid noise and parameters. `flags`: (n_rows,) of the matched star, see
    `sky.guide_stars`.
    """

    star_id: IntArray
    s_i: FloatArray
    row_reason: NDArray[np.int8]
    tolerance_rad: FloatArray
    exposure_start: IntArray
    frame: IntArray
    exposure: IntArray
    start: NDArray[np.int8]
    reason: NDArray[np.int8]
    quaternion: FloatArray
    attitude_covariance: FloatArray
    flags: NDArray[np.int8]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(n_exposures,) whether enough stars were matched."""
        return np.asarray(self.reason == 0)

    @property
    def matched(self) -> IntArray:
        """(n_exposures,) matched stars."""
        return np.asarray(np.add.reduceat(self.star_id > 0, self.exposure_start[:-1], dtype=np.int64))


def ground_covariance(sensor: Sensor, initial_sigma_scale: float) -> FloatArray:
    """Covariance of a sensor's ground calibration, (n_parameters, n_parameters) SI: so many typical sigmas each."""
    return np.asarray(np.diag((initial_sigma_scale * sensor.typical_sigma) ** 2))


@dataclass(frozen=True)
class MatchingSky:
    """The stars that a set may be matched with: those that can be guided on, and what is against any of them."""

    guides: GuideStars
    flagged: Catalogue
    flags: NDArray[np.int8]


def matching_sky(catalogue: Catalogue, magnitude_limit: float, blend_rad: float) -> MatchingSky:
    """Choose the stars down to a limit, Hp, where two within `blend_rad` make one image."""
    # a companion beyond the catalogue's cut here would be too faint to matter
    flagged = catalogue.brighter_than(magnitude_limit + FAINTER_MAG)
    return MatchingSky(guide_stars(catalogue, magnitude_limit, blend_rad), flagged, star_flags(flagged, blend_rad))


def blend_rad(sensor: Sensor) -> float:
    """Angle of `BLEND_PX` in the middle of the detector, rad."""
    return BLEND_PX * pixel_rad(sensor, sensor.initial)


class Rematcher:
    """A telemetry set ready to be matched under any parameters.

    `telemetry`, `sensor`, `catalogue`: the set, whose it is, and the stars there are. `settings`: `minimum_stars`,
    `leave_out_doubles` and `blends` count here. `cache_folder`: where lost-in-space identification keeps its tables; None makes
    them again in every process. `sky`, `epoch`: where the telemetry is part of a set: the stars of the whole set, and the first
    time in it; None takes those of the part. `identified`: (n_exposures, 4) attitudes that identification found beforehand, NaN
    where none; None identifies frames without any other start when they come.
    """

    def __init__(
        self,
        telemetry: Telemetry,
        sensor: Sensor,
        catalogue: Catalogue,
        settings: CalibrationSettings,
        cache_folder: Path | None = None,
        sky: MatchingSky | None = None,
        epoch: np.datetime64 | None = None,
        *,
        identified: FloatArray | None = None,
    ) -> None:
        self._telemetry, self._sensor, self._settings = telemetry, sensor, settings
        self._identified = identified
        self._cache_folder = cache_folder
        self._exposures = find_exposures(telemetry)
        frame_first = np.unique(self._exposures.frame, return_index=True)[1]
        self._frame_start = np.append(frame_first, len(self._exposures)).astype(np.int64)
        self._row_start = np.append(self._exposures.start, len(telemetry)).astype(np.int64)
        self._given, self._given_s, self._own = given_stars(telemetry, catalogue)
        first = self._exposures.start
        unknown = np.full(len(first), np.datetime64("NaT", "us"))
        times = unknown if telemetry.time_utc is None else telemetry.time_utc[first]
        self._time_s = seconds(times[frame_first], epoch)
        nowhere = np.full((len(first), 4), np.nan)
        self._quaternion = nowhere if telemetry.quaternion is None else telemetry.quaternion[first]
        velocity = None if telemetry.velocity_m_s is None else telemetry.velocity_m_s[first]
        self._motion = observer_motion(times, velocity, telemetry.site)
        if sky is None:
            limit = magnitude_limit(telemetry, sensor, catalogue, self._given)
            sky = matching_sky(catalogue, limit, blend_rad(sensor))
        # A detection off the detector is no star's image: it has no direction, and names none.
        self._off = ~on_detector(telemetry, sensor)
        self._given = np.where(self._off, 0, self._given)
        self._given_s = np.where(self._off[:, None], np.nan, self._given_s)
        self._own &= ~self._off
        self._stars, self._flagged, self._flags = sky.guides, sky.flagged, sky.flags
        self._pull_px = np.full(len(self._flagged), np.nan)

    @property
    def n_frames(self) -> int:
        """Frames of the set."""
        return len(self._frame_start) - 1

    def rows(self, frames: slice) -> slice:
        """Rows of consecutive frames."""
        k0, k1, _ = frames.indices(self.n_frames)
        ends = self._row_start[self._frame_start[[k0, k1]]]
        return slice(int(ends[0]), int(ends[1]))

    def __call__(self, x: FloatArray, P: FloatArray, frames: slice = slice(None), noise: float = 1.0) -> Matches:
        """Match the set, or consecutive frames of it, under parameters x with covariance P, SI, centroid errors times `noise`."""
        k0, k1, _ = frames.indices(self.n_frames)
        e0, e1 = int(self._frame_start[k0]), int(self._frame_start[k1])
        rows, exposures = self.rows(frames), slice(e0, e1)
        s, G, sigma = measured_directions(self._telemetry, rows, self._sensor, x, P)
        s[self._off[rows]] = np.nan
        detections = Detections(
            frame_start=self._frame_start[k0 : k1 + 1] - e0,
            row_start=self._row_start[e0 : e1 + 1] - rows.start,
            s=s,
            G=G,
            sigma_rad=noise * sigma,
            star_id=self._given[rows],
            given_s=self._given_s[rows],
            own=self._own[rows],
            quaternion=self._quaternion[exposures],
            time_s=self._time_s[k0:k1],
        )
        identify = self._identifier(detections, x, rows, e0)
        answer = matching.match(
            detections, self._stars, self._motion[exposures], cone_rad(self._sensor, x),
            self._settings.minimum_stars, identify,
        )  # fmt: skip
        return self._matches(answer, detections, exposures, rows)

    def _identifier(
        self, detections: Detections, x: FloatArray, rows: slice, first_exposure: int
    ) -> matching.Identify | None:
        """Lost-in-space identification of one exposure of these detections, which are in the triad already.

        None where a corner of the detector has no direction under x, or the field of view is none of a star tracker: such a field
        matches no pattern.
        """
        if (known := self._identified) is not None:
            attitudes = [quaternion if np.isfinite(quaternion[0]) else None for quaternion in known[first_exposure:]]
            return attitudes.__getitem__
        magnitude = None if self._telemetry.magnitude is None else self._telemetry.magnitude[rows]
        sensor, camera = self._sensor, CAMERA_MODELS[self._sensor.camera_model]
        if camera.blind_corner(x, sensor.rows, sensor.columns, sensor.pixel_pitch_m) is not None:
            return None
        field_deg = identification.field_of_view_deg(camera, x, sensor.rows, sensor.columns, sensor.pixel_pitch_m)
        if not identification.FIELDS_DEG[0] <= field_deg <= identification.FIELDS_DEG[1]:
            return None

        def identify(exposure: int) -> FloatArray | None:
            of = np.arange(*detections.row_start[exposure : exposure + 2])
            of = of[np.isfinite(detections.s[of, 0])]  # a false star far off the detector may have no direction
            bright = None if magnitude is None else magnitude[of]
            return identification.identify(detections.s[of], bright, 1, field_deg, self._cache_folder)

        return identify

    def _matches(self, answer: matching.Association, detections: Detections, exposures: slice, rows: slice) -> Matches:
        """Flag the matched stars, leave out the flagged ones where asked, and name exposures and frames."""
        index, off = self._flagged.find_index(answer.star_id), self._off[rows]
        flags = np.where((answer.star_id > 0) & (index >= 0), self._flags[index], 0).astype(np.int8)
        left_out = (flags > 0) & self._settings.leave_out_doubles
        blended = self._blended(np.where(answer.star_id > 0, index, -1), rows) & ~left_out
        gone = left_out | blended
        timeless = np.isnan(self._motion.years[exposures])
        return Matches(
            star_id=np.where(gone, 0, answer.star_id),
            s_i=np.where(gone[:, None], np.nan, answer.s_i),
            row_reason=np.select(
                [off, left_out, blended],
                [matching.OFF_DETECTOR, matching.LEFT_OUT, matching.BLENDED],
                answer.row_reason,
            ).astype(np.int8),
            tolerance_rad=answer.tolerance_rad,
            exposure_start=detections.row_start,
            frame=self._exposures.frame[exposures],
            exposure=self._exposures.exposure[exposures],
            start=answer.start,
            reason=np.where((answer.reason > 0) & timeless, matching.NO_TIME, answer.reason).astype(np.int8),
            quaternion=to_quaternion(answer.C),
            attitude_covariance=answer.covariance,
            flags=flags,
        )

    def _blended(self, index: IntArray, rows: slice) -> NDArray[np.bool_]:
        """Tell which rows show a star, by its place (n,) among the flagged, that neighbours draw too far; -1 is none."""
        psf_px, blended = self._telemetry.psf_sigma_px, np.zeros(len(index), np.bool_)
        if self._settings.blends == "keep" or psf_px is None or not np.isfinite(psf_px).any():
            return blended
        new = np.unique(index[index >= 0])
        new = new[np.isnan(self._pull_px[new])]
        pixel = pixel_rad(self._sensor, self._sensor.initial)
        self._pull_px[new] = compute_pulls(self._flagged, new, float(np.nanmedian(psf_px)) * pixel) / pixel
        known = (index >= 0) & np.isfinite(psf_px[rows])
        sigma_px = centroid_sigma_px(self._telemetry, self._sensor)[rows]
        blended[known] = self._pull_px[index[known]] > LARGEST_PULL * sigma_px[known]
        return blended


def rematch(
    telemetry: Telemetry,
    sensor: Sensor,
    catalogue: Catalogue,
    x: FloatArray,
    P: FloatArray,
    settings: CalibrationSettings,
    cache_folder: Path | None = None,
) -> Matches:
    """Match a set once under parameters x (n_parameters,) with covariance P, SI; see `Rematcher`."""
    return Rematcher(telemetry, sensor, catalogue, settings, cache_folder)(x, P)


def matched_telemetry(telemetry: Telemetry, matches: Matches) -> Telemetry:
    """Return the set with the stars and apparent directions it was matched with."""
    x, y, z = matches.s_i.T
    return replace(telemetry, star_id=matches.star_id, ra_rad=np.arctan2(y, x) % (2 * np.pi), dec_rad=np.arcsin(z))


def joined_matches(parts: Sequence[Matches]) -> Matches:
    """Join the matches of consecutive parts of a set."""
    if len(parts) == 1:
        return parts[0]
    names = [item.name for item in fields(Matches) if item.name != "exposure_start"]
    arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    rows = np.cumsum([0, *(len(part.star_id) for part in parts)])
    starts = [part.exposure_start[:-1] + begin for part, begin in zip(parts, rows[:-1], strict=True)]
    return Matches(exposure_start=np.concatenate([*starts, rows[-1:]]), **arrays)
