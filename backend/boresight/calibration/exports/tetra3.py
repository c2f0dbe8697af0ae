"""What tetra3 and cedar-solve are told of a camera: horizontal field of view and one distortion.

Their camera has its axis in the middle of the image, square pixels and one coefficient k (tetra3, `solve_from_centroids`): r_u =
r_d (1 - k (2 r_d / width)^2) / (1 - k), so that k is the distortion at half the width, and tan(fov / 2) = width / (2 f).
Centroids are (row, column) with (0.5, 0.5) in the centre of the top-left pixel. Another principal point is a turn of the frame to
first order, and shows in the misfit beyond. They identify stars within some hundredth of the field, so a misfit as large as a
centroid's error is allowed.
"""

from __future__ import annotations

import json
import math

from boresight.calibration.exports.export import Export, ExportFormat, Written, pack_lens, provenance
from boresight.calibration.exports.lenses import TETRA3


def _write(asked: Export) -> Written:
    sensor, (f, k) = asked.sensor, asked.lens.p.tolist()
    document = {
        "fov_estimate": math.degrees(2.0 * math.atan(0.5 * sensor.columns / f)),
        "distortion": k,
        "size": [sensor.rows, sensor.columns],
        "centroid_offset_px": 0.5,
        "about": [
            *provenance(asked),
            "fov_estimate is horizontal, degrees; add centroid_offset_px to rows and columns",
        ],
    }
    return pack_lens(asked, json.dumps(document, indent=2) + "\n")


def _format(name: str, program: str) -> ExportFormat:
    return ExportFormat(
        name, program, (".json",), "application/json", _write, (TETRA3,), share=1.0,
        why="`fov_estimate` and `distortion` for `solve_from_centroids(centroids, size, ...)`",
    )  # fmt: skip


TETRA3_FORMAT = _format("tetra3", "tetra3")
CEDAR_FORMAT = _format("cedar", "cedar-solve")
