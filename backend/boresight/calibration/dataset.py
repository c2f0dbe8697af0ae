"""The dataset of a calibration: in memory where it fits, else copied piece by piece into a scratch folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from boresight.calibration.estimate import Parameters
from boresight.calibration.matching.matched import Dataset
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.progress_reports import Progress
from boresight.calibration.source import StoredTable, TelemetryFile, is_large, read_whole
from boresight.calibration.streaming.telemetry_pieces import PREPARED, copied
from boresight.estimation.executor import Executor, LocalExecutor
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.quality.detector import OffDetector, check_against_sensor
from boresight.telemetry.schema import Telemetry, joined
from boresight.telemetry.sensors import Sensor


@dataclass(frozen=True)
class CalibrationContext:
    """The context of a calibration: its folders, its executor and its progress callback."""

    cancelled: Callable[[], bool]
    report: Callable[[Progress], None] | None = None
    cache_folder: Path | None = None
    scratch_folder: Path | None = None
    spread: Executor | None = None

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
def open_dataset(
    telemetry: Telemetry | TelemetryFile | StoredTable,
    sensor: Sensor,
    catalogue: Catalogue,
    parameters: Parameters,
    settings: CalibrationSettings,
    workplace: CalibrationContext,
) -> Iterator[tuple[Dataset, OffDetector]]:
    """Make a set ready, and say which stars of it lie off the detector.

    While the context lasts it can be matched and computed on.
    """
    if not is_large(telemetry):
        inside = read_whole(telemetry)
        off = check_against_sensor(inside, sensor)
        chosen = choose_match_mode(inside, settings)
        yield Dataset(inside, sensor, catalogue, parameters, chosen, workplace.cache_folder), off
        return
    executor = workplace.spread or LocalExecutor(workplace.cancelled)
    with workplace.folder() as folder:
        copy = copied(telemetry, sensor, folder, executor, workplace.tell, workplace.cancelled)
        chosen = choose_match_mode(copy.pieces[0].read(), settings)
        sets = Dataset(copy, sensor, catalogue, parameters, chosen, workplace.cache_folder, workplace.tell)
        yield sets, copy.off_detector


def choose_match_mode(telemetry: Telemetry, settings: CalibrationSettings) -> CalibrationSettings:
    """Let the matches of a file stand that gives directions but names no stars: there is nothing to match them with."""
    if telemetry.star_id is None and telemetry.ra_rad is not None:
        return replace(settings, match="given")
    return settings


def open_validation_set(
    telemetry: Telemetry | TelemetryFile | StoredTable, sensor: Sensor, most_rows: int
) -> tuple[Telemetry, OffDetector]:
    """Read a validation set, of a large one parts that are evenly spread over it.

    Say which stars of all are off the detector.
    """
    if not is_large(telemetry):
        inside = read_whole(telemetry)
        return inside, check_against_sensor(inside, sensor)
    kept: list[Telemetry] = []
    every, off = 1, OffDetector()
    for number, chunk in enumerate(telemetry.chunks()):
        off.look_at(chunk, sensor)
        if number % every == 0:
            kept.append(chunk)
        if sum(map(len, kept)) > most_rows and len(kept) > 1:
            kept, every = kept[::2], 2 * every
    off.refuse()
    return joined(kept), off
