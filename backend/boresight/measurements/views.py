"""The views of one simulated set that every peer of `accuracy` gets: the same centroids, the same stars, known matches.

Real stars as `studies.star_frames` draws them: two exposures a frame, twelve stars each, every star named, centroids with the
sensor's noise. A view is an exposure: what a camera calibrator calls an image. The estimators of Boresight and those on arcs take
the views as an `ArcSet`; bundle adjustment takes them with an attitude each as nuisance; general calibrators with a whole pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.problem import build_problem, weighed
from boresight.estimation.arcs import ArcSet
from boresight.estimation.cameras import CAMERA_MODELS, CameraModel
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.sky.catalogue import Catalogue
from boresight.studies.star_frames import EXPOSURES_A_FRAME, STARS, star_frames
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

SENSOR = 1
#: Frames drawn more than asked for, in place of those that are left out.
SPARE = 20


@dataclass(frozen=True)
class Views:
    """One set of views of equally many stars, in arc order.

    Parameters
    ----------
    arcs
        The stars of all views, unweighed.
    magnitude
        (n_views, n) of each star, for a peer that asks for brightness.
    sensor
        Ground calibration: where every peer starts.
    truth
        (n_parameters,) that made the centroids, SI.
    """

    arcs: ArcSet
    magnitude: FloatArray
    sensor: Sensor
    truth: FloatArray

    @property
    def camera(self) -> CameraModel:
        """The sensor's camera model."""
        return CAMERA_MODELS[self.sensor.camera_model]

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self.arcs.n_frames

    @property
    def pixels(self) -> FloatArray:
        """(n_views, n, 2) centroids as row and column."""
        return np.stack([self.arcs.row_px, self.arcs.col_px], axis=-1).reshape(-1, STARS, 2)

    @property
    def stars(self) -> FloatArray:
        """(n_views, n, 3) catalogue directions."""
        return self.arcs.s_i.reshape(-1, STARS, 3)

    def weighed(self) -> ArcSet:
        """Return the arcs with R at the ground calibration."""
        return weighed(self.arcs, self.camera, self.sensor.initial)

    def first(self, frames: int) -> Views:
        """Return the first frames of the set, or the whole."""
        frames = min(frames, self.n_frames)
        n_views = frames * EXPOSURES_A_FRAME
        return Views(self.arcs.frames(0, frames), self.magnitude[:n_views], self.sensor, self.truth)


def simulated_views(frames: int, seed: int, catalogue: Catalogue) -> Views:
    """Simulate one set of the first ST-16 of E Table III; a frame whose noise carries a star off the detector is left out."""
    sensor, truth = st16_sensor(SENSOR), st16_truth(SENSOR)
    drawn = star_frames(frames + SPARE, sensor, truth, catalogue, np.random.default_rng([SENSOR, seed]))
    telemetry = _first_full(drawn, sensor, frames)
    arcs = build_problem(telemetry, sensor, catalogue).arcs.whole()
    if telemetry.star_id is None or len(arcs.row_px) != len(telemetry):
        raise ValueError(f"Expected every star in the problem / Received {len(arcs.row_px)} of {len(telemetry)}")
    star = catalogue.index_of(telemetry.star_id[arcs.source_row])
    return Views(arcs, catalogue.magnitude[star].reshape(-1, STARS), sensor, truth)


def _first_full(drawn: Telemetry, sensor: Sensor, frames: int) -> Telemetry:
    """Return the first frames all of whose stars lie on the detector."""
    on = (np.abs(drawn.row_px - (sensor.rows - 1) / 2) < sensor.rows / 2) & (
        np.abs(drawn.col_px - (sensor.columns - 1) / 2) < sensor.columns / 2
    )
    of_frame = EXPOSURES_A_FRAME * STARS
    full = np.flatnonzero(on.reshape(-1, of_frame).all(axis=1))[:frames]
    rows = (full[:, None] * of_frame + np.arange(of_frame)).ravel()
    columns = ("frame", "exposure", "row_px", "col_px", "time_utc", "star_id")
    return Telemetry(**{name: getattr(drawn, name)[rows] for name in columns})
