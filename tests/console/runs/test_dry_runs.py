"""A dry run tells size, time with its spread, and what a forecast sees; forecasts are kept, and failing ones are sentences."""

from pathlib import Path

import pytest

from boresight.calibration.options import CalibrationSettings
from boresight.console.fleet.tables import Sensor
from boresight.console.runs import service as runs
from boresight.console.runs.dry_runs import estimate_run_speed
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import open_writing, utc_now
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.telemetry.read.readers import write_parquet
from boresight.telemetry.sensors import sensor_document
from tests.calibration.conftest import telemetry
from tests.calibration.sets import st16_sensor
from tests.estimation.fields import GROUND

SETTINGS = {"method": "batch", "match": "given"}


@pytest.fixture
def sight(blobs, catalogue):
    return ForecastSources(blobs, lambda: catalogue, Path("nowhere"))


@pytest.fixture
def session(engine, people, blobs, tmp_path):
    write_parquet(telemetry(1, frames=30), tmp_path / "table.parquet")
    with open_writing(engine) as session:
        sha256 = register_blob(session, blobs, blobs.put(tmp_path / "table.parquet"), "text/csv").sha256
        columns = {"original_sha256": sha256, "table_sha256": sha256, "uploaded_utc": utc_now()}
        session.add(
            TelemetrySet(sensor_id=1, name="set-1", purpose="calibration", frames=30, stars=720, quality={}, **columns)
        )
        session.get_one(Sensor, 1).document = {
            **sensor_document(st16_sensor(1)),
            "initial": dict(zip(sensor_document(st16_sensor(1))["initial"], GROUND.tolist(), strict=True)),
        }
        session.flush()
        audit.append(session, people["ana"], "brought in", "telemetry-sets/1")
        yield session


def _asked(session, people, sight, **settings):
    return runs.launch(session, people["ana"], 1, 1, {**SETTINGS, **settings}, validate_only=True, sight=sight)


def test_a_dry_run_foretells_every_free_parameters_sigma_and_says_it_in_words(session, people, sight):
    forecast = _asked(session, people, sight, free=["f_m", "b2_per_m2"])["forecast"]
    assert list(forecast["sigma"]) == ["f_m", "b2_per_m2"]
    assert all(0 < sigma < forecast["typical_sigma"][name] for name, sigma in forecast["sigma"].items())
    assert forecast["sentence"] == "2 parameters, all observable with this coverage."
    assert (forecast["frames_sampled"], forecast["frames"], forecast["at"]) == (30, 30, "fitted")


def test_a_forecast_is_kept_until_a_setting_or_the_sensor_changes(session, people, sight):
    first = _asked(session, people, sight)["forecast"]
    assert _asked(session, people, sight)["forecast"] is first
    assert _asked(session, people, sight, method="sqrf")["forecast"] is not first
    sensor = session.get_one(Sensor, 1)
    sensor.document = {**sensor.document, "centroid_sigma_px": 2 * sensor.document["centroid_sigma_px"]}
    wider = _asked(session, people, sight)["forecast"]
    session.refresh(sensor)
    assert wider is not first


def test_only_the_latest_forecasts_are_kept(blobs, catalogue, monkeypatch):
    monkeypatch.setattr("boresight.platform.jobs.forecasts.KEPT", 3)
    sight = ForecastSources(blobs, lambda: catalogue, Path("nowhere"))
    for number in range(5):
        sight.forecast(f"{number:064}", {}, CalibrationSettings())
    assert len(sight._made) == 3


def test_a_table_that_is_gone_is_a_sentence_of_the_forecast_and_no_refusal(session, people, sight, blobs):
    blobs.path(session.get_one(TelemetrySet, 1).table_sha256).unlink()
    forecast = _asked(session, people, sight)["forecast"]
    assert forecast["at"] is None
    assert "is missing" in forecast["sentence"]
    assert "restore it from a backup" in forecast["sentence"]


def test_without_stars_to_look_at_the_dry_run_still_tells_its_size(session, people, blobs):
    blind = ForecastSources(blobs, lambda: None, Path("nowhere"))
    assert _asked(session, people, None)["forecast"] is None
    assert "no star catalogue" in _asked(session, people, blind)["forecast"]["sentence"]
    assert _asked(session, people, blind)["frames"] == 30


def _run_of(session, people, seconds, **settings):
    made = runs.launch(session, people["ana"], 1, 1, {**SETTINGS, **settings})
    row = session.get_one(Run, made.id)
    row.state, row.summary = "SUCCEEDED", {"seconds": seconds, "stars": 1000, "frames": 100}
    session.flush()
    audit.append(session, people["ana"], "ended", f"runs/{row.id}")


def test_the_time_is_told_with_the_spread_of_past_runs_and_how_many_they_were(session, people):
    guess = estimate_run_speed(session, "batch")
    for seconds in range(1, 12):
        _run_of(session, people, seconds)
    pace = estimate_run_speed(session, "batch")
    summary = _asked(session, people, None)
    assert guess.runs == 0
    assert guess.low < guess.s_per_star < guess.high
    assert (pace.runs, pace.s_per_star, pace.low, pace.high) == (11, 6e-3, pytest.approx(2e-3), pytest.approx(10e-3))
    low, high = summary["predicted_range_s"]
    assert low < summary["predicted_s"] < high
    assert summary["predicted_s"] == pytest.approx(0.72 * 6, abs=0.1)
    assert summary["paced_by"] == 11


def test_one_past_run_alone_is_taken_to_be_within_a_factor_of_two(session, people):
    _run_of(session, people, 4.0)
    pace = estimate_run_speed(session, "batch")
    assert (pace.runs, pace.low, pace.high) == (1, 2e-3, 8e-3)


def test_the_wait_of_a_replay_is_not_taken_for_computing(session, people):
    replay = {"method": "sqrf", "replay_frames_per_s": 10.0}
    _run_of(session, people, 10.5, **replay)
    assert estimate_run_speed(session, "sqrf").s_per_star == pytest.approx(0.5e-3)
    assert _asked(session, people, None, **replay)["predicted_s"] == pytest.approx(3.0 + 0.72 * 0.5 + 0.02, abs=0.01)
    _run_of(session, people, 9.0, **replay)
    assert estimate_run_speed(session, "sqrf").low > 0


def test_replays_are_left_out_where_a_run_computed_as_fast_as_it_could(session, people):
    _run_of(session, people, 2.0, method="sqrf")
    for _ in range(3):
        _run_of(session, people, 10.5, method="sqrf", replay_frames_per_s=10.0)
    pace = estimate_run_speed(session, "sqrf")
    assert (pace.runs, pace.s_per_star) == (1, 2e-3)
