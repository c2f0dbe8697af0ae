"""The queries on alarms, notes and trends answer alike on both engines."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.services import alarms, sensors, watch
from boresight.services.actors import COMMAND_LINE
from boresight.services.trend_views import trend_document
from boresight.simulation.sensors import st16_sensor
from boresight.store import alarms as rows
from boresight.store import trends
from boresight.store.sessions import Engine, reading, utc_after, writing
from boresight.telemetry.sensors import sensor_document
from tests.missions import add_run, add_set, make_baseline


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest) -> Engine:
    """Each engine in turn, with a sensor that drifts and its alarm."""
    store: Engine = request.getfixturevalue(request.param)
    rng = np.random.default_rng(4)
    with writing(store) as session:
        number = sensors.register_sensor(session, COMMAND_LINE, sensor_document(st16_sensor(1))).id
        made = [add_run(session, add_set(session, number, 30.0 * k), rng, 0.1 * k * np.eye(8)[0]) for k in range(5)]
        make_baseline(session, made[0])
        assert watch.watch(session) == 1
    return store


def test_an_alarm_is_found_by_its_state_and_counted_while_it_waits(store: Engine) -> None:
    with writing(store) as session:
        (row,) = alarms.list_alarms(session, alarms.Sought(state="unacknowledged", kind="DRIFT", sensor_id=1))
        assert alarms.unacknowledged(session) == 1
        row.shelved_until_utc = utc_after(60)
        alarms.step(session, COMMAND_LINE, row, "SHELVED", "Later.")
        assert alarms.unacknowledged(session) == 0
        found = {state: len(alarms.list_alarms(session, alarms.Sought(state=state))) for state in alarms.STATES}
        assert found == {"unacknowledged": 0, "acknowledged": 0, "shelved": 1, "closed": 0}
        row.shelved_until_utc = utc_after(-1)
        assert [late.id for late in rows.overdue_shelves(session)] == [row.id]
        alarms.step(session, COMMAND_LINE, row, "UNSHELVED", "")


def test_a_trend_and_the_newest_summaries_are_read(store: Engine) -> None:
    with reading(store) as session:
        document = trend_document(session, 1)
        assert (document["drift"]["verdict"], len(document["points"])) == ("DRIFT", 5)
        newest = trends.recent_summaries(session, [1], 3)[1]
        assert [summary["trend"]["parameters"] for summary in newest] == [
            run.summary["trend"]["parameters"] for run in trends.finished(session, [1])[1][-3:]
        ]
