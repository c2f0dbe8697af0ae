"""The sensor description: detector, camera model, starting parameters and their typical spread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Sensor:
    """One star tracker as its sensor file describes it.

    Parameters
    ----------
    name
        Unique in a fleet.
    rows, columns
        Detector size, pixels.
    pixel_pitch_m
        Pixel size Delta, metres.
    camera_model
        A name in `boresight.estimation.cameras.CAMERA_MODELS`.
    parity
        +1 or -1, see the notation page.
    centroid_sigma_px
        One-axis standard deviation of a centroid, where telemetry gives none of its own.
    initial, typical_sigma
        (n_parameters,) starting values and unit-to-unit spread (E Table II), in the camera model's parameter order, SI.
    free
        Names of the parameters to estimate, in parameter order.
    magnitude_limit
        Faintest catalogue magnitude the sensor sees, or None.
    """

    name: str
    rows: int
    columns: int
    pixel_pitch_m: float
    camera_model: str
    parity: int
    centroid_sigma_px: float
    initial: NDArray[np.float64]
    typical_sigma: NDArray[np.float64]
    free: tuple[str, ...]
    magnitude_limit: float | None = None
