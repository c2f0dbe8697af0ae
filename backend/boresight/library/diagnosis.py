"""A diagnosis as the library returns it; by itself, because it loads the matching, which few other answers need."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from boresight.calibration.diagnosis import result
from boresight.errors import RefusedInputError
from boresight.library.results import Summarised
from boresight.library.text import Summary, summarise_diagnosis
from boresight.telemetry.mapping import parse_mapping
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import parse_sensor


@dataclass(frozen=True, kw_only=True, repr=False)
class Diagnosis(Summarised, result.Diagnosis):
    """Why telemetry does not match: `causes`, `sentence`, what was `tried`, and both files mended."""

    @classmethod
    def of(cls, found: result.Diagnosis) -> Diagnosis:
        """Give a diagnosis its face."""
        return cls(**{item.name: getattr(found, item.name) for item in fields(found)})

    def _summarise(self) -> Summary:
        return summarise_diagnosis(self)

    def mended_sensor(self) -> Mapping[str, Any]:
        """Return the mended sensor file; raises RefusedInputError where the cause is unknown."""
        if self.sensor_document is None:
            raise RefusedInputError(f"There is nothing to correct in the sensor file. {self.sentence}")
        return self.sensor_document

    def save_sensor(self, path: str | Path) -> None:
        """Write the mended sensor file."""
        Path(path).write_text(json.dumps(self.mended_sensor(), indent=1) + "\n")

    def mend(self, telemetry: Telemetry) -> Telemetry:
        """Return telemetry as it is to be read."""
        if self.mapping is None:
            return telemetry
        return parse_mapping(self.mapping).apply(telemetry, parse_sensor(self.mended_sensor()))
