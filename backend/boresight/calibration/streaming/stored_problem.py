"""A set in files, ready for estimation: `calibration.problem.AnyProblem` says what it is asked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import IntArray
from boresight.calibration.problem import LeftOut, times_at, weigh_part
from boresight.calibration.spread import Spread
from boresight.calibration.streaming.stored_arcs import ArcsPiece, StoredArcs
from boresight.estimation.cameras import CAMERA_MODELS, CameraModel
from boresight.telemetry.sensors import Sensor


@dataclass(frozen=True)
class StoredProblem:
    """A telemetry set in pieces.

    Parameters
    ----------
    sensor
        Whose telemetry it is.
    pieces
        Its arcs; a piece may have no frame.
    spread
        What computes over them.
    frames_in_set, left_out
        As in `calibration.problem.Problem`.
    """

    sensor: Sensor
    pieces: tuple[ArcsPiece, ...]
    spread: Spread
    frames_in_set: int
    left_out: tuple[LeftOut, ...]

    @property
    def camera(self) -> CameraModel:
        """Its camera model."""
        return CAMERA_MODELS[self.sensor.camera_model]

    @cached_property
    def arcs(self) -> StoredArcs:
        """Stars in order, not weighed."""
        return StoredArcs(tuple(piece for piece in self.pieces if piece.n_frames), self.spread)

    def weighed(self, x: NDArray[np.float64]) -> StoredArcs:
        """Return the arcs with R taken at state x (n_parameters,)."""
        return self.arcs.each(weigh_part, self.camera.name, x)

    def place_of(self, frame: IntArray) -> IntArray:
        """Places (n,) of frame numbers (n,) among those that take part, or would if they did."""
        places = np.empty(len(frame), np.int64)
        pieces = self.arcs.pieces
        of = np.searchsorted([piece.column("frame")[0] for piece in pieces], frame, side="right") - 1
        for k in np.unique(of := np.maximum(of, 0)):
            mine = of == k
            places[mine] = self._begins[k] + np.searchsorted(pieces[k].column("frame"), frame[mine])
        return places

    def times_of(self, frame: IntArray) -> NDArray[np.datetime64] | None:
        """Times (n,) of frames (n,), NaT of those that take no part; None where the set has none."""
        times, pieces = np.full(len(frame), np.datetime64("NaT", "us")), self.arcs.pieces
        of = np.maximum(np.searchsorted([piece.column("frame")[0] for piece in pieces], frame, side="right") - 1, 0)
        for k in np.unique(of):
            if not pieces[k].has("time_utc"):
                return None
            mine = of == k
            times[mine] = times_at(frame[mine], pieces[k].column("frame"), pieces[k].column("time_utc"))
        return times

    @cached_property
    def _begins(self) -> IntArray:
        """Frames before each piece."""
        counts = [piece.n_frames for piece in self.arcs.pieces]
        return np.cumsum([0, *counts], dtype=np.int64)[:-1]
