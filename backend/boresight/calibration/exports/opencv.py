"""Camera files of OpenCV (`cv::FileStorage`) and of ROS (`camera_info`, as camera_calibration_parsers reads it).

Both take pixel centres at whole numbers from 0, X along columns and Y along rows, and have the lenses of `lenses` under the names
that `distortion_model` has in ROS; the fisheye lens is OpenCV's module `cv::fisheye`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from boresight.calibration.exports.export import Export, ExportFormat, Written, number, pack_lens, provenance
from boresight.calibration.exports.lenses import (
    EQUIDISTANT,
    PLUMB_BOB,
    RATIONAL,
    THIN_PRISM,
    THIN_PRISM_RATIONAL,
    TILTED,
    TILTED_RATIONAL,
)

#: OpenCV's coefficients in its own order; a vector of them has 5, 8, 12 or 14.
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
LENGTHS = {PLUMB_BOB.name: 5, RATIONAL.name: 8}
LENGTHS |= {THIN_PRISM.name: 12, THIN_PRISM_RATIONAL.name: 12, TILTED.name: 14, TILTED_RATIONAL.name: 14}

#: ROS's names of the lenses.
ROS_MODELS = {PLUMB_BOB.name: "plumb_bob", RATIONAL.name: "rational_polynomial", EQUIDISTANT.name: "equidistant"}
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def opencv_yaml(
    columns: int, rows: int, K: Sequence[float], coefficients: Sequence[float], comments: Iterable[str] = ()
) -> bytes:
    """Write a file for `cv::FileStorage`; `K`: (9,) the camera matrix, row by row."""
    lines = [
        "%YAML:1.0",
        "---",
        *(f"# {line}" for line in comments),
        f"image_width: {columns}",
        f"image_height: {rows}",
    ]
    for name, height, values in (("camera_matrix", 3, K), ("distortion_coefficients", 1, coefficients)):
        lines += [f"{name}: !!opencv-matrix", f"   rows: {height}", f"   cols: {len(values) // height}", "   dt: d"]
        lines.append(f"   data: {_listed(values)}")
    return ("\n".join(lines) + "\n").encode()


def ros_yaml(
    columns: int,
    rows: int,
    K: Sequence[float],
    distortion: tuple[str, Sequence[float]],
    title: str,
    comments: Iterable[str] = (),
) -> bytes:
    """Write a `camera_info`; `K`: (9,) the camera matrix, row by row; `distortion`: ROS's name of the model, and coefficients."""
    model, coefficients = distortion
    lines = [
        *(f"# {line}" for line in comments),
        f"image_width: {columns}",
        f"image_height: {rows}",
        f"camera_name: {re.sub(r'[^A-Za-z0-9_]', '_', title)}",
        f"distortion_model: {model}",
    ]
    matrices = (
        ("camera_matrix", 3, K),
        ("distortion_coefficients", 1, coefficients),
        ("rectification_matrix", 3, IDENTITY),
        ("projection_matrix", 3, (*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0)),
    )
    for name, height, values in matrices:
        lines += [f"{name}:", f"  rows: {height}", f"  cols: {len(values) // height}", f"  data: {_listed(values)}"]
    return ("\n".join(lines) + "\n").encode()


def _listed(values: Sequence[float]) -> str:
    return f"[{', '.join(number(value) for value in values)}]"


def _matrix(asked: Export) -> tuple[float, ...]:
    f_x, f_y, c_x, c_y = asked.lens.p[:4].tolist()
    return (f_x, 0.0, c_x, 0.0, f_y, c_y, 0.0, 0.0, 1.0)


def _opencv(asked: Export) -> Written:
    lens = asked.lens.lens
    names = lens.coefficients if lens is EQUIDISTANT else COEFFICIENTS[: LENGTHS[lens.name]]
    coefficients = asked.lens.list_coefficients(names)
    module = f"cv::{'fisheye' if lens is EQUIDISTANT else 'projectPoints'}, coefficients {' '.join(names)}"
    comments = [*provenance(asked), f"Lens: {lens.name} ({module}); pixel centres at whole numbers from 0"]
    return pack_lens(
        asked, opencv_yaml(asked.sensor.columns, asked.sensor.rows, _matrix(asked), coefficients, comments)
    )


def _ros(asked: Export) -> Written:
    lens, coefficients = asked.lens.lens, asked.lens.p[4:].tolist()
    comments = [*provenance(asked), "Pixel centres at whole numbers from 0"]
    distortion = (ROS_MODELS[lens.name], coefficients)
    sensor = asked.sensor
    return pack_lens(asked, ros_yaml(sensor.columns, sensor.rows, _matrix(asked), distortion, sensor.name, comments))


OPENCV = ExportFormat(
    "opencv", "OpenCV", (".yaml", ".yml"), "application/yaml", _opencv,
    (PLUMB_BOB, THIN_PRISM, TILTED, RATIONAL, THIN_PRISM_RATIONAL, TILTED_RATIONAL, EQUIDISTANT),
    why="`cv::FileStorage`: image size, `camera_matrix`, `distortion_coefficients`; fisheye where that is nearer",
)  # fmt: skip
ROS = ExportFormat(
    "ros", "ROS", (".yaml", ".yml"), "application/yaml", _ros, (PLUMB_BOB, RATIONAL, EQUIDISTANT),
    why="`camera_info` as camera_calibration_parsers reads it: `plumb_bob`, `rational_polynomial` or `equidistant`",
)  # fmt: skip
