"""How a file counts pixels and turns, where it differs from the telemetry format, and the way back.

A file may count pixels from 1, or from the corner of the first one; give columns before rows; count rows from the bottom or columns
from the right; write the scalar of a quaternion first, or the turn the other way; and count its time from another epoch. With o the
coordinate of the centre of the file's first pixel, R rows and N columns, its centroid (a, b) becomes

    (a, b) := (a - o, b - o);   (b, a) where axes are swapped;   R - 1 - row and N - 1 - column where they are flipped

in this order. A file may also give lengths, px pixels a unit, and count from the middle of the detector:

    (a, b) := (px a - o, px b - o);   (b, a) where axes are swapped;   row + (R - 1) / 2, col + (N - 1) / 2 where centred;   flips

A mapping is what a diagnosis proposes and what an import takes over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from boresight.arrays import FloatArray
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import conjugate
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

QuaternionOrder = Literal["xyzw", "wxyz"]
QuaternionSense = Literal["icrs_to_detector", "detector_to_icrs"]


@dataclass(frozen=True)
class TelemetryMapping:
    """What a file does otherwise than the telemetry format.

    Parameters
    ----------
    origin_px
        Coordinate that the file gives the centre of its first pixel, on both axes.
    swapped_axes
        Whether its `row_px` counts columns and its `col_px` rows.
    flipped_rows, flipped_columns
        Whether rows, or columns, are counted from the other edge.
    quaternion_order, quaternion_sense
        Where the scalar of its quaternions stands, and which way they turn.
    time_shift_s
        Seconds to add to its times.
    centred
        Whether it counts from the middle of the detector.
    unit_px
        Pixels in its unit of length: 1, or a millimetre's over the pixel pitch.
    """

    origin_px: float = 0.0
    swapped_axes: bool = False
    flipped_rows: bool = False
    flipped_columns: bool = False
    quaternion_order: QuaternionOrder = "xyzw"
    quaternion_sense: QuaternionSense = "icrs_to_detector"
    time_shift_s: float = 0.0
    centred: bool = False
    unit_px: float = 1.0

    @property
    def changes(self) -> bool:
        """Whether it changes anything."""
        return self != TelemetryMapping()

    def apply(self, telemetry: Telemetry, sensor: Sensor) -> Telemetry:
        """Return telemetry in the telemetry format; `sensor` says how many rows and columns there are."""
        first, second = (values * self.unit_px - self.origin_px for values in (telemetry.row_px, telemetry.col_px))
        row, col = (second, first) if self.swapped_axes else (first, second)
        if self.centred:
            row, col = row + (sensor.rows - 1) / 2, col + (sensor.columns - 1) / 2
        return replace(
            telemetry,
            row_px=sensor.rows - 1 - row if self.flipped_rows else row,
            col_px=sensor.columns - 1 - col if self.flipped_columns else col,
            quaternion=None if telemetry.quaternion is None else self.turned(telemetry.quaternion),
            time_utc=None if telemetry.time_utc is None else telemetry.time_utc + self._shift,
        )

    @property
    def _shift(self) -> np.timedelta64:
        return np.timedelta64(round(self.time_shift_s * 1e6), "us")

    def turned(self, quaternion: FloatArray) -> FloatArray:
        """Return the file's quaternions (n, 4) as x y z w, ICRS to detector."""
        q = np.roll(quaternion, -1, axis=-1) if self.quaternion_order == "wxyz" else quaternion
        return conjugate(q) if self.quaternion_sense == "detector_to_icrs" else q

    def document(self) -> dict[str, Any]:
        """Return it for a JSON document."""
        return asdict(self)


def profile_members(document: Mapping[str, Any]) -> str:
    """Say what a mapping is in the members of a mapping profile."""
    told, found = list[str](), parse_mapping(document)
    if found.swapped_axes:
        told.append("the columns of row and col swapped")
    if found.centred:
        told.append('row.origin and col.origin "centre"')
    elif found.origin_px:
        told.append(f"row.origin and col.origin {found.origin_px:g}")
    if found.unit_px != 1.0:
        told.append("row.unit and col.unit a length, with detector.pixel_pitch_m")
    told += [
        f"{axis}.reversed" for axis, turned in (("row", found.flipped_rows), ("col", found.flipped_columns)) if turned
    ]
    if found.quaternion_order != "xyzw":
        told.append(f"quaternion.order {found.quaternion_order}")
    if found.quaternion_sense != "icrs_to_detector":
        told.append(f"quaternion.sense {found.quaternion_sense}")
    if found.time_shift_s:
        told.append(f"time.offset_s {found.time_shift_s:+g}")
    return "; ".join(told)


def parse_mapping(document: Mapping[str, Any]) -> TelemetryMapping:
    """Read a mapping; absent members are as the telemetry format has them."""
    known = {item.name: item.default for item in fields(TelemetryMapping)}
    for name, value in document.items():
        if name not in known:
            raise RefusedInputError(f"{name!r} is not a member of a mapping: choose from {', '.join(known)}.")
        default = known[name]
        fits = isinstance(value, type(default)) or (isinstance(default, float) and type(value) is int)
        if not fits or (isinstance(value, float | int) and not np.isfinite(value)):
            raise RefusedInputError(f"{name} of a mapping is {value!r}: give one such as {default!r}.")
    chosen = TelemetryMapping(**document)
    if chosen.quaternion_order not in {"xyzw", "wxyz"}:
        raise RefusedInputError(f"quaternion_order is {chosen.quaternion_order!r}: write xyzw or wxyz.")
    if chosen.quaternion_sense not in {"icrs_to_detector", "detector_to_icrs"}:
        raise RefusedInputError(
            f"quaternion_sense is {chosen.quaternion_sense!r}: write icrs_to_detector or detector_to_icrs."
        )
    return chosen
