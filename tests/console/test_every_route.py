"""Generated from the route table: every operation succeeds as documented, and every guard holds on every operation."""

import re
from typing import Any

import pytest
import sqlalchemy as sa

from boresight.console.routes import NOUNS, routers
from boresight.platform.actors import SYSTEM
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.declared import Base
from boresight.platform.db.sessions import open_reading
from boresight.platform.web.openapi import ProblemDocument
from tests.console.alarms import alarms
from tests.console.operations import GOOD, OPEN, OPERATIONS, TRANSITIONS, UNSAFE, WITH_ID, ask, documented_shape
from tests.served import PASSWORD, House


def test_the_openapi_document_lists_every_route():
    routes = {
        (method, route.path)
        for noun in NOUNS
        for router in routers(noun)
        for route in router.routes
        for method in route.methods
        if method != "HEAD"
    }
    listed = {(operation["method"], operation["path"]) for operation in OPERATIONS.values()}
    assert routes <= listed
    assert len(OPERATIONS) == len(set(OPERATIONS))
    assert all(re.fullmatch(r"[a-z_]+", name) for name in OPERATIONS)
    assert {path for _, path in listed - routes} == {"/healthz", "/readyz", "/metrics"}


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_succeeds_as_documented_after_trying_and_refusals_that_change_nothing(name, house):
    assert name in GOOD, f"Give {name} a request that succeeds, in GOOD"
    who, options = GOOD[name](house)
    client = house.log_in(who) if name in {"log_in", "log_out"} else house.person(who)
    if name in TRANSITIONS:
        _is_refused_without_a_version_with_428_and_from_an_older_one_with_412(client, name, options)
    if name in UNSAFE and name != "log_out":
        _validate_only_answers_200_and_changes_nothing(house, client, name, options)
    answer = ask(client, name, options)
    documented = [int(status) for status in OPERATIONS[name]["responses"] if status.startswith("2")]
    assert answer.status_code in documented, answer.read()
    content = OPERATIONS[name]["responses"][str(answer.status_code)].get("content", {})
    media_type = answer.headers.get("content-type", "").partition(";")[0]
    assert media_type in {one.partition(";")[0] for one in content} or (answer.status_code, content) == (204, {})
    if (shape := documented_shape(name, answer.status_code)) is not None:
        written = shape.model_validate(answer.json()).model_dump(mode="json", by_alias=True, exclude_unset=True)
        assert written == answer.json()


def _is_refused_without_a_version_with_428_and_from_an_older_one_with_412(client, name, options):
    for headers, status, says in (({}, 428, "If-Match"), ({"If-Match": '"v77"'}, 412, "changed since")):
        answer = ask(client, name, options | {"headers": headers})
        assert (answer.status_code, says in answer.json()["detail"]) == (status, True), answer.text
    named = {parameter["name"]: parameter for parameter in OPERATIONS[name]["parameters"]}
    assert (named["If-Match"]["in"], named["If-Match"]["required"]) == ("header", True)


def _validate_only_answers_200_and_changes_nothing(house, client, name, options):
    before = _written(house)
    headers = {"Idempotency-Key": "try", **options.get("headers", {})}
    answer = ask(client, name, {**options, "params": {"validate_only": "true"}, "headers": headers})
    assert answer.status_code == 200, answer.text
    assert name == "edit_sensor" or answer.headers["x-validate-only"] == "true"
    assert _written(house) == before


def _written(house: House) -> dict[str, int]:
    """Count the rows of each table, without what the server's own services write meanwhile."""
    with open_reading(house.app.state.engine) as session:
        counts = {
            table.name: sa.select(sa.func.count()).select_from(table)
            for table in Base.metadata.sorted_tables
            if table.name not in {"webhook_deliveries", "messages"}
        }
        counts["audit"] = counts["audit"].where(AuditRecord.credential != SYSTEM.credential)
        return {name: session.scalar(count) or 0 for name, count in counts.items()}


@pytest.mark.parametrize("name", [name for name in OPERATIONS if name not in OPEN])
def test_nobody_unknown_is_served(name, house):
    answer = ask(house.anybody(), name, {})
    assert answer.status_code == 401, answer.read()
    assert answer.headers["www-authenticate"] == "Bearer"
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("name", UNSAFE)
def test_a_cookie_without_its_csrf_token_changes_nothing(name, house):
    client = house.anybody()
    client.cookies = house.person("adele").cookies
    answer = ask(client, name, {"json": {}})
    assert answer.status_code == 403
    assert "X-CSRF-Token" in answer.json()["detail"]


ABLE = {
    "approve": "alan",
    "refuse": "alan",
    "promote_parameter_set": "olga",
    "hand_over_parameter_set": "olga",
    "read_back": "olga",
    "activate_parameter_set": "olga",
    "set_gate_profile": "adele",
    "enable_ingest_policy": "adele",
    **{name: "victor" for name in WITH_ID if "message_address" in name},
    **{name: "adele" for name in WITH_ID if "webhook" in name or name == "redeliver"},
}  # who may do it, where not the analyst
BODIES: dict[str, dict[str, Any]] = {
    **alarms.BODIES,
    "convert_parameter_set": {"params": {"to": "pinhole_radial"}},
    "get_parameter_set_camera_file": {"params": {"to": "opencv"}},
    "get_run_camera_file": {"params": {"to": "opencv"}},
    **{f"{step}_ingest_policy": {"json": {"reason": "x"}} for step in ("pause", "resume", "switch_off")},
    "answer_ingest_decision": {"json": {"answer": "WAIT", "reason": "x"}},
    "change_message_address": {"json": {}},
    "edit_sensor": {"json": {"name": "x"}},
    "plan_pointings": {"json": {"start_utc": "2026-10-01T00:00:00Z", "minutes": 2.0}},
    "record_opening": {"json": {"evidence": "radial"}},
    "attach": {"files": {"file": ("a.txt", b"x")}},
    "get_attachment": {"attachment_id": 1},
    "annotate": {"json": {"at_utc": "2026-01-01", "text": "x"}},
    "submit_parameter_set": {"json": {"reason": "x"}},
    "submit_alignment": {"json": {"reason": "x"}},
    "withdraw_alignment": {"json": {"reason": "x"}},
    **{
        f"{act}_alignment": {"json": {"meaning": "x", "password": PASSWORD, "comment": "x"}}
        for act in ("approve", "refuse")
    },
    "approve": {"json": {"meaning": "x", "password": PASSWORD}},
    "refuse": {"json": {"meaning": "x", "password": PASSWORD, "comment": "x"}},
    "set_gate_profile": {"json": {"gates": [], "reason": "x"}},
    "set_table_definition": {"json": {"document": {}, "reason": "x"}},
    "try_gate_profile": {"json": {"gates": []}},
    "waive_gate": {
        "json": {"gate": "coverage", "code": "other", "reason": "x", "expires_utc": "2026-01-01", "password": PASSWORD}
    },
    "roll_back_parameter_set": {"json": {"reason": "x"}},
    "sign_over_the_shoulder": {
        "json": {"meaning": "x", "password": PASSWORD, "comment": "x", "name": "alan", "decision": "APPROVE"}
    },
    "assign_approval": {"json": {"user_id": None}},
    "remark": {"json": {"text": "x"}},
    "refuse_change": {"json": {"comment": "x"}},
    "open_thread": {"json": {"kind": "gate", "name": "coverage", "text": "x"}},
    "answer_thread": {"json": {"text": "x"}},
    "change_roles": {"json": {"roles": []}},
    "change_password": {"json": {"password": "another good one"}},
    "hand_over_parameter_set": {"json": {"system": "yamcs"}},
    "read_back": {"data": {"source": "x", "crc": "1"}},
    "remove_second_factor": {"json": {"password": PASSWORD}},
    "activate_parameter_set": {"json": {"source": "x", "meaning": "x", "password": PASSWORD}},
    "get_sensor_at": {"params": {"at": "2026-01-01"}},
    "get_figure": {"name": "radial"},
    "get_figure_data": {"name": "radial"},
}


@pytest.mark.parametrize("name", WITH_ID)
def test_what_does_not_exist_is_not_found_and_a_number_that_no_row_can_have_is_refused(name, house):
    number = next(word for word in re.findall(r"{(\w+)}", OPERATIONS[name]["path"]) if word.endswith("_id"))
    options = {**BODIES.get(name, {}), number: 987654, "headers": {"If-Match": '"v1"'}}
    answer = ask(house.person(ABLE.get(name, "adele" if "user_id" in number else "ada")), name, options)
    problem = ProblemDocument.model_validate(answer.json())
    assert (answer.status_code, problem.status) == (404, 404), answer.text
    assert "987654" in problem.detail
    answer = ask(house.person("ada"), name, {**options, number: 10**25})
    assert answer.status_code == 422, answer.text


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_is_documented_with_its_refusals(name):
    operation = OPERATIONS[name]
    assert operation["summary"]
    assert operation["description"]
    assert operation["tags"]
    if name in OPEN:
        return
    assert {"401", "403", "422"} <= set(operation["responses"])
    for status, answer in operation["responses"].items():
        if status.startswith(("4", "5")):
            assert list(answer["content"]) == ["application/problem+json"]
