"""The conditions that raise an alarm, each asked of the store as it is now.

========== ======== ==========================================================================================
`DRIFT`    serious  the parameters do not hold any more (`services.drift`), 0.1 % false alarms for each look;
                    a shift against a ground calibration alone is no drift
`AGE`      caution  the baseline is older than `fleet.OLD_DAYS`
`MISMATCH` critical a read-back of one of the sensor's sets did not match what was sent
`CHAIN`    critical the audit log, or a row that it seals, is not as it was written
`CLOCK`    serious  the clock jumped (`services.clock`): nothing expires until somebody acknowledges it
`HEAD`     serious  the head of the audit log cannot be written to where it is kept
`FILES`    critical a stored file that rows name was altered on the disk, or is missing
========== ======== ==========================================================================================

A sentence says nothing that changes by the passing of time alone, so that looking again changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

from boresight.services.fleet import OLD_DAYS, days_since
from boresight.services.judgements import Judgement, judgements
from boresight.store import sensors as rows
from boresight.store import trends
from boresight.store.files import BadFile
from boresight.store.sessions import Session, utc_text

CHAIN = "audit/CHAIN"
FILES = "blobs/FILES"
HEAD = "audit/HEAD"
FILES_NAMED = 100


@dataclass(frozen=True)
class Condition:
    """Something that is not as it should be.

    Parameters
    ----------
    source
        What it is of and of which kind, `sensors/3/DRIFT`; one alarm of a source is open at a time.
    sensor_id, kind, level
        As the alarm has them.
    sentence
        What is wrong and what to do.
    evidence
        The figures behind it.
    """

    source: str
    sensor_id: int | None
    kind: str
    level: str
    sentence: str
    evidence: Mapping[str, Any] = field(default_factory=dict)


def conditions(session: Session, sensor_ids: Sequence[int] | None = None) -> list[Condition]:
    """Return what is wrong with the fleet, or with some of its sensors."""
    baselines, stamps = rows.baseline_heads(session, sensor_ids), trends.stamps(session, sensor_ids)
    onboard, fleet = rows.onboard_heads(session, sensor_ids), rows.sensor_heads(session, sensor_ids)
    drifts = judgements(session, fleet, baselines, stamps)
    return [
        found
        for sensor in fleet
        for found in (
            *_mismatches(sensor, onboard.get(sensor.id, ())),
            *_drift(sensor, drifts[sensor.id]),
            *_age(sensor, baselines.get(sensor.id)),
        )
    ]


def source_of(sensor_id: int, kind: str) -> str:
    """Name what an alarm is of."""
    return f"sensors/{sensor_id}/{kind}"


def chain_condition(state: str, sentence: str) -> Condition | None:
    """Return what is wrong with the audit log, from what its last verification found."""
    return Condition(CHAIN, None, "CHAIN", "critical", sentence) if state == "broken" else None


def head_condition(fault: str) -> Condition | None:
    """Return that the head cannot be kept; None where it can."""
    return Condition(HEAD, None, "HEAD", "serious", fault) if fault else None


def files_condition(bad: Sequence[BadFile]) -> Condition | None:
    """Return what is wrong with the stored files, from those that were found bad and that rows name."""
    if not bad:
        return None
    more = f", and {len(bad) - 1} more" if len(bad) > 1 else ""
    sentence = (
        f"The stored file {bad[0]}{more}: nothing is made of it; bring it back from a backup, and look at the disk."
    )
    evidence = {
        "files": [{"sha256": one.sha256, "what": one.what, "used_by": list(one.used_by)} for one in bad[:FILES_NAMED]]
    }
    return Condition(FILES, None, "FILES", "critical", sentence, evidence)


def _drift(sensor: Any, found: Judgement) -> Iterator[Condition]:
    """Ask whether the parameters hold."""
    if found.verdict == "DRIFT":
        sentence = f"{sensor.name} drifts. {found.sentence}"
        yield Condition(source_of(sensor.id, "DRIFT"), sensor.id, "DRIFT", "serious", sentence, found.document)


def _age(sensor: Any, baseline: Any) -> Iterator[Condition]:
    """Ask whether the baseline is too old."""
    age_d = days_since(baseline)
    if baseline is None or baseline.baseline_from_utc is None or age_d is None or age_d <= OLD_DAYS:
        return
    due_utc = utc_text(datetime.fromisoformat(baseline.baseline_from_utc) + timedelta(days=OLD_DAYS))
    sentence = f"{baseline.name} of {sensor.name} is over its {OLD_DAYS:.0f} days since {due_utc[:10]}: recalibrate."
    evidence = {"parameter_set_id": baseline.id, "due_utc": due_utc}
    yield Condition(source_of(sensor.id, "AGE"), sensor.id, "AGE", "caution", sentence, evidence)


def _mismatches(sensor: Any, onboard: Sequence[Any]) -> Iterator[Condition]:
    """Ask whether a read-back failed."""
    bad = [row for row in onboard if row.onboard_state == "MISMATCH"]
    if bad:
        names = ", ".join(row.name for row in bad)
        sentence = f"The read-back of {names} does not match what was sent: look at the difference, then send it again."
        evidence = {"parameter_set_ids": [row.id for row in bad]}
        yield Condition(source_of(sensor.id, "MISMATCH"), sensor.id, "MISMATCH", "critical", sentence, evidence)
