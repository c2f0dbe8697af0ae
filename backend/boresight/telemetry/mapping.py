"""How a file counts pixels and turns, where it differs from the telemetry format, and the way back.

A file may count pixels from 1, or from the corner of the first one; give columns before rows; count rows from the bottom or columns
from the right; write the scalar of a quaternion first, or the turn the other way; and count its time from another epoch. With o the
coordinate of the centre of the file's first pixel, R rows and N columns, its centroid (a, b) becomes

    (a, b) := (a - o, b - o);   (b, a) where axes are swapped;   R - 1 - row and N - 1 - column where they are flipped

in this order. A mapping is what a diagnosis proposes and what an import takes over.
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
    """

    origin_px: float = 0.0
    swapped_axes: bool = False
    flipped_rows: bool = False
    flipped_columns: bool = False
    quaternion_order: QuaternionOrder = "xyzw"
    quaternion_sense: QuaternionSense = "icrs_to_detector"
    time_shift_s: float = 0.0

    @property
    def changes(self) -> bool:
        """Whether it changes anything."""
        return self != TelemetryMapping()

    def apply(self, telemetry: Telemetry, sensor: Sensor) -> Telemetry:
        """Return telemetry in the telemetry format; `sensor` says how many rows and columns there are."""
        first, second = telemetry.row_px - self.origin_px, telemetry.col_px - self.origin_px
        row, col = (second, first) if self.swapped_axes else (first, second)
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
