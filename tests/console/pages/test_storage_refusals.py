"""A disk that takes no write is 503 with Retry-After by every form of every page, and no fault of what was typed."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace

import pytest
from fastapi.routing import APIRoute

from boresight.console import pages
from boresight.console.access.openid_connect import ProviderLogOut
from boresight.console.alignments.tables import Alignment, AlignmentRequest
from boresight.console.approvals.pages import gates as gate_report
from boresight.console.fleet.pages import new_sensor, plan
from boresight.console.ingest import policies
from boresight.console.ingest import service as ingest
from boresight.console.jobs.message_sender import MessageSender
from boresight.console.pages import rendering as attempts
from boresight.console.telemetry import pages as telemetry
from boresight.console.webhooks import service as webhooks
from boresight.disks import full
from boresight.errors import StorageError
from boresight.platform.actors import INGEST
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_writing
from boresight.platform.jobs.message_transport import CheckedAddress
from tests.console.alarms.test_pages import drifting  # noqa: F401 - a fixture
from tests.console.campaigns.test_routes import FORM as CAMPAIGN
from tests.console.change_proposals.test_routes import _proposed, asking_site  # noqa: F401 - a fixture
from tests.sites import PASSWORD

SIGNED = {"decision": "APPROVE", "meaning": "m", "comment": "Seen.", "version": "1", "password": PASSWORD}
FRESH = dict.fromkeys(("password", "repeated"), "kestrel over the moor 41")
PROFILE = '{"name": "st", "frames": {"column": "F"}, "row": {"column": "Y"}, "col": {"column": "X"}}'
FORMS = {  # who sends which form to which page
    "/users": ("adele", {"name": "zoe", "printed_name": "Zoe", "password": "kestrel over the moor 41"}),
    "/users/{user_id}/roles": ("adele", {"roles": ["viewer"]}),
    "/users/{user_id}/disable": ("adele", {}),
    "/users/{user_id}/enable": ("adele", {}),
    "/users/{user_id}/password": ("adele", {"password": "kestrel over the moor 41"}),
    "/users/{user_id}/end-sessions": ("adele", {}),
    "/users/{user_id}/reset-second-factor": ("adele", {}),
    "/sessions/{session_id:int}/end": ("ada", {}),
    "/sessions/end-others": ("ada", {}),
    "/preferences": ("ada", {"form": "iso"}),
    "/preferences/messages": ("ada", {"address": "ada@mission.example"}),
    "/preferences/messages/{address_id:int}": ("ada", {"kinds": ["alarm"]}),
    "/preferences/messages/{address_id:int}/try": ("ada", {}),
    "/preferences/messages/{address_id:int}/remove": ("ada", {}),
    "/users/keys": ("ada", {"label": "k", "scopes": ["read"]}),
    "/users/keys/{key_id}/revoke": ("ada", {}),
    "/change-proposals/{proposal_id:int}/decide": ("agnes", {"action": "confirm", "version": "1"}),
    "/telemetry": ("ada", {"sensor_id": "1", "purpose": "calibration"}),
    "/parameter-sets/{set_id:int}/uplink/package": ("olga", {}),
    "/parameter-sets/{set_id:int}/uplink/hand-over": ("olga", {"system": "yamcs", "version": "1"}),
    "/parameter-sets/{set_id:int}/uplink/record": ("olga", {"onboard_state": "LOADED", "source": "pass 9"}),
    "/parameter-sets/{set_id:int}/uplink/read-back": ("olga", {"crc": "0", "source": "pass 9"}),
    "/parameter-sets/{set_id:int}/uplink/activate": ("olga", {"source": "pass 9", "password": PASSWORD}),
    "/login": ("ada", {"name": "ada", "password": PASSWORD}),
    "/login/second-factor": ("ada", {"factor": "123456"}),
    "/login/single-sign-on/back-channel-log-out": ("ada", {"logout_token": "signed"}),
    "/logout": ("ada", {}),
    "/sensors/{sensor_id:int}/gates": ("adele", {"action": "set", "reason": "x"}),
    "/alarms/{alarm_id:int}/{step}": ("ada", {"text": "Seen.", "version": "1"}),
    "/sensors/{sensor_id:int}/table-definition": ("adele", {"action": "set", "document": "{}", "reason": "x"}),
    "/audit/anchors": ("adele", {}),
    "/password": ("ada", {"current": PASSWORD, **FRESH}),
    "/second-factor/begin": ("ada", {"kind": "totp", "password": PASSWORD}),
    "/second-factor/enrol": ("ada", {"challenge": "1", "factor": "123456"}),
    "/second-factor/recovery-codes": ("ada", {"password": PASSWORD}),
    "/second-factor/{factor_id:int}/remove": ("ada", {"password": PASSWORD}),
    "/runs/new": ("ada", {"intent": "queue", "sensor_id": "1", "telemetry_set_id": "1", "method": "batch"}),
    "/presets/{preset_id:int}/archive": ("ada", {}),
    "/import-profiles": ("ada", {"document": PROFILE}),
    "/import-profiles/{profile_id:int}/archive": ("ada", {}),
    "/telemetry/{set_id}/archive": ("ada", {}),
    "/telemetry/{set_id}/diagnose": ("ada", {}),
    "/telemetry/{set_id}/accept-as-new-sensor": ("ada", {"name": "another"}),
    "/telemetry/{set_id}/accept-sensor": ("ada", {"version": "1"}),
    "/telemetry/{set_id}/accept-mapping": ("ada", {}),
    "/sensors": ("ada", {"document": "{}"}),
    "/sensors/propose": ("ada", {}),
    "/sensors/{sensor_id:int}/plan": ("victor", {"start_utc": "2026-10-01T00:00:00Z"}),
    "/sensors/{sensor_id:int}/ingest": ("ada", {"reason": "x"}),
    "/sensors/{sensor_id:int}/ingest/{step}": ("ada", {"reason": "x", "version": "1", "policy_id": "1"}),
    "/ingest/{decision_id:int}/answer": ("ada", {"answer": "WAIT", "reason": "x", "version": "1"}),
    "/alignments/new": ("ada", {"run_a_id": "1", "run_b_id": "2"}),
    "/alignments/{alignment_id:int}/submit": ("ada", {"reason": "x"}),
    "/alignment-requests/{request_id:int}/sign": ("alan", SIGNED),
    "/alignment-requests/{request_id:int}/withdraw": ("ada", {"reason": "x", "version": "1"}),
    "/campaigns/{campaign_id:int}/cancel": ("ada", {"reason": "x"}),
    "/campaigns/{campaign_id:int}/launch-failed": ("ada", {}),
    "/approvals/{approval_id:int}/threads": ("alan", {"kind": "gate", "name": "coverage", "text": "Why?"}),
    "/approvals/{approval_id:int}/threads/{thread_id:int}/{action}": ("alan", {"version": "1"}),
    "/approvals/{approval_id:int}/remarks": ("alan", {"text": "Why?"}),
    "/approvals/{approval_id:int}/assign": ("ada", {"person": "", "version": "1"}),
    "/parameter-sets/{set_id:int}/assess": ("ada", {}),
    "/parameter-sets/{set_id:int}/waive": ("alan", {"gate": "x", "password": PASSWORD}),
    "/notes/{kind}/{subject_id:int}": ("ada", {"text": "A note."}),
    "/sensors/{sensor_id:int}/annotations": ("ada", {"at": "2026-11-21", "text": "Safe mode."}),
    "/runs/batch": ("ada", {"runs": "1", "act": "archive"}),
    "/saved-views": ("ada", {"name": "All runs", "path": "/runs"}),
    "/saved-views/{view_id:int}/remove": ("ada", {}),
    "/favourites": ("ada", {"name": "ST16-1", "path": "/sensors/1"}),
    "/runs/{run_id:int}/parameter-set": ("ada", {}),
    "/runs/{run_id:int}/cancel": ("ada", {}),
    "/runs/{run_id:int}/choice": ("ada", {}),
    "/webhooks": ("adele", {"label": "h", "url": "https://203.0.113.7/hook"}),
    "/webhooks/{webhook_id:int}/try": ("adele", {}),
    "/webhooks/{webhook_id:int}/renew-secret": ("adele", {}),
    "/webhooks/{webhook_id:int}/disable": ("adele", {}),
    "/webhooks/{webhook_id:int}/enable": ("adele", {}),
    "/webhooks/{webhook_id:int}/deliveries/{delivery_id:int}/redeliver": ("adele", {}),
    "/parameter-sets/{set_id:int}/submit": ("ada", {"reason": "x", "version": "1"}),
    "/parameter-sets/{set_id:int}/roll-back": ("ada", {"reason": "x", "version": "1"}),
    "/parameter-sets/{set_id:int}/withdraw": ("ada", {"version": "1"}),
    "/parameter-sets/{set_id:int}/promote": ("olga", {"version": "1", "reason": "x", "password": PASSWORD}),
    "/approvals/{approval_id:int}/sign": ("alan", SIGNED),
    "/approvals/{approval_id:int}/sign-over-the-shoulder": (
        "ada",
        {**SIGNED, "name": "alan", "their_password": PASSWORD},
    ),
    "/campaigns/new": ("ada", {**CAMPAIGN, "intent": "queue"}),
    "/sensors/{sensor_id}": ("ada", {"document": "{}", "version": "1"}),
}


NEEDED = {  # fixtures
    "/alarms/{alarm_id:int}/{step}": "drifting",
    "/ingest/{decision_id:int}/answer": "decided",
    "/login/single-sign-on/back-channel-log-out": "provided",
    "/alignments/{alignment_id:int}/submit": "asked",
    "/alignment-requests/{request_id:int}/sign": "asked",
    "/alignment-requests/{request_id:int}/withdraw": "asked",
}


STORES_NOTHING = {"/sensors/propose": (new_sensor, "_solve"), "/sensors/{sensor_id:int}/plan": (plan, "_compute")}


@pytest.fixture
def provided(site):
    async def read_log_out(_: str) -> ProviderLogOut:
        return ProviderLogOut("https://provider.example", "sam", 0.0)

    site.app.state.identity_provider = SimpleNamespace(read_log_out=read_log_out)


@pytest.fixture
def decided(site):
    with open_writing(site.engine) as session:
        policy = policies.draft(session, site.actor("ada"), 1, {}, "x")
        sent = ingest.SentFile("FOLDER", "pass.csv", None, 1)
        ingest.refuse(session, INGEST, policy.id, sent, "No telemetry.")


@pytest.fixture
def asked(site):
    made = {
        "sensor_a_id": 1,
        "sensor_b_id": 1,
        "run_a_id": 1,
        "run_b_id": 1,
        "options": {},
        "created_utc": "2026-11-01",
    }
    with open_writing(site.engine) as session:
        row = session.put(Alignment(**made, created_by=None, state="QUEUED"))
        audit.append(session, INGEST, "requested", f"alignments/{row.id}")
        request = {"result_sha256": "0", "reason": "x", "submitted_utc": "2026-11-01", "submitted_by": 1}
        session.put(AlignmentRequest(alignment_id=row.id, state="OPEN", **request))
        audit.append(session, INGEST, "submitted", "alignment-requests/1")


def _forms() -> set[str]:
    routes = [route for module in pages.modules() for router in pages.routers(module) for route in router.routes]
    return {route.path for route in routes if isinstance(route, APIRoute) and "POST" in route.methods}


def test_every_form_of_a_page_is_tried():
    assert set(FORMS) == _forms()


@pytest.mark.parametrize("route", FORMS)
def test_a_full_disk_is_503_with_retry_after_by_every_form(request, site, monkeypatch, route):
    name, form = FORMS[route]
    if fixture := NEEDED.get(route):
        request.getfixturevalue(fixture)
    if route.startswith("/change-proposals"):
        request.getfixturevalue("asking_site")
        _proposed(site)
    if "{approval_id" in route:
        ada = site.visitor("ada")
        place = ada.post("/runs/1/parameter-set").headers["location"]
        version = ada.get(place).split('name="version" value="')[1].split('"')[0]
        assert ada.post(f"{place}/submit", version=version, reason="x").status_code == 303
    prepared = ("diagnose", "accept-mapping", "accept-as-new-sensor")
    if route in {"/telemetry", *(f"/telemetry/{{set_id}}/{step}" for step in prepared)}:

        @asynccontextmanager
        async def nothing_to_prepare(_made: object) -> AsyncIterator[None]:
            yield None

        monkeypatch.setattr(telemetry, "contextmanager_in_threadpool", nothing_to_prepare)
        monkeypatch.setattr(telemetry, "_store", lambda *_: None)
    monkeypatch.setattr(gate_report, "_examine", lambda *_: "examined")
    monkeypatch.setattr(webhooks, "judge_address", lambda *_: None)
    monkeypatch.setattr(MessageSender, "judge_address", lambda *_: ("x", CheckedAddress("mailto", "a…@x")))

    @asynccontextmanager
    async def on_a_full_disk(_request: object) -> AsyncIterator[None]:
        raise StorageError(full("the database"))
        yield

    if of := STORES_NOTHING.get(route):  # what it reads or keeps meanwhile is all that may fail

        def on_a_full_folder(*_: object) -> None:
            raise StorageError(full("the folder"))

        monkeypatch.setattr(*of, on_a_full_folder)
    visitor = site.visitor(name)
    monkeypatch.setattr(attempts, "_transaction", on_a_full_disk)
    step = "pause" if "/ingest/" in route else "acknowledge"
    path = route.replace("{step}", step).replace("{kind}", "runs").replace("{action}", "resolved")
    path = "/".join("1" if part.startswith("{") else part for part in path.split("/"))
    given = {"headers": {"Accept": "text/html"}}
    data = {"csrf_token": visitor.csrf_token, **form}
    if route in {"/telemetry", "/sensors/propose"}:
        given["files"] = {"file": ("pass.csv", b"frame\n1\n")}
    answer = visitor.send("POST", path, data=data, **given)
    assert (answer.status_code, answer.headers.get("retry-after")) == (503, "30"), answer.text[-1500:]
    assert "is full" in answer.text or "/uplink/" in route  # a step that the set has not reached shows no form
