"""The fleet at a glance: the worst that is known of a sensor, with the sentence why."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from boresight.console.alarms.rules import evaluate_rules
from boresight.console.approvals import service as approvals
from boresight.console.fleet.status import (
    STATUS_WORDS,
    SensorFacts,
    SensorTile,
    list_findings,
    list_fleet_tiles,
    list_sensor_statuses,
)
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.console.uplinks import service as uplinks
from boresight.platform.actors import Actor
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_after
from boresight.verdicts.verdict import summary_of
from tests.console.uplinks.services import climb, promote_by_hand
from tests.missions import add_run, add_set

NOTHING = SensorFacts(baseline=None, last_run=None, onboard=(), waiting=None, telemetry_sets=0, days=None)


def _tile(engine: Engine) -> SensorTile:
    with open_reading(engine) as session:
        return list_fleet_tiles(session)[0]


def test_a_new_sensor_is_off_for_want_of_telemetry(engine: Engine) -> None:
    tile = _tile(engine)
    assert (tile.status, tile.telemetry_sets, tile.last_run) == ("off", 0, None)
    assert "upload" in tile.sentence
    assert tile.baseline is not None
    assert tile.baseline.number == 0
    assert 0.0 <= tile.days_since_calibration < 1.0  # type: ignore[operator]


@pytest.mark.parametrize(
    ("made", "status", "says"),
    [
        ({}, "normal", "Run 1 converged"),
        ({"status": "max_iterations"}, "caution", "stopped at max iterations"),
        ({"status": "rank_deficient"}, "serious", "ended rank deficient"),
        ({"status": "diverged"}, "serious", "ended diverged"),
        ({"state": "FAILED"}, "serious", "Run 1 failed"),
        ({"state": "LOST"}, "serious", "Run 1 lost"),
        ({"state": "QUEUED"}, "standby", "Run 1 is queued"),
        ({"state": "RUNNING"}, "standby", "Run 1 is running"),
        ({"state": "CANCELLED"}, "standby", "Run 1 was cancelled"),
    ],
)
def test_the_newest_run_speaks_for_the_sensor(
    engine: Engine, finished_run: Callable[..., Run], made: dict[str, str], status: str, says: str
) -> None:
    with open_writing(engine) as session:
        finished_run(session, **made)
    tile = _tile(engine)
    assert tile.status == status
    assert says in tile.sentence


CONSISTENT = {"chi2": {"consistent": True, "dof": 90, "lower": 0.8, "upper": 1.2}, "method": "batch"}
WEAK = {"sigma_of_direction": [0.1, 0.7], "singular_values": [10.0, 1.4], "weakest": {"sentence": "m0 is weak."}}


@pytest.mark.parametrize(
    ("found", "status", "says"),
    [
        ({}, "normal", "Run 1 converged."),
        (
            {"chi2": CONSISTENT["chi2"] | {"consistent": False}, "chi2_per_dof": 4.0},
            "caution",
            "degree of freedom is 4",
        ),
        ({"observability": WEAK}, "caution", "with reservations"),
        ({"advice": ["Only 12 frames took part. Add some.", "More."]}, "caution", ": Only 12 frames took part."),
        (
            {"status": "diverged", "advice": ["The fit diverged: stop."]},
            "serious",
            "ended diverged: The fit diverged: stop.",
        ),
        ({"status": "rank_deficient", "advice": ["Hold a1."]}, "serious", "ended rank deficient: Hold a1."),
        ({"validation": {"rms_arc_rad": {"initial": 1e-5, "final": 2e-5}}}, "serious", "On the validation set"),
    ],
)
def test_a_fit_that_its_page_doubts_is_not_normal_for_the_fleet(
    engine: Engine, finished_run: Callable[..., Run], found: dict[str, Any], status: str, says: str
) -> None:
    with open_writing(engine) as session:
        run = finished_run(session)
        run.summary = summary_of({"status": "converged", "chi2_per_dof": 1.0, **CONSISTENT, **found})
    tile = _tile(engine)
    assert tile.status == status
    assert says in tile.sentence
    assert tile.sentence.endswith(".")


def test_an_older_failure_does_not_speak_for_the_sensor(engine: Engine, finished_run: Callable[..., Run]) -> None:
    with open_writing(engine) as session:
        finished_run(session, state="FAILED")
        finished_run(session)
    assert _tile(engine).status == "normal"


def test_a_request_that_waits_is_a_caution(
    engine: Engine, people: Mapping[str, Actor], candidate: Callable[..., ParameterSet], blobs: BlobStore
) -> None:
    row = candidate()
    with open_writing(engine) as session:
        approvals.submit(session, people["ana"], blobs, row.id, "better", row.version)
    tile = _tile(engine)
    assert (tile.status, tile.sentence) == ("caution", f"{row.name} waits for a signature.")


def test_a_mismatch_on_board_is_critical_above_all(
    engine: Engine, people: Mapping[str, Actor], finished_run: Callable[..., Run]
) -> None:
    with open_writing(engine) as session:
        finished_run(session, state="FAILED")
        for state in ("SENT", "MISMATCH"):
            uplinks.record(session, people["dee"], 1, state, "pass 4711")
    tile = _tile(engine)
    assert tile.status == "critical"
    assert "PS-ST16-1-0 does not match" in tile.sentence


def test_an_active_set_that_is_not_the_baseline_is_a_caution(
    engine: Engine, people: Mapping[str, Actor], candidate: Callable[..., ParameterSet]
) -> None:
    row = candidate()
    climb(engine, people["dee"], "SENT", "LOADED", "VERIFIED", "ACTIVE")
    with open_writing(engine) as session:
        promote_by_hand(session, session.get_one(ParameterSet, row.id), utc_after(0.0))
    tile = _tile(engine)
    assert tile.active is not None
    assert tile.active.id == 1
    assert (tile.status, f"baseline is {row.name}" in tile.sentence) == ("caution", True)


def test_an_old_baseline_asks_for_calibration(engine: Engine, finished_run: Callable[..., Run]) -> None:
    with open_writing(engine) as session:
        finished_run(session)
        session.get_one(ParameterSet, 1).baseline_from_utc = utc_after(-200 * 86400.0)
    tile = _tile(engine)
    assert tile.status == "caution"
    assert "200 days old; recalibrate" in tile.sentence


def test_telemetry_without_a_run_is_on_standby() -> None:
    baseline = ParameterSet(name="PS-X-0", run_id=None)
    known = SensorFacts(baseline=baseline, last_run=None, onboard=(), waiting=None, telemetry_sets=1, days=1.0)
    assert dict(list_findings(known)) == {"standby": "There is telemetry and no calibration yet; launch a run."}


def test_every_finding_is_one_of_the_words_and_there_always_is_one(
    session: Session, finished_run: Callable[..., Run], blobs: BlobStore
) -> None:
    assert blobs.folder.parent.is_dir()
    for number in range(2):
        for run in (None, finished_run(session), finished_run(session, state="QUEUED")):
            known = SensorFacts(baseline=None, last_run=run, onboard=(), waiting=None, telemetry_sets=number, days=None)
            found = list(list_findings(known))
            assert found
            assert all(word in STATUS_WORDS and sentence.endswith(".") for word, sentence in found)
    assert [word for word, _ in list_findings(NOTHING)] == ["serious", "off"]


def test_the_fleet_stands_as_its_tiles_say(
    engine: Engine, finished_run: Callable[..., Run], people: Mapping[str, Actor]
) -> None:
    with open_writing(engine) as session:
        finished_run(session, state="FAILED")
        for state in ("SENT", "MISMATCH"):
            uplinks.record(session, people["dee"], 1, state, "pass 4711")
    with open_reading(engine) as session:
        stand = list_sensor_statuses(session)
        tiles = list_fleet_tiles(session)
        assert [(one.sensor_id, one.name, one.status, one.sentence) for one in stand] == [
            (tile.sensor.id, tile.sensor.name, tile.status, tile.sentence) for tile in tiles
        ]
        assert (list_sensor_statuses(session, [1]), list_sensor_statuses(session, [99])) == (stand, [])


def test_a_ground_shift_beyond_what_a_look_asks_anew_is_said_once_it_is_known(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(6)
    for day in range(4):
        add_run(session, add_set(session, 1, 30.0 * day), rng, 30.0 * np.eye(8)[0])
    monkeypatch.setattr("boresight.console.fleet.status.MOST_JUDGED", 0)
    assert [one.status for one in list_sensor_statuses(session)] == ["normal"]
    evaluate_rules(session)
    assert [one.status for one in list_sensor_statuses(session)] == ["caution"]
    assert "ground calibration" in list_sensor_statuses(session)[0].sentence
