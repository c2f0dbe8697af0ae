"""`/metrics`, and the alert rules and the dashboard that are made of it: each expression names only metrics and labels that exist.

Where Prometheus is installed (`prometheus`, `promtool`), it reads the rules, tests them, scrapes a server and evaluates every
expression. Without it a reader of names stands in, which proves no more than that names, labels and values are those of `/metrics`.
"""

import json
import re
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from prometheus_client import Metric
from prometheus_client.parser import text_string_to_metric_families

from boresight.console.administration import fleet_metrics
from boresight.console.administration.fleet_metrics import GAUGES, FleetMetrics, ServerParts, read_store
from boresight.console.backups.tables import Backup, BackupSchedule
from boresight.console.fleet import service as sensors
from boresight.console.fleet.status import DriftVerdict
from boresight.errors import UnavailableError
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from tests.console.conftest import SENSOR
from tests.served import House

ROOT = Path(__file__).resolve().parents[3]
MONITORING = ROOT / "monitoring"
RULES = [rule for group in yaml.safe_load((MONITORING / "alerts.yml").read_text())["groups"] for rule in group["rules"]]
DASHBOARD = json.loads((MONITORING / "dashboard.json").read_text())
EXPRESSIONS = {rule["alert"]: rule["expr"] for rule in RULES} | {
    f"{panel['title']} {target['refId']}": target["expr"]
    for panel in DASHBOARD["panels"]
    for target in panel["targets"]
}
NAME = re.compile(r"\b((?:boresight|up)\w*)(?:\{([^}]*)\})?")
MATCHER = re.compile(r'(\w+)(=~|=)"([^"]*)"')
OF_PROMETHEUS = {"instance", "job", "le"}
UNITS = ("_seconds", "_total", "_info", "_value")


@pytest.fixture
def families(house: House) -> dict[str, Metric]:
    text = house.anybody().get("/metrics").text
    return {family.name: family for family in text_string_to_metric_families(text)}


def test_the_exposition_is_read_by_prometheus_own_parser_and_each_metric_has_help_and_type(families):
    own = {name: family for name, family in families.items() if name.startswith("boresight_")}
    assert {f"boresight_{name}" for name in GAUGES} <= own.keys()
    assert all(family.documentation and family.type != "unknown" for family in own.values())
    assert all(name == name.lower() and not name.endswith(("_total", "_count", "_bucket")) for name in own)
    assert {name for name in own if "time" in name} == {name for name in own if name.endswith("timestamp_seconds")}


def test_each_series_has_the_declared_labels_and_words_of_the_program_as_values(families):
    for name, gauge in GAUGES.items():
        for sample in families[f"boresight_{name}"].samples:
            assert tuple(sample.labels) == gauge.labels
    states = {sample.labels["state"] for sample in families["boresight_runs"].samples}
    assert len(states) == 7
    assert len(families["boresight_alarms"].samples) == 10 * 3 * 3
    assert families["boresight_store_up"].samples[0].value == 1.0


def test_ten_thousand_sensors_have_no_more_series_than_a_hundred(engine, monkeypatch):
    monkeypatch.setattr(fleet_metrics, "MOST", 3)
    with open_writing(engine) as session:
        for number in range(6):
            sensors.register_sensor(session, COMMAND_LINE, {**SENSOR, "name": f"S-{number}"})
    with open_reading(engine) as session:
        found = read_store(session)
    assert sum(found["sensors"].values()) == 7
    assert all(len(found[name]) <= 3 for name in ("baseline_start_timestamp_seconds", "drift_p_value"))


def test_a_shift_against_a_ground_calibration_has_no_p_and_a_drift_has_its_smallest(engine, monkeypatch):
    tests = {"baseline_holds": {"p": 1e-9}, "slope": {"p": 0.2}}
    verdicts = {1: DriftVerdict("GROUND SHIFT", "", tests), 2: DriftVerdict("DRIFT", "", tests)}
    with open_writing(engine) as session:
        sensors.register_sensor(session, COMMAND_LINE, {**SENSOR, "name": "S-2"})
        monkeypatch.setattr(fleet_metrics, "get_drift_verdicts", lambda *_, most: verdicts if most == 0 else {})
        assert read_store(session)["drift_p_value"] == {("S-2",): 1e-9}


def test_the_newest_good_backup_and_its_restore_test_have_their_times(engine):
    times = {
        "due_utc": "2026-11-01T02:00:00Z",
        "started_utc": "2026-11-01T02:00:00Z",
        "tested_utc": "2026-11-01T03:00:00Z",
    }
    kept = {"at_minute": 120, "every_hours": 24, "keep_daily": 7, "keep_weekly": 4, "keep_monthly": 12}
    with open_writing(engine) as session:
        found = read_store(session)
        assert found["backup_scheduled"] == {(): 0.0}
        assert found["backup_newest_timestamp_seconds"] == found["backup_tested_timestamp_seconds"] == {}
        schedule = BackupSchedule(destination="/backups", created_utc="2026-10-31T00:00:00Z", **kept)
        session.add(schedule)
        session.flush()
        session.add(Backup(schedule_id=schedule.id, state="SUCCEEDED", attempt=1, name="first", **times))
        session.add(Backup(schedule_id=schedule.id, state="FAILED", attempt=1, name="later", **times))
        audit.append(session, COMMAND_LINE, "scheduled", f"backup-schedules/{schedule.id}")
        session.flush()
        found = read_store(session)
    assert found["backup_scheduled"] == {(): 1.0}
    assert found["backup_newest_timestamp_seconds"] == {(): datetime(2026, 11, 1, 2, tzinfo=UTC).timestamp()}
    assert found["backup_tested_timestamp_seconds"] == {(): datetime(2026, 11, 1, 3, tzinfo=UTC).timestamp()}


def test_a_scrape_within_seconds_reads_the_store_once_and_one_of_a_store_that_is_away_says_so(engine, monkeypatch):
    read = []

    def read_once(session):
        read.append(session)
        return {}

    monkeypatch.setattr(fleet_metrics, "read_store", read_once)
    made = FleetMetrics(engine, ServerParts(lambda: None, lambda: ""))
    for _ in range(3):
        assert {family.name: family.samples[0].value for family in made.collect()}["boresight_store_up"] == 1.0
    assert len(read) == 1

    def is_away(_engine):
        raise UnavailableError("The database is away.")

    monkeypatch.setattr(fleet_metrics, "open_reading", is_away)
    told = {family.name: family.samples[0].value for family in made.collect()}
    assert (told["boresight_store_up"], "boresight_runs" in told, told["boresight_workers_connected"]) == (
        0.0,
        False,
        0.0,
    )


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_an_expression_names_metrics_labels_and_values_that_exist(families, name):
    known = {"up": [{"job": "boresight"}]}
    for family in families.values():
        for sample in family.samples:
            known.setdefault(sample.name, []).append(sample.labels)
    known |= {f"boresight_{metric}": [] for metric, gauge in GAUGES.items() if f"boresight_{metric}" not in known}
    found = NAME.findall(EXPRESSIONS[name])
    assert found
    for metric, matchers in found:
        assert metric in known, metric
        for label, sign, value in MATCHER.findall(matchers):
            values = {labels.get(label) for labels in known[metric]}
            matched = {
                one
                for one in values
                if one is not None and (re.fullmatch(value, one) if sign == "=~" else one == value)
            }
            assert matched or (label, value) == ("status", "5.."), (metric, label, value)
    labels = set(re.findall(r"\bby \(([^)]*)\)|\bon \(([^)]*)\)", EXPRESSIONS[name]))
    for label in {
        part.strip() for pair in labels for text in pair for part in text.split(",") if part.strip()
    } - OF_PROMETHEUS:
        assert any(label in one for metric, _ in found for one in known[metric]), label


def test_each_alert_has_a_sentence_a_severity_and_a_page_that_exists():
    assert len({rule["alert"] for rule in RULES}) == len(RULES) == 16
    for rule in RULES:
        assert rule["labels"]["severity"] in {"critical", "warning", "info"}
        assert rule["annotations"]["summary"].endswith(".")
        assert (ROOT / rule["annotations"]["runbook"]).exists()
    told = set(
        re.findall(r"^\| `(Boresight\w+)`", (ROOT / "docs/how-to/prometheus-and-grafana.md").read_text(), re.MULTILINE)
    )
    assert told == {rule["alert"] for rule in RULES}


def test_the_panels_of_the_dashboard_cover_its_width_without_overlap():
    cells = [
        (x, y)
        for panel in DASHBOARD["panels"]
        for x in range(panel["gridPos"]["x"], panel["gridPos"]["x"] + panel["gridPos"]["w"])
        for y in range(panel["gridPos"]["y"], panel["gridPos"]["y"] + panel["gridPos"]["h"])
    ]
    assert len(cells) == len(set(cells)) == 24 * 40
    assert len({panel["id"] for panel in DASHBOARD["panels"]}) == len(DASHBOARD["panels"])


needs_prometheus = pytest.mark.skipif(
    shutil.which("promtool") is None or shutil.which("prometheus") is None, reason="Prometheus is not installed here"
)


@needs_prometheus
@pytest.mark.parametrize(
    "words", [("check", "config", "prometheus.yml"), ("test", "rules", "alerts.test.yml")], ids="-".join
)
def test_prometheus_own_tool_accepts_the_configuration_and_the_rules_fire_when_they_should(words):
    done = subprocess.run(["promtool", *words], cwd=MONITORING, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture
def prometheus(house: House, tmp_path: Path) -> Iterator[httpx.Client]:
    configured: dict[str, Any] = yaml.safe_load((MONITORING / "prometheus.yml").read_text())
    configured["global"] = {"scrape_interval": "1s", "evaluation_interval": "1s"}
    configured["scrape_configs"][0]["static_configs"] = [{"targets": [house.address.removeprefix("http://")]}]
    (tmp_path / "prometheus.yml").write_text(yaml.safe_dump(configured))
    shutil.copy(MONITORING / "alerts.yml", tmp_path)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = ["prometheus", f"--web.listen-address=127.0.0.1:{port}", f"--storage.tsdb.path={tmp_path}/data"]
    process = subprocess.Popen([*words, f"--config.file={tmp_path}/prometheus.yml"], stderr=subprocess.DEVNULL)
    with httpx.Client(base_url=f"http://127.0.0.1:{port}/api/v1", timeout=10) as client:
        yield client
    process.terminate()
    process.wait(20)


@needs_prometheus
def test_a_real_prometheus_scrapes_a_server_and_evaluates_every_expression(prometheus):
    def ask(expression: str) -> Any:
        return prometheus.get("/query", params={"query": expression}).json()

    begun_s = time.monotonic()
    while True:
        try:
            if ask("boresight_store_up").get("data", {}).get("result"):
                break
        except (httpx.HTTPError, ValueError):  # until it is ready it answers with a sentence
            pass
        assert time.monotonic() - begun_s < 60, "it never scraped"
        time.sleep(0.5)
    for name, expression in EXPRESSIONS.items():
        answer = ask(expression.replace("$__rate_interval", "2m"))
        assert answer["status"] == "success", (name, answer)
    assert ask("sum(boresight_sensors)")["data"]["result"][0]["value"][1].isdigit()
    rules = prometheus.get("/rules").json()["data"]["groups"][0]["rules"]
    assert {rule["health"] for rule in rules} <= {"ok", "unknown"}
    assert len(rules) == len(RULES)


def test_age_and_last_restore_test_of_backups_have_a_panel_and_an_alert_each():
    shown = {name for panel in DASHBOARD["panels"] for one in panel["targets"] for name, _ in NAME.findall(one["expr"])}
    alerted = {name for rule in RULES for name, _ in NAME.findall(rule["expr"])}
    kept = {f"boresight_{name}" for name in GAUGES if name.startswith("backup_")}
    assert len(kept) == 3
    assert kept <= shown & alerted
