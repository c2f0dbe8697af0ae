"""Forecasts of runs, cached by their inputs: the table's content address, the sensor's document and the settings."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from boresight.calibration.evaluation.forecast import MOST_FRAMES, MOST_STARS, Forecast, forecast, forecast_nothing
from boresight.calibration.options import CalibrationSettings
from boresight.errors import BoresightError, CorruptFileError
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.working_tables import table_path
from boresight.platform.db.documents import compute_sha256
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.read.frames import read_sample
from boresight.telemetry.sensors import parse_sensor

KEPT = 500


@dataclass(frozen=True)
class ForecastSources:
    """The inputs of a forecast besides the rows: stored tables and the star catalogue."""

    blobs: BlobStore
    catalogue: Callable[[], Catalogue | None]
    catalogue_folder: Path
    _made: OrderedDict[str, Forecast] = field(default_factory=OrderedDict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def forecast(
        self, table_sha256: str, sensor_document: Mapping[str, Any], settings: CalibrationSettings
    ) -> Forecast:
        """Forecast a run; see `calibration.evaluation.forecast`. Without a forecast `at` is None and `sentence` says why."""
        key = compute_sha256([table_sha256, dict(sensor_document), settings.document()])
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
                return self._made[key]
        try:
            made = self._forecast(table_sha256, sensor_document, settings)
        except CorruptFileError as error:  # until it is restored
            return _say_why_not(error)
        with self._lock:
            self._made[key] = made
            while len(self._made) > KEPT:
                self._made.popitem(last=False)
        return made

    def _forecast(
        self, table_sha256: str, sensor_document: Mapping[str, Any], settings: CalibrationSettings
    ) -> Forecast:
        """Read the sample and compute the forecast, or return why that is not possible."""
        try:
            sample = read_sample(table_path(self.blobs, table_sha256), MOST_FRAMES, MOST_STARS)
            if (catalogue := self.catalogue()) is None:
                return _say_why_not("this server has no star catalogue")
            return forecast(sample, parse_sensor(sensor_document), catalogue, settings, self.catalogue_folder)
        except CorruptFileError:
            raise
        except BoresightError as error:
            return _say_why_not(error)


def _say_why_not(error: BoresightError | str) -> Forecast:
    return forecast_nothing(f"No sigma can be predicted: {str(error).rstrip('.')}.")
