"""What is remembered of drift: as good as a judgement made anew, and made anew when anything it rests on changed."""

import numpy as np
import pytest

from boresight.console.alarms.rules import evaluate_rules
from boresight.console.fleet import queries as sensors
from boresight.console.fleet import status as judgements
from boresight.console.fleet import trend as drift
from boresight.console.fleet.trend import read_trend
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from tests.missions import add_run, add_set, make_baseline


def _remembered(session: Session) -> judgements.DriftVerdict:
    heads, baselines = sensors.sensor_heads(session, [1]), sensors.baseline_heads(session)
    return judgements.get_drift_verdicts(session, heads, baselines, sensors.stamps(session))[1]


def test_it_equals_a_judgement_made_anew_after_every_change_of_the_trend(session: Session) -> None:
    rng = np.random.default_rng(1)
    verdicts = []

    def look() -> None:
        found = drift.judge_drift(read_trend(session, 1))
        remembered = _remembered(session)
        assert (remembered.verdict, remembered.sentence) == (found.verdict, found.sentence)
        assert remembered.document == drift.document(found)
        verdicts.append(found.verdict)

    look()
    first = add_run(session, add_set(session, 1, 0), rng)
    look()
    make_baseline(session, first)
    look()
    moved = add_run(session, add_set(session, 1, 90), rng, np.eye(8)[0])
    look()
    make_baseline(session, moved)
    look()
    assert "DRIFT" in verdicts
    assert verdicts[-1] != "DRIFT"


def test_a_second_look_at_an_unchanged_fleet_reads_no_run(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_writing(engine) as session:
        add_run(session, add_set(session, 1, 0), np.random.default_rng(1))
        audit.append(session, COMMAND_LINE, "calibrated", "sensors/1")
    with open_reading(engine) as session:
        before = evaluate_rules(session)
    monkeypatch.setattr(judgements, "read_trends", lambda *_: pytest.fail("a trend was read again"))
    for transaction in (open_reading, open_writing):
        with transaction(engine) as session:
            assert evaluate_rules(session) == before


def test_who_must_not_wait_asks_of_a_few_anew_and_is_told_the_rest_when_it_is_known(session: Session) -> None:
    heads, baselines = sensors.sensor_heads(session), sensors.baseline_heads(session)
    stamps = sensors.stamps(session)
    assert judgements.get_drift_verdicts(session, heads, baselines, stamps, most=0) == {}
    known = judgements.get_drift_verdicts(session, heads, baselines, stamps, most=1)
    assert list(known) == [1]
    assert judgements.get_drift_verdicts(session, heads, baselines, stamps, most=0) == known


def test_a_judgement_that_is_out_of_date_stands_until_it_is_made_anew(session: Session) -> None:
    rng = np.random.default_rng(2)

    def told(most: int | None) -> dict[int, judgements.DriftVerdict]:
        heads, baselines = sensors.sensor_heads(session), sensors.baseline_heads(session)
        return judgements.get_drift_verdicts(session, heads, baselines, sensors.stamps(session), most=most)

    before = told(None)
    for day in range(4):
        add_run(session, add_set(session, 1, 30.0 * day), rng, 30.0 * np.eye(8)[0])
    assert told(0) == before
    assert told(1)[1].verdict != before[1].verdict
