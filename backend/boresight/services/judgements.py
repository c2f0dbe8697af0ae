"""Whether each sensor drifts, remembered: every page and every round of the upkeep asks, and an answer takes reading every run.

A trend changes when a run succeeds, when another set becomes the baseline, or when the sensor's document does, and by nothing
else: telemetry and finished runs are never rewritten. So a judgement rests on three values that cost one query for the whole
fleet, and is made anew when one of them is another. What is remembered is small and belongs to one store.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from boresight.services import drift
from boresight.services.trend import trend_of
from boresight.store.sessions import Session
from boresight.store.tables import ParameterSet, Sensor


@dataclass(frozen=True)
class Judgement:
    """What `drift.judge` said: its verdict, its sentence, and the figures as JSON."""

    verdict: str
    sentence: str
    document: dict[str, Any]


#: By store and sensor: what a judgement rests on, and the judgement.
_known: WeakKeyDictionary[Any, dict[int, tuple[Any, Judgement]]] = WeakKeyDictionary()


def judgement(session: Session, sensor: Sensor, baseline: ParameterSet | None, stamp: Any) -> Judgement:
    """Return whether a sensor drifts.

    Parameters
    ----------
    baseline
        The set that its runs are held against.
    stamp
        Of its runs, as `store.trends.stamps` gives it; None where none succeeded.
    """
    of_store = _known.setdefault(session.get_bind().pool, {})  # an engine with options is another object
    rests_on = (None if baseline is None else baseline.id, sensor.version, stamp)
    before, known = of_store.get(sensor.id, (None, None))
    if known is None or before != rests_on:
        found = drift.judge(trend_of(session, sensor.id))
        known = Judgement(found.verdict, found.sentence, drift.document(found))
        of_store[sensor.id] = rests_on, known
    return known
