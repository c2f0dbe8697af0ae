"""Star fields seen through the pinhole camera with radial distortion: the sensor of Wu et al. 2019 (W section 4.1)."""

from __future__ import annotations

import numpy as np

from boresight.estimation.cameras.pinhole_radial import PINHOLE_RADIAL

WU_PITCH = 2.9e-6
WU_ROWS, WU_COLUMNS = 1080, 1920
#: W Table 1, in SI.
WU_TRUTH = np.array([1.0, 0.016, 970.0, 550.0, -0.5, 0.5])
PINHOLE_SCALE = np.array([1e-3, 3e-5, 10.0, 10.0, 0.02, 0.1])
#: The same lens in front of the detector of `fields`.
PINHOLE_GROUND = np.array([1.0, 0.016095, 1296.0, 972.0, -0.5, 0.5])
PINHOLE = PINHOLE_RADIAL
