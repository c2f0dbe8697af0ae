"""The queries on alarms, notes and trends answer alike on both engines."""

import numpy as np
import pytest

from boresight.console.alarms import queries as alarms_queries
from boresight.console.alarms import rules
from boresight.console.alarms import service as alarms
from boresight.console.fleet import queries as of_sensors
from boresight.console.fleet import service as sensors
from boresight.console.fleet import status as fleet
from boresight.console.fleet.trend_document import trend_document
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.db.sessions import Engine, open_reading, open_writing, utc_after
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document
from tests.missions import add_run, add_set, make_baseline


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest) -> Engine:
    store: Engine = request.getfixturevalue(request.param)
    rng = np.random.default_rng(4)
    with open_writing(store) as session:
        number = sensors.register_sensor(session, COMMAND_LINE, sensor_document(st16_sensor(1))).id
        made = [add_run(session, add_set(session, number, 30.0 * k), rng, 0.1 * k * np.eye(8)[0]) for k in range(5)]
        make_baseline(session, made[0])
        assert rules.update_alarms(session) == 1
    return store


def test_an_alarm_is_found_by_its_state_and_counted_while_it_waits(store: Engine) -> None:
    with open_writing(store) as session:
        (row,) = alarms.list_alarms(session, alarms.AlarmFilter(state="unacknowledged", kind="DRIFT", sensor_id=1))
        assert alarms.unacknowledged(session) == 1
        row.shelved_until_utc = utc_after(60)
        alarms.step(session, COMMAND_LINE, row, "SHELVED", "Later.")
        assert alarms.unacknowledged(session) == 0
        found = {state: len(alarms.list_alarms(session, alarms.AlarmFilter(state=state))) for state in alarms.STATES}
        assert found == {"unacknowledged": 0, "acknowledged": 0, "shelved": 1, "closed": 0}
        row.shelved_until_utc = utc_after(-1)
        assert [late.id for late in alarms_queries.overdue_shelves(session)] == [row.id]
        alarms.step(session, COMMAND_LINE, row, "UNSHELVED", "")


def test_a_trend_and_the_newest_summaries_are_read(store: Engine) -> None:
    with open_reading(store) as session:
        document = trend_document(session, 1)
        assert (document["drift"]["verdict"], len(document["points"])) == ("DRIFT", 5)
        newest = of_sensors.recent_summaries(session, [1], 3)[1]
        assert [summary["trend"]["parameters"] for summary in newest] == [
            run.summary["trend"]["parameters"] for run in of_sensors.finished(session, [1])[1][-3:]
        ]


def test_of_each_sensor_its_own_newest_run_is_found_and_a_head_says_what_its_row_does(store: Engine) -> None:
    rng = np.random.default_rng(5)
    with open_writing(store) as session:
        for name in ("B", "C"):
            document = sensor_document(st16_sensor(1)) | {"name": name}
            number = sensors.register_sensor(session, COMMAND_LINE, document).id
            for day in range(3) if name == "B" else ():
                add_run(session, add_set(session, number, 30.0 * day), rng)
    with open_reading(store) as session:
        newest = {number: max(run.id for run in runs) for number, runs in of_sensors.finished(session, [1, 2]).items()}
        for asked in (None, [1, 2, 3]):
            runs, heads = of_sensors.last_runs(session, asked), of_sensors.last_run_heads(session, asked)
            assert {number: run.id for number, run in runs.items()} == newest
            assert {number: head[1:] for number, head in heads.items()} == {
                number: (run.id, run.state, run.reason, run.summary) for number, run in runs.items()
            }
            sets, short = of_sensors.baselines(session, asked), of_sensors.baseline_heads(session, asked)
            assert {number: head[1:] for number, head in short.items()} == {
                number: (row.id, row.name, row.run_id, row.baseline_from_utc) for number, row in sets.items()
            }
        assert set(of_sensors.last_runs(session, [2])) == {2}
        assert len({head.status for head in fleet.list_sensor_statuses(session)}) > 1
        one_by_one = [one for number in (2, 3, 1) for one in fleet.list_sensor_statuses(session, [number])]
        assert fleet.list_sensor_statuses(session) == one_by_one
