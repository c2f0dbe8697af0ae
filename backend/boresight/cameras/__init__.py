"""Camera models: one a file, one line in the registry below.

A model answers with star directions in D for detector positions (`directions`), with their derivatives
(`directions_and_jacobian`) and with the detector position of a direction (`project`).
"""

from __future__ import annotations

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.cameras.model import CameraModel
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL

CAMERA_MODELS: dict[str, CameraModel] = {
    INVERTED_WANG.name: INVERTED_WANG,
    PINHOLE_RADIAL.name: PINHOLE_RADIAL,
}

__all__ = ["CAMERA_MODELS", "CameraModel"]
