"""Making a process ready before its first run: kernels compiled or read from the cache, catalogue loaded.

A plugin of the scheduler, so that a worker that replaces a dead one is warmed as well; `boresight warm` does the same
once an installation, so that not even the first worker waits for the compiler.
"""

from __future__ import annotations

import logging
import signal
import threading
from pathlib import Path

import numpy as np
from distributed.diagnostics.plugin import WorkerPlugin

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import METHODS, CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import load_catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

log = logging.getLogger(__name__)

FRAMES, STARS = 3, 6


class WarmUp(WorkerPlugin):  # type: ignore[misc]  # distributed ships no types
    """Warm a worker when it appears; `ours` says that the process was started by this server."""

    name = "boresight-warm-up"
    idempotent = True

    def __init__(self, catalogue_folder: str, *, ours: bool) -> None:
        self.catalogue_folder = catalogue_folder
        self.ours = ours

    def setup(self, worker: object) -> None:  # noqa: ARG002 - the interface gives it
        """Begin warming beside the worker's event loop, which must go on answering the scheduler."""
        if self.ours:  # Ctrl-C in a terminal reaches the whole process group; the server stops its workers itself
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        threading.Thread(target=self._warm, daemon=True, name="warm").start()

    def _warm(self) -> None:
        """Warm this worker; a failure only means that its first run is slow."""
        try:
            warm(Path(self.catalogue_folder))
        except Exception:
            log.exception("This worker could not be warmed; its first run will take longer")


def warm(catalogue_folder: Path) -> None:
    """Calibrate a few made-up stars with every kind of estimator."""
    catalogue = load_catalogue(catalogue_folder)
    sensor = st16_sensor(1)
    choices = [CalibrationSettings(method=method) for method in METHODS]
    for settings in (*choices, CalibrationSettings(robust="huber")):
        calibrate(_few_stars(sensor), sensor, catalogue, settings)


def _few_stars(sensor: Sensor) -> Telemetry:
    """Scatter stars over the detector of a sensor at the celestial pole, in agreement with its parameters."""
    rng = np.random.default_rng(1)
    n = FRAMES * STARS
    row_px, col_px = rng.uniform(0, sensor.rows, n), rng.uniform(0, sensor.columns, n)
    s_d = CAMERA_MODELS[sensor.camera_model].directions(sensor.initial, row_px, col_px, sensor.pixel_pitch_m)
    return Telemetry(
        frame=np.repeat(np.arange(FRAMES), STARS),
        exposure=np.zeros(n, np.int64),
        row_px=row_px,
        col_px=col_px,
        star_id=np.tile(np.arange(1, STARS + 1), FRAMES),
        ra_rad=np.arctan2(s_d[:, 1], s_d[:, 0]) % (2 * np.pi),
        dec_rad=np.arcsin(s_d[:, 2]),
    )
