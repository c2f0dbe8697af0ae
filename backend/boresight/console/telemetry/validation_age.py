"""Whether validation frames are older than a change that a fit found, which makes the better parameters look worse on them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from boresight.console.telemetry.tables import TelemetrySet, find_quality
from boresight.verdicts.numbers import duration


def explain_old_validation(fitted: Sequence[TelemetrySet], validation: TelemetrySet | None) -> str:
    """Say that validation frames end longer before the data of a fit than these last; empty where they do not, or have no times."""
    spans = [span for row in fitted if (span := _find_span(row)) is not None]
    judging = None if validation is None else _find_span(validation)
    if validation is None or judging is None or not spans or len(spans) < len(fitted):
        return ""
    begins, ends = min(begin for begin, _ in spans), max(end for _, end in spans)
    if begins - judging[1] <= ends - begins:
        return ""
    earlier = duration((begins - judging[1]).total_seconds())
    return (
        f"The validation frames of {validation.name} end {earlier} before the data, so a change since then looks like a worse fit: "
        "upload frames that were taken since, and run again with them as validation set."
    )


def _find_span(row: TelemetrySet) -> tuple[datetime, datetime] | None:
    time = find_quality(row.quality).time
    return None if time is None else (datetime.fromisoformat(time.start_utc), datetime.fromisoformat(time.end_utc))
