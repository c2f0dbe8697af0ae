"""Whether each sensor drifts, remembered: every page and every round of the upkeep asks, and an answer takes reading every run.

A trend changes when a run succeeds, when another set becomes the baseline, or when the sensor's document does, and by nothing
else: telemetry and finished runs are never rewritten. So a judgement rests on three values that cost one query for the whole
fleet, and is made anew when one of them is another. What is remembered is small and belongs to one store.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from boresight.services import drift
from boresight.services.trend import trends_of
from boresight.store import sensors as rows
from boresight.store.sessions import Session

TOGETHER = 16  # sensors whose runs are held in memory at once


@dataclass(frozen=True)
class Judgement:
    """What `drift.judge` said: its verdict, its sentence, and the figures as JSON."""

    verdict: str
    sentence: str
    document: dict[str, Any]


#: By store and sensor: what a judgement rests on, and the judgement.
_known: WeakKeyDictionary[Any, dict[int, tuple[Any, Judgement]]] = WeakKeyDictionary()


def judgements(
    session: Session,
    sensors: Sequence[Any],
    baselines: Mapping[int, Any],
    stamps: Mapping[int, Any],
    *,
    most: int | None = None,
) -> dict[int, Judgement]:
    """Return whether some sensors drift, by their ids; those that must be asked anew are, `TOGETHER` at a time.

    Parameters
    ----------
    sensors, baselines
        Rows or heads of rows (`store.sensors`); the sets that their runs are held against, by sensor.
    stamps
        Of their runs, as `store.trends.stamps` gives them; a sensor of which none succeeded has none.
    most
        How many are asked anew; of those beyond the answer is the last that is known, or none.
    """
    of_store = _known.setdefault(session.get_bind().engine.pool, {})  # an engine with options is another object
    rests_on = {sensor.id: _rests_on(sensor, baselines.get(sensor.id), stamps.get(sensor.id)) for sensor in sensors}
    unknown = [sensor.id for sensor in sensors if of_store.get(sensor.id, (None,))[0] != rests_on[sensor.id]]
    anew = unknown if most is None else unknown[:most]
    for start in range(0, len(anew), TOGETHER):
        asked = rows.sensors(session, anew[start : start + TOGETHER])
        for sensor_id, trend in trends_of(session, asked).items():
            found = drift.judge(trend)
            of_store[sensor_id] = rests_on[sensor_id], Judgement(found.verdict, found.sentence, drift.document(found))
    return {sensor.id: of_store[sensor.id][1] for sensor in sensors if sensor.id in of_store}


def _rests_on(sensor: Any, baseline: Any, stamp: Any) -> tuple[Any, ...]:
    """Return what changes when a sensor's trend does."""
    return None if baseline is None else baseline.id, sensor.version, stamp
