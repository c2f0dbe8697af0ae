"""What matching costs a frame, beside one batch evaluation of the same frames and a peer: a part of `boresight bench`.

Frames of real stars (`studies.star_frames`) with half of their names taken away are matched from the ground calibration, the hard
case: ten typical sigmas of parameter uncertainty. The batch evaluation is of the same frames with all names.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from boresight.arrays import IntArray
from boresight.calibration import detections
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.calibration.rematch import Rematcher, ground_covariance
from boresight.estimation import batch
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.simulation.sensors import ST16_MAGNITUDE_LIMIT, st16_sensor, st16_truth
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.studies.matching_peer import scipy_match
from boresight.studies.repeats import fastest, fastest_of_each
from boresight.studies.star_frames import EXPOSURES_A_FRAME, STARS, TIME, star_frames
from boresight.telemetry.schema import Telemetry, rows_of
from boresight.telemetry.sensors import Sensor

MOST_FRAMES = 1000
REPEATS = 10
PEER_FRAMES = 100
#: Of the peer, rad: a ground calibration puts stars a dozen pixels off.
PEER_TOLERANCE_RAD = 2e-3


def measure(frames: int, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """Time matching and one batch evaluation of at most `MOST_FRAMES` frames; returns microseconds a frame, ours and the peer's."""
    sensor, catalogue, n = st16_sensor(1), load_catalogue(None), min(frames, MOST_FRAMES)
    named = star_frames(n, sensor, st16_truth(1), catalogue, rng)
    half = _half_named(named, rng)
    x, P = sensor.initial, ground_covariance(sensor, 10.0)
    matcher = Rematcher(half, sensor, catalogue, CalibrationSettings())
    matcher(x, P, slice(0, 2))
    arcs = build_problem(named, sensor, catalogue).weighed(x).whole()
    free = np.arange(len(x))
    matching, evaluation = fastest_of_each(
        lambda: matcher(x, P), lambda: batch.normal_equations(arcs, x, free, sensor.typical_sigma), repeats=REPEATS
    )
    ours = {
        "match_us_per_frame": matching / n * 1e6,
        "match_batch_evaluation_us_per_frame": evaluation / n * 1e6,
    }
    few = min(n, PEER_FRAMES)
    part = rows_of(half, slice(0, few * EXPOSURES_A_FRAME * STARS))
    return ours, {"scipy_match_us_per_frame": _peer(part, sensor, catalogue) / few * 1e6}


def _half_named(telemetry: Telemetry, rng: np.random.Generator) -> Telemetry:
    """Take half of the names away."""
    return replace(telemetry, star_id=np.where(rng.random(len(telemetry)) < 0.5, 0, _names(telemetry)))


def _names(telemetry: Telemetry) -> IntArray:
    """(n_rows,) stars that a set names, 0 = none."""
    return np.zeros(len(telemetry), np.int64) if telemetry.star_id is None else telemetry.star_id


def _peer(telemetry: Telemetry, sensor: Sensor, catalogue: Catalogue) -> float:
    """Seconds that the peer needs for a set; its directions are included, as they are in ours, its catalogue is not."""
    given, bright = _names(telemetry), np.flatnonzero(catalogue.magnitude <= ST16_MAGNITUDE_LIMIT)
    s_i = apparent_directions(catalogue, bright, np.full(len(bright), TIME), None)
    row_start, x = np.arange(0, len(telemetry) + 1, STARS), sensor.initial
    cone = detections.cone_rad(sensor, x)
    camera = CAMERA_MODELS[sensor.camera_model]

    def run() -> None:
        s_d = camera.directions(x, telemetry.row_px, telemetry.col_px, sensor.pixel_pitch_m)
        scipy_match(row_start, s_d, given, catalogue.hip[bright], s_i, cone, PEER_TOLERANCE_RAD)

    return fastest(run, repeats=2)
