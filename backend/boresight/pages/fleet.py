"""How each sensor stands, in one level, one word and one sentence; the fleet stands as its worst sensor does.

The rules, worst first: what was read back from the spacecraft differs from what was sent (critical); the last run
failed, was lost or did not settle (serious); the last run left weakly known parameters or a worse fit, or there has
been no calibration since the ground (caution). What merely waits for a person is not a fault and is shown beside.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.pages.states import LEVELS, level_of
from boresight.services import approvals, sensors
from boresight.services.sensors import FleetRow
from boresight.store.sessions import Session

WORD_OF_LEVEL = {
    "critical": "CRITICAL",
    "serious": "SERIOUS",
    "caution": "CAUTION",
    "normal": "NORMAL",
    "standby": "STANDBY",
    "off": "NO DATA",
}


@dataclass(frozen=True)
class Standing:
    """A consolidated status."""

    level: str
    word: str
    sentence: str


def _standing(level: str, sentence: str) -> Standing:
    return Standing(level, WORD_OF_LEVEL[level], sentence)


def _onboard(row: FleetRow) -> Standing | None:
    """Judge what is known of the parameters on board."""
    if row.onboard_state == "MISMATCH":
        return _standing("critical", "The read-back from the spacecraft differs from what was sent.")
    return None


def _last_run(row: FleetRow) -> Standing | None:
    """Judge the newest run."""
    run = row.last_run
    if run is None:
        return None
    if run.state in {"FAILED", "LOST"}:
        cause = (run.reason or "no cause was recorded").rstrip(".")
        return _standing("serious", f"Run {run.id} {run.state}: {cause}.")
    return _fit(run.id, run.summary or {}) if run.state == "SUCCEEDED" else None


def _fit(run_id: int, summary: dict[str, Any]) -> Standing | None:
    """Judge the result of a run that succeeded."""
    status = str(summary.get("status", "converged"))
    if status != "converged":
        return _standing(level_of(status), f"Run {run_id} ended {status.replace('_', ' ')}.")
    before, after = summary.get("rms_initial_arc_rad"), summary.get("rms_final_arc_rad")
    if before is not None and after is not None and after > before:
        return _standing("caution", f"Run {run_id} fits worse than the parameters it began from.")
    return None


def _data(row: FleetRow) -> Standing | None:
    """Judge whether the sensor was ever calibrated on orbit."""
    if row.telemetry_sets == 0:
        return _standing("off", "No telemetry yet: upload a set to begin.")
    if row.last_run is None:
        return _standing("standby", "Telemetry is here, no run yet: launch a calibration.")
    return None


def _baseline(row: FleetRow) -> Standing | None:
    """Judge the baseline."""
    if row.baseline is None:
        return _standing("caution", "No baseline: approve and promote a parameter set.")
    return None


def _work(row: FleetRow) -> Standing | None:
    """Tell of a run on its way."""
    run = row.last_run
    if run is not None and run.state in {"QUEUED", "RUNNING", "CANCELLING"}:
        return _standing("standby", f"Run {run.id} is {run.state}.")
    return None


RULES: Sequence[Callable[[FleetRow], Standing | None]] = (_onboard, _last_run, _baseline, _data, _work)


def sensor_standing(row: FleetRow) -> Standing:
    """Return the worst of what the rules say of a sensor."""
    found = [standing for rule in RULES if (standing := rule(row)) is not None]
    if not found:
        return _standing("normal", "The last calibration settled and nothing is wrong.")
    return max(found, key=lambda standing: LEVELS.index(standing.level))


def worst_standing(rows: Sequence[FleetRow]) -> Standing:
    """Return how a fleet stands: as its worst sensor, named."""
    if not rows:
        return Standing("off", "NO SENSORS", "No sensors yet: register one.")
    standings = [(sensor_standing(row), row.sensor.name) for row in rows]
    worst, name = max(standings, key=lambda pair: LEVELS.index(pair[0].level))
    alike = sum(standing.level == worst.level for standing, _ in standings)
    more = f" ({alike} sensors are {worst.word})" if alike > 1 else ""
    return Standing(worst.level, worst.word, f"{name}: {worst.sentence}{more}")


def fleet_standing(session: Session) -> tuple[Standing, int]:
    """Return how the fleet stands and how many requests wait for a signature."""
    return worst_standing(sensors.fleet_overview(session)), len(approvals.list_approvals(session, state="OPEN"))
