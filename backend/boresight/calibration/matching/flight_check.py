"""What the flight code would make of an exposure: which of its matches agree, and whether it would report an attitude.

A re-match on the ground knows the covariance of its parameters and forgives what they explain. The flight code does not: it
holds each arc between two detections against the catalogue's with one fixed tolerance, "potential matches are allowed or rejected
based on the consistency of their geometry", and when "the sensed geometry is of questionable quality" it reports "a failed match"
(E sections III-A.2 and III). With measured directions s_i(x) and catalogue arcs phi_ij,

    | phi_ij(x) - phi_ij | <= tolerance        for every two matches i, j that are accepted,

and an exposure is valid when at least N_min matches are accepted and they are more than two thirds of its matches. The
availability of x is the share of frames with a valid exposure.

The flight code's tolerance is not published; ours is `ARC_SIGMAS` = 5 sigmas of an arc at the detector's centre,

    tolerance = 5 sqrt(2) sigma_px Delta / f,

422 urad on the ST-16, beyond which a true arc falls once in a million. The share is needed because a wrong focal
length stretches short arcs by less than the tolerance: without it four neighbours pass at any calibration. Both were chosen by
measurement on the simulated calibration sets, ground calibration against truth (given matches, 200 frames):

=======================  ===========  ===========  ===========  ===========  ===========  ===========
availability             sensor 1     2            3            4            5            6
=======================  ===========  ===========  ===========  ===========  ===========  ===========
5 sigmas, no share       0.84 1.00    0.78 1.00    0.92 0.98    0.89 1.00    0.97 0.97    0.99 1.00
1.5 sigmas, no share     0.34 1.00    0.12 1.00    0.36 0.97    0.40 1.00    0.88 0.94    0.75 1.00
5 sigmas, one half       0.73 1.00    0.28 1.00    0.78 0.98    0.69 1.00    0.97 0.97    0.99 1.00
5 sigmas, two thirds     0.26 1.00    0.03 1.00    0.20 0.98    0.09 1.00    0.97 0.97    0.91 1.00
6 sigmas, two thirds     0.52 1.00    0.08 1.00    0.41 0.98    0.17 1.00    0.97 0.97    0.96 1.00
E Table IV               0.96 1.00    0.98 1.00    0.44 0.98    0.46 1.00    1.00 1.00    0.93 0.97
=======================  ===========  ===========  ===========  ===========  ===========  ===========

1.5 sigmas alone would also part ground and truth, but drop a quarter of the true matches at the truth. Sensors 1 and 2 cannot
be met by any choice: E gives them the same changes as 3 and 4, and their absolute parameters are not published.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import BoolArray, FloatArray, IntArray
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.blocks import in_blocks
from boresight.kernels.flight import agreeing_matches
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

#: Tolerance of an arc, in its standard deviations at the detector's centre.
ARC_SIGMAS = 5.0
#: More than so many of so many of an exposure's matches must agree.
AGREEING, OF = 2, 3
FLIGHT_REASONS = (
    "valid",
    "fewer stars matched than required",
    "fewer matches agree than required",
    "no more than two thirds of the matches agree",
)


class FlightCheckInput(Protocol):
    """What the flight code is told: arrays over the rows and the exposures of a telemetry set, in file order."""

    @property
    def s_i(self) -> FloatArray:
        """(n_rows, 3) apparent direction of the matched star, NaN where none is."""

    @property
    def exposure_start(self) -> IntArray:
        """(n_exposures + 1,) first row of each exposure."""

    @property
    def frame(self) -> IntArray:
        """(n_exposures,) frame number of each exposure, ascending."""


@dataclass(frozen=True)
class FlightCheck:
    """What the flight code accepts.

    `accepted`: (n_rows,) matches whose arcs all agree. `valid`: (n_exposures,) whether an attitude would be reported. `reason`:
    (n_exposures,) index into `FLIGHT_REASONS`, 0 = valid. `frames`: (n_frames,) frame numbers. `valid_frames`: (n_frames,)
    whether any exposure of the frame is valid. `matched_in_frame`: (n_frames,) accepted matches of its valid exposures.
    """

    accepted: BoolArray
    valid: BoolArray
    reason: NDArray[np.int8]
    frames: IntArray
    valid_frames: BoolArray
    matched_in_frame: IntArray

    @property
    def availability(self) -> float:
        """Share of frames with a valid exposure (E section III)."""
        return float(self.valid_frames.mean())

    @property
    def matched_stars(self) -> int:
        """N(x) of the matched star ratio (E Eq 30): accepted matches of all valid exposures."""
        return int(self.matched_in_frame.sum())


def compute_flight_tolerance(sensor: Sensor, settings: CalibrationSettings) -> float:
    """Largest disagreement of an arc that the flight code accepts, rad: as set, or `ARC_SIGMAS` sigmas of an arc."""
    if settings.flight_tolerance_urad is not None:
        return settings.flight_tolerance_urad * 1e-6
    focal_px = CAMERA_MODELS[sensor.camera_model].focal_px(sensor.initial, sensor.pixel_pitch_m)
    return float(ARC_SIGMAS * np.sqrt(2.0) * sensor.centroid_sigma_px / focal_px)


def check_flight(
    telemetry: Telemetry,
    sensor: Sensor,
    matches: FlightCheckInput,
    x: FloatArray,
    tolerance_rad: float,
    minimum_stars: int,
) -> FlightCheck:
    """Apply the flight code's check to matches under a state.

    `telemetry`, `sensor`: the detections, at least one row, and the camera they are of. `matches`: which star each detection
    is, however that was found. `x`: (n_parameters,) state, SI. `tolerance_rad`: largest disagreement of an arc.
    `minimum_stars`: least number of matches of a valid exposure.
    """
    camera = CAMERA_MODELS[sensor.camera_model]
    s_d = camera.directions(x, telemetry.row_px, telemetry.col_px, sensor.pixel_pitch_m)
    matched = np.isfinite(matches.s_i[:, 0])
    accepted = np.zeros(len(telemetry), np.bool_)
    s_d, s_i, starts = np.ascontiguousarray(s_d), np.ascontiguousarray(matches.s_i), matches.exposure_start

    def check(first: int, last: int) -> None:
        rows = slice(int(starts[first]), int(starts[last]))
        agreeing_matches(
            starts[first : last + 1] - rows.start, s_d[rows], s_i[rows], matched[rows], tolerance_rad, accepted[rows]
        )

    in_blocks(check, len(starts) - 1)
    counts = np.add.reduceat(accepted, matches.exposure_start[:-1], dtype=np.int64)
    reason = _reasons(np.add.reduceat(matched, matches.exposure_start[:-1], dtype=np.int64), counts, minimum_stars)
    valid = reason == 0
    frames, first = np.unique(matches.frame, return_index=True)
    return FlightCheck(
        accepted=accepted,
        valid=valid,
        reason=reason,
        frames=frames,
        valid_frames=np.logical_or.reduceat(valid, first),
        matched_in_frame=np.add.reduceat(np.where(valid, counts, 0), first),
    )


def _reasons(matched: IntArray, agreeing: IntArray, minimum_stars: int) -> NDArray[np.int8]:
    """Why each exposure is not valid, (n_exposures,) index into `FLIGHT_REASONS`; the first that applies."""
    tests = (matched < minimum_stars, agreeing < minimum_stars, OF * agreeing <= AGREEING * matched)
    return np.select(tests, (1, 2, 3), 0).astype(np.int8)
