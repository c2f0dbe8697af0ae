"""What became of the runs of a measurement: every row, every log, every result, and the audit log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from boresight.measurements.constellation import Constellation, digest_of
from boresight.services import audit, runs
from boresight.services.telemetry_sets import get_telemetry_set
from boresight.store.sessions import Session, reading
from boresight.store.tables import TERMINAL_RUN_STATES, Run


def examined(constellation: Constellation, first: int, count: int) -> dict[str, Any]:
    """Look at `count` runs that were launched after the first ones.

    Returns
    -------
    dict
        `computing_s` and `computing_cpu_s` as the workers state them, summed; how many runs there are of each state and of each
        number of attempts; `not_as_promised`, how many are missing, did not succeed exactly once, or have another result than the
        same work has in this process; what a verification of the audit log said; `claims_per_run` and `settlements_per_run`, how
        many transactions a run took for each, as the runs of a group share theirs and with it the moment that is written.
    """
    with reading(constellation.database) as session:
        rows = _rows(session)[first:]
        good = sum(_is_good(session, constellation, row) for row in rows)
        chain = audit.verify(session)
    summaries: list[Mapping[str, Any]] = [row.summary or {} for row in rows]
    return {
        "computing_s": sum(summary.get("seconds", 0.0) for summary in summaries),
        "computing_cpu_s": sum(summary.get("cpu_seconds", 0.0) for summary in summaries),
        "claims_per_run": len({row.started_utc for row in rows}) / count,
        "settlements_per_run": len({row.ended_utc for row in rows}) / count,
        "states": dict(Counter(row.state for row in rows)),
        "attempts": {str(attempt): number for attempt, number in sorted(Counter(row.attempt for row in rows).items())},
        "not_as_promised": abs(count - len(rows)) + len(rows) - good,
        "audit": {"ok": chain.ok, "records": chain.records, "sentence": chain.sentence},
    }


def _rows(session: Session) -> list[Run]:
    """Read all runs, oldest first."""
    return runs.list_runs(session)[::-1]


def _is_good(session: Session, constellation: Constellation, row: Run) -> bool:
    """Say whether a run succeeded once, with the result that it must have."""
    words = [line.state for line in runs.log_lines(session, row.id)]
    if [word for word in words if word in TERMINAL_RUN_STATES] != ["SUCCEEDED"] or row.result_sha256 is None:
        return False
    table = get_telemetry_set(session, row.telemetry_set_id).table_sha256
    content = constellation.blobs.read(row.result_sha256)
    return digest_of(content) == constellation.expected[table]
