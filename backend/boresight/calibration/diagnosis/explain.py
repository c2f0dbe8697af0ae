"""A diagnosis beside what asked for it: in the advice of a result that hardly matches, in a refusal, in a quality report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from boresight.calibration.diagnosis.diagnose import BUDGET_S, Report, diagnose
from boresight.calibration.diagnosis.result import Diagnosis
from boresight.calibration.diagnosis.sentences import advise
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import TelemetryInput
from boresight.errors import RefusedInputError
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.quality.detector import OffDetectorError
from boresight.telemetry.quality.inputs import Finding, Severity
from boresight.telemetry.quality.report import put_finding_first
from boresight.telemetry.sensors import Sensor


def explain(
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings | None = None,
    cache_folder: Path | None = None,
    report: Report | None = None,
    *,
    advice: Sequence[str] = (),
) -> list[str]:
    """Return the advice on a set that hardly matches with why: first, or last where most exposures match as the files stand."""
    found = diagnose(telemetry, sensor, catalogue, settings, cache_folder=cache_folder, report=report)
    matches = 2 * found.exposures_solved_before > found.exposures
    return [*advice, *advise(found)] if matches else [*advise(found), *advice]


def explain_refusal(
    error: OffDetectorError,
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    cache_folder: Path | None,
    budget_s: float = BUDGET_S,
) -> RefusedInputError:
    """Return the refusal of stars off the detector with its cause first, where a diagnosis finds one in time."""
    found = diagnose(telemetry, sensor, catalogue, cache_folder=cache_folder, budget_s=budget_s)
    if found.fits or "unknown" in found.names:
        return error
    return OffDetectorError(" ".join([*advise(found), str(error)]), error.faults)


#: Findings that say no more than that names are wanting; a diagnosis knows whether the stars match without them.
_OF_NAMES = frozenset({"NO_MATCHES", "FEW_STARS"})


def add_to_report(document: Mapping[str, Any], found: Diagnosis) -> dict[str, Any]:
    """Return a quality report with a diagnosis: its finding first, and in place of those that only miss names."""
    solved = found.exposures_solved if not found.fits else found.exposures_solved_before
    known = "unknown" not in found.names
    severity: Severity = "NORMAL" if found.fits else "CAUTION" if known and found.exposures_solved_before else "SERIOUS"
    finding = Finding("MATCHES" if found.fits else "DIAGNOSIS", severity, found.sentence, solved)
    replaced = _OF_NAMES if known else frozenset[str]()
    return put_finding_first(document, finding, replaced) | {"diagnosis": found.to_dict()}
