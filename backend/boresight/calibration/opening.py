"""A calibration's telemetry made ready: in memory where it fits, else copied piece by piece into a scratch folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from boresight.calibration.estimate import Parameters
from boresight.calibration.listening import Progress
from boresight.calibration.matched import MatchedSet
from boresight.calibration.settings import CalibrationSettings
from boresight.calibration.source import TelemetryFile
from boresight.calibration.spread import InThisProcess, Spread
from boresight.calibration.streaming.rematched_set import RematchedSet
from boresight.calibration.streaming.streamed_set import PREPARED, StreamedSet, copied
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.detector import check_against_sensor
from boresight.telemetry.schema import Telemetry, joined
from boresight.telemetry.sensors import Sensor


@dataclass(frozen=True)
class Workplace:
    """Where a calibration works, and who looks on.

    Parameters
    ----------
    cancelled
        Asked often; True stops.
    report
        Told of progress; None tells nobody.
    cache_folder
        Where lost-in-space identification keeps its tables.
    scratch_folder
        Where working copies of large sets are made, each in a folder of its own; None is the machine's temporary folder.
    spread
        What computes over large sets; None is this process.
    """

    cancelled: Callable[[], bool]
    report: Callable[[Progress], None] | None = None
    cache_folder: Path | None = None
    scratch_folder: Path | None = None
    spread: Spread | None = None

    @contextmanager
    def folder(self) -> Iterator[Path]:
        """Give a folder that is gone at the end."""
        with TemporaryDirectory(prefix="boresight-calibration-", dir=self.scratch_folder) as folder:
            yield Path(folder)

    def tell(self, fraction: float, message: str) -> None:
        """Report how far the preparation of a large set is."""
        if self.report is not None:
            self.report(Progress(PREPARED * fraction, message, None))


@contextmanager
def opened(
    telemetry: Telemetry | TelemetryFile,
    sensor: Sensor,
    catalogue: Catalogue,
    parameters: Parameters,
    settings: CalibrationSettings,
    workplace: Workplace,
) -> Iterator[MatchedSet | StreamedSet | RematchedSet]:
    """Make a set ready; while the context lasts it can be matched and computed on.

    Raises
    ------
    RefusedInputError
        When the file cannot be used, matched stars lie off the sensor's detector, or directions cannot be had.
    CancelledError
        When `workplace.cancelled` says so.
    """
    if not (isinstance(telemetry, TelemetryFile) and telemetry.large()):
        inside = telemetry.read() if isinstance(telemetry, TelemetryFile) else telemetry
        check_against_sensor(inside, sensor)
        yield MatchedSet(inside, sensor, catalogue, parameters, matchable(inside, settings), workplace.cache_folder)
        return
    spread = workplace.spread or InThisProcess(workplace.cancelled)
    with workplace.folder() as folder:
        copy = copied(telemetry, sensor, folder, spread, workplace.tell, workplace.cancelled)
        chosen = matchable(copy.pieces[0].read(), settings)
        taken = RematchedSet if chosen.match == "rematch" else StreamedSet
        yield taken(copy, sensor, catalogue, parameters, chosen, workplace.cache_folder, workplace.tell)


def matchable(telemetry: Telemetry, settings: CalibrationSettings) -> CalibrationSettings:
    """Let the matches of a file stand that gives directions but names no stars: there is nothing to match them with."""
    if telemetry.star_id is None and telemetry.ra_rad is not None:
        return replace(settings, match="given")
    return settings


def held_out(telemetry: Telemetry | TelemetryFile, most_rows: int) -> Telemetry:
    """Read a validation set, of a large one parts that are evenly spread over it."""
    if not isinstance(telemetry, TelemetryFile):
        return telemetry
    if not telemetry.large():
        return telemetry.read()
    kept: list[Telemetry] = []
    every = 1
    for number, chunk in enumerate(telemetry.chunks()):
        if number % every == 0:
            kept.append(chunk)
        if sum(map(len, kept)) > most_rows and len(kept) > 1:
            kept, every = kept[::2], 2 * every
    return joined(kept)
