"""A set in files under given matches, in the place of a `MatchedSet`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from boresight.calibration.estimate import Parameters
from boresight.calibration.matched import Judged, MatchedSet
from boresight.calibration.settings import CalibrationSettings
from boresight.calibration.source import TelemetryFile
from boresight.calibration.spread import Spread
from boresight.calibration.streaming.matching import FrameRange
from boresight.calibration.streaming.ordering import order_set, write_catalogue
from boresight.calibration.streaming.sample import judged_frames, judged_telemetry
from boresight.calibration.streaming.stored_problem import StoredProblem
from boresight.calibration.streaming.telemetry_pieces import TelemetryPiece, copy_stretch, write_pieces
from boresight.errors import CancelledError
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.detector import OffDetector
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor

#: Told how far the copying and ordering of a set is: fraction and a line for a log.
Prepared = Callable[[float, str], None]
#: Share of a calibration's progress that making a large set ready is, and of that, reading.
PREPARED, READING = 0.5, 0.6


@dataclass(frozen=True)
class WorkingCopy:
    """A set in a scratch folder.

    Parameters
    ----------
    pieces
        As it came.
    folder
        Where everything else goes.
    spread
        What computes over it.
    """

    pieces: tuple[TelemetryPiece, ...]
    folder: Path
    spread: Spread

    @property
    def n_frames(self) -> int:
        """Frames of the set."""
        return sum(piece.frames for piece in self.pieces)

    @property
    def off_detector(self) -> OffDetector:
        """The matched stars of the set that lie off the detector."""
        off = OffDetector()
        for piece in self.pieces:
            off.absorb(piece.off_detector)
        return off

    @property
    def epoch(self) -> np.datetime64 | None:
        """First known time of the set."""
        known = [piece.epoch for piece in self.pieces if not np.isnat(piece.epoch)]
        return min(known) if known else None

    def parts(self) -> Iterator[Telemetry]:
        """Map the pieces one after the other."""
        return (piece.read() for piece in self.pieces)

    def frames(self, first: int, last: int) -> FrameRange:
        """The frames first <= k < last of the set."""
        ends = np.cumsum([piece.frames for piece in self.pieces])
        begin, end = int(np.searchsorted(ends, first, side="right")), int(np.searchsorted(ends, last))
        before = int(ends[begin - 1]) if begin else 0
        return FrameRange(self.pieces[begin : end + 1], first - before, last - before)


def copied(
    file: TelemetryFile,
    sensor: Sensor,
    folder: Path,
    spread: Spread,
    told: Prepared,
    cancelled: Callable[[], bool],
) -> WorkingCopy:
    """Read a file into pieces: stretches of it wherever the spread does it, or from its start where it has none or is refused.

    Raises
    ------
    RefusedInputError
        As reading the whole file and checking it against the sensor would.
    CancelledError
        When `cancelled` says so.
    """
    pieces = _copied_apart(file, sensor, folder, spread, told) or _copied_in_turn(file, sensor, folder, told, cancelled)
    copy = WorkingCopy(pieces, folder, spread)
    copy.off_detector.refuse()
    return copy


def _copied_apart(
    file: TelemetryFile, sensor: Sensor, folder: Path, spread: Spread, told: Prepared
) -> tuple[TelemetryPiece, ...]:
    """Copy the stretches of a file; nothing when one of them cannot be used, or it has none."""
    work = [
        (stretch, file.chunk_frames, sensor, str(folder / f"telemetry-{number:06d}"))
        for number, stretch in enumerate(file.stretches())
    ]
    parts: list[tuple[TelemetryPiece, ...] | None] = spread.map(
        copy_stretch, work, done=lambda k, n: told(READING * k / n, f"read {k} of {n} parts of the file")
    )
    pieces: list[TelemetryPiece] = []
    for part, stretch in zip(parts, work, strict=True):
        copied_here = copy_stretch(*stretch) if part is None else part  # another machine may not see the file
        if copied_here is None:
            return ()
        pieces += copied_here
    return tuple(pieces)


def _copied_in_turn(
    file: TelemetryFile, sensor: Sensor, folder: Path, told: Prepared, cancelled: Callable[[], bool]
) -> tuple[TelemetryPiece, ...]:
    """Copy a file from its start to its end; refuses it in its words."""
    rows = max(file.about_rows(), 1)
    pieces: list[TelemetryPiece] = []
    for piece in write_pieces(file.chunks(), sensor, folder / "telemetry"):
        if cancelled():
            raise CancelledError(f"Stopped as asked after reading {piece.begins} rows")
        pieces.append(piece)
        done = piece.begins + piece.rows
        told(READING * min(done / rows, 1.0), f"read {done:,} detections")
    return tuple(pieces)


@dataclass(frozen=True)
class StreamedMatched:
    """A set in files under one state: its problem."""

    problem: StoredProblem

    @property
    def unidentified(self) -> int:
        """No exposure is to be identified where the given matches stand."""
        return 0


class StreamedSet:
    """A set in files whose given matches stand.

    Parameters
    ----------
    copy
        The set.
    sensor, catalogue, parameters, settings, cache_folder
        As of a `MatchedSet`.
    told
        How far the ordering is.
    """

    def __init__(
        self,
        copy: WorkingCopy,
        sensor: Sensor,
        catalogue: Catalogue,
        parameters: Parameters,
        settings: CalibrationSettings,
        cache_folder: Path | None,
        told: Prepared,
    ) -> None:
        self.settings = settings
        self._copy, self._sensor, self._catalogue = copy, sensor, catalogue
        self._parameters, self._cache_folder = parameters, cache_folder
        stars = write_catalogue(catalogue, copy.folder)
        problem = order_set(
            copy.pieces, sensor, stars, settings.minimum_stars, copy.folder, copy.spread,
            lambda k, n: told(READING + (1 - READING) * k / n, f"ordered {k} of {n} pieces"),
        )  # fmt: skip
        self._standing = StreamedMatched(problem)

    @property
    def prepared(self) -> float:
        """Share of a calibration's progress that making it ready took."""
        return PREPARED

    @property
    def renewed(self) -> None:
        """Nothing matches it anew."""
        return

    def at_start(self) -> StreamedMatched:
        """The set under the sensor's own parameters."""
        return self._standing

    def judged(self, _first: StreamedMatched, last: StreamedMatched) -> Judged:
        """What of it is judged in memory."""
        telemetry = judged_telemetry(self._copy.parts(), judged_frames(last.problem.arcs))
        sets = MatchedSet(telemetry, self._sensor, self._catalogue, self._parameters, self.settings, self._cache_folder)
        return Judged(sets, sets.at_start(), sets.at_start())
