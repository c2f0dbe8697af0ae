"""Policies and decisions as the tests of every route and of the pages make them."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

from boresight.console.ingest.tables import ANSWERS, IngestDecision
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.runs.tables import Run
from boresight.platform.actors import INGEST
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_writing
from tests.served import House

Made = tuple[str, dict[str, Any]]
SCENARIO_DAY = b"2026-10-01"


def days_from_now(days: float) -> bytes:
    return (datetime.now(UTC) + timedelta(days=days)).date().isoformat().encode()


def recent_csv(house: House, days: float = -10) -> bytes:
    """Telemetry whose times are so many days from now."""
    assert SCENARIO_DAY in house.telemetry_csv
    return house.telemetry_csv.replace(SCENARIO_DAY, days_from_now(days))


def versioned(row: dict[str, Any]) -> dict[str, str]:
    return {"If-Match": f'"v{row["version"]}"'}


def draft(house: House, sensor_id: int, **rules: Any) -> dict[str, Any]:
    body = {"sensor_id": sensor_id, "rules": rules, "reason": "Two passes a day."}
    answer = house.person("ada").post("/api/v1/ingest-policies", json=body)
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def step(house: House, row: dict[str, Any], name: str, who: str = "ada", **body: Any) -> dict[str, Any]:
    kept: dict[str, Any] = {"json": body} if body else {}
    answer = house.person(who).post(f"/api/v1/ingest-policies/{row['id']}:{name}", headers=versioned(row), **kept)
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def in_force(house: House, sensor_id: int | None = None, **rules: Any) -> dict[str, Any]:
    row = draft(house, sensor_id or house.new_sensor()["id"], **rules)
    return step(house, step(house, row, "rehearse"), "enable", "adele")


def send(house: House, sensor_id: int, content: bytes | None = None, client: Any = None, **options: Any) -> Any:
    files = {"file": ("pass.csv", recent_csv(house) if content is None else content)}
    who = client or house.person("ada")
    return who.post("/api/v1/ingest", data={"sensor_id": str(sensor_id)}, files=files, **options)


def received(house: House) -> dict[str, Any]:
    answer = send(house, in_force(house)["sensor_id"])
    assert answer.status_code == 202, answer.text
    return dict(answer.json())


def asked(house: House) -> dict[str, Any]:
    """Bring a decision to where a person is asked, as the watcher does once its run has ended."""
    row = received(house)
    with open_writing(house.app.state.engine) as session:
        decision = session.get_one(IngestDecision, row["id"])
        house._end(session, session.get_one(Run, row["run_id"]), "SUCCEEDED")
        baseline = set_rows.find_baseline(session, row["sensor_id"])
        prepared = parameter_sets.create_from_run(session, INGEST, house.app.state.blobs, row["run_id"])
        decision.parameter_set_id, decision.state = prepared.id, "ASKED"
        decision.evidence = {"reference_id": baseline.id if baseline else None, "alternatives": [], "reasons": []}
        audit.append(session, INGEST, "decided", f"ingest-decisions/{decision.id}")
    return dict(house.person("ada").get(f"/api/v1/ingest-decisions/{row['id']}").json())


def with_alternatives(house: House) -> dict[str, Any]:
    """Bring a decision to where a person is asked for one of every answer."""
    row = asked(house)
    with open_writing(house.app.state.engine) as session:
        decision = session.get_one(IngestDecision, row["id"])
        offered = [{"answer": one, "sentence": f"{one} is an answer.", "recommended": False} for one in ANSWERS]
        decision.evidence = {**decision.evidence, "alternatives": offered}
        audit.append(session, INGEST, "decided", f"ingest-decisions/{decision.id}")
    return row


def _of_policy(state: str, name: str, **body: Any) -> Callable[[House], Made]:
    def make(house: House) -> Made:
        row = in_force(house) if state != "DRAFT" else draft(house, house.new_sensor()["id"])
        if state == "PAUSED":
            row = step(house, row, "pause", reason="x")
        if name == "enable":
            row = step(house, row, "rehearse")
        kept: dict[str, Any] = {"json": body} if body else {}
        return "adele" if name == "enable" else "ada", {"policy_id": row["id"], "headers": versioned(row), **kept}

    return make


def _answer(house: House) -> Made:
    row = asked(house)
    body = {"answer": "WAIT", "reason": "The pass was short.", "days": 3}
    return "ada", {"decision_id": row["id"], "json": body, "headers": versioned(row)}


def _send(house: House) -> Made:
    files = {"file": ("pass.csv", recent_csv(house))}
    return "ada", {"data": {"sensor_id": str(in_force(house)["sensor_id"])}, "files": files}


def _draft(house: House) -> Made:
    return "ada", {"json": {"sensor_id": house.new_sensor()["id"], "rules": {"confirmations": 2}, "reason": "x"}}


REASON = {"reason": "The downlink is tested."}
GOOD: dict[str, Callable[[House], Made]] = {
    "ingest": _send,
    "list_ingest_decisions": lambda _: ("victor", {}),
    "get_ingest_decision": lambda house: ("victor", {"decision_id": received(house)["id"]}),
    "answer_ingest_decision": _answer,
    "list_ingest_policies": lambda _: ("victor", {}),
    "draft_ingest_policy": _draft,
    "get_ingest_policy": lambda house: ("victor", {"policy_id": draft(house, house.new_sensor()["id"])["id"]}),
    "rehearse_ingest_policy": _of_policy("DRAFT", "rehearse"),
    "enable_ingest_policy": _of_policy("DRAFT", "enable"),
    "pause_ingest_policy": _of_policy("ACTIVE", "pause", **REASON),
    "resume_ingest_policy": _of_policy("PAUSED", "resume", **REASON),
    "switch_off_ingest_policy": _of_policy("ACTIVE", "switch-off", **REASON),
}
