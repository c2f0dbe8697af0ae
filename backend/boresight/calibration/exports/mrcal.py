"""The `.cameramodel` of mrcal: a Python literal with the lens, its intrinsics, the size of the image and the pose.

mrcal takes pixel centres at whole numbers from 0, X along columns and Y along rows, and its OPENCV5, OPENCV8 and OPENCV12 are
OpenCV's own (mrcal, Lens models). The pose is the rotation vector and translation from the reference to the camera; the reference
is the frame with its axes along columns, rows and boresight, so the pose holds what the lens was turned by. mrcal 2.5 calls it
`rt_cam_ref`, older ones `extrinsics`; both are written, as mrcal does.
"""

from __future__ import annotations

from boresight.calibration.exports.export import Export, ExportFormat, Written, pack_lens, provenance
from boresight.calibration.exports.lenses import PINHOLE, PLUMB_BOB, RATIONAL, THIN_PRISM, THIN_PRISM_RATIONAL
from boresight.calibration.exports.opencv import COEFFICIENTS, LENGTHS
from boresight.estimation.attitude import rotation_vector, to_quaternion


def _write(asked: Export) -> Written:
    fitted, sensor = asked.lens, asked.sensor
    names = COEFFICIENTS[: LENGTHS[fitted.lens.name]]
    pose = [*rotation_vector(to_quaternion(fitted.turn)).tolist(), 0.0, 0.0, 0.0]
    lines = [
        *(f"# {line}" for line in provenance(asked)),
        "{",
        f"    'lensmodel':  'LENSMODEL_OPENCV{len(names)}',",
        f"    # {' '.join((*PINHOLE, *names))}",
        f"    'intrinsics': {[*fitted.p[:4].tolist(), *fitted.list_coefficients(names)]},",
        f"    'rt_cam_ref': {pose},",
        f"    'extrinsics': {pose},",
        f"    'imagersize': [{sensor.columns}, {sensor.rows}],",
        "}",
    ]
    return pack_lens(asked, "\n".join(lines) + "\n")


MRCAL = ExportFormat(
    "mrcal", "mrcal", (".cameramodel",), "text/plain", _write, (PLUMB_BOB, THIN_PRISM, RATIONAL, THIN_PRISM_RATIONAL),
    why="`LENSMODEL_OPENCV5`, `8` or `12`; the pose is the rotation of the frame",
)  # fmt: skip
