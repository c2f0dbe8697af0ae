"""The Cramér-Rao bound in the parameters' own units, from `estimation.cramer_rao`, at the truth, all parameters free."""

from __future__ import annotations

import numpy as np

from boresight.arrays import FloatArray
from boresight.estimation.arcs import ArcSet
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.estimation.cramer_rao import centroid_rows
from boresight.telemetry.sensors import Sensor


def cramer_rao(arcs: ArcSet, sensor: Sensor, truth: FloatArray) -> FloatArray:
    """Standard deviations (n_parameters,) that no unbiased estimate from these centroids can beat, SI."""
    scale = sensor.typical_sigma
    rows = centroid_rows(CAMERA_MODELS[sensor.camera_model], truth, arcs, np.arange(len(truth)), scale)
    return np.asarray(scale * np.sqrt(np.diag(np.linalg.inv(rows.information))))
