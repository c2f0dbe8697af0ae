"""The `cameras.txt` of COLMAP: a line with model, size and parameters.

COLMAP's (0, 0) is the outer corner of the top-left pixel, so its centre is (0.5, 0.5) (COLMAP, Camera models; Database format), and
half a pixel is added to the principal point. FULL_OPENCV has the parameters fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6, OPENCV_FISHEYE
fx fy cx cy k1 k2 k3 k4.
"""

from __future__ import annotations

from boresight.calibration.exports.export import Export, ExportFormat, Written, number, pack_lens, provenance
from boresight.calibration.exports.lenses import EQUIDISTANT, PLUMB_BOB, RATIONAL

#: COLMAP's name, and how many coefficients it has.
MODELS = {
    PLUMB_BOB.name: ("FULL_OPENCV", 8),
    RATIONAL.name: ("FULL_OPENCV", 8),
    EQUIDISTANT.name: ("OPENCV_FISHEYE", 4),
}


def _write(asked: Export) -> Written:
    fitted, sensor = asked.lens, asked.sensor
    model, count = MODELS[fitted.lens.name]
    f_x, f_y, c_x, c_y, *coefficients = fitted.p.tolist()
    coefficients += [0.0] * (count - len(coefficients))
    values = (f_x, f_y, c_x + 0.5, c_y + 0.5, *coefficients)
    lines = [
        *(f"# {line}" for line in provenance(asked)),
        "# The centre of the top-left pixel is (0.5, 0.5)",
        "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
        f"1 {model} {sensor.columns} {sensor.rows} {' '.join(number(value) for value in values)}",
    ]
    return pack_lens(asked, "\n".join(lines) + "\n")


COLMAP = ExportFormat(
    "colmap", "COLMAP", (".txt",), "text/plain", _write, (PLUMB_BOB, RATIONAL, EQUIDISTANT),
    why="`cameras.txt` with `FULL_OPENCV` or `OPENCV_FISHEYE`",
)  # fmt: skip
