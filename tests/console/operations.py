"""Every operation of the OpenAPI document, and for each a request that succeeds.

An operation that is not in GOOD fails by name, so a new route cannot come without its test.
"""

import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import sqlalchemy as sa
from pydantic import BaseModel

from boresight.console.access.tables import SecondFactor, User
from boresight.console.approvals import queries as approval_queries
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_writing, utc_after
from boresight.platform.web.paging import Page
from boresight.server import create_app
from tests.console.access.authenticators import App, enrol_app
from tests.console.alarms import alarms
from tests.console.alignments import pairs
from tests.console.approvals import gates
from tests.console.campaigns import campaigns
from tests.console.change_proposals import proposals
from tests.console.ingest import decisions
from tests.console.uplinks import routes as onboard
from tests.served import PASSWORD, House, settings_in

with tempfile.TemporaryDirectory() as _folder:
    OPENAPI = create_app(settings_in(Path(_folder))).openapi()
OPERATIONS = {
    operation["operationId"]: {"method": method.upper(), "path": path, **operation}
    for path, methods in OPENAPI["paths"].items()
    for method, operation in methods.items()
}
OPEN = ("health", "readiness", "metrics", "log_in")  # ask nobody who acts
TRANSITIONS = [name for name, operation in OPERATIONS.items() if "428" in operation["responses"]]
UNSAFE = [name for name, operation in OPERATIONS.items() if operation["method"] != "GET" and name != "log_in"]
WITH_ID = [name for name, operation in OPERATIONS.items() if "_id}" in operation["path"]]

HOOK = {"label": "Chat", "url": "https://mission.invalid/hooks"}  # a name that leads nowhere

PROFILE = {"name": "st", "frames": {"column": "F"}, "row": {"column": "Y"}, "col": {"column": "X"}}

Made = tuple[str, dict[str, Any]]  # who asks, and path values with request options


def _versioned(row: dict[str, Any]) -> dict[str, str]:
    return {"If-Match": f'"v{row["version"]}"'}


def _upload(house: House) -> Made:
    files = {"file": ("t.csv", house.telemetry_csv)}
    return "ada", {"data": {"sensor_id": str(house.new_sensor()["id"])}, "files": files}


def _saved_profile(house: House) -> dict[str, Any]:
    return house.person("ada").post("/api/v1/import-profiles", json=_new_profile(house)).json()


def _new_profile(house: House) -> dict[str, Any]:
    known = house.person("ada").get("/api/v1/import-profiles", params={"archived": "true"}).json()["items"]
    return {**PROFILE, "name": f"st-{len(known)}"}


def _address(house: House, **options: Any) -> Made:
    body = {"address": "victor@mission.invalid", "kinds": ["alarm"]}
    return "victor", {
        "address_id": house.person("victor").post("/api/v1/message-addresses", json=body).json()["id"],
        **options,
    }


def _attachment(house: House) -> Made:
    noted = house.person("ada").post(f"/api/v1/sensors/{house.new_sensor()['id']}/notes", json={"text": "See there."})
    return "ada", {"note_id": noted.json()["id"], "files": {"file": ("pass.log", b"12:00 safe mode")}}


def _attached(house: House) -> Made:
    who, options = _attachment(house)
    place = f"/api/v1/notes/{options['note_id']}/attachments"
    made = house.person(who).post(place, files=options["files"]).json()
    return "victor", {"note_id": made["note_id"], "attachment_id": made["id"]}


def _annotation(house: House) -> Made:
    body = {"at_utc": "2026-11-21T03:04:05Z", "text": "Safe mode."}
    return "ada", {"sensor_id": house.new_sensor()["id"], "json": body}


def _annotated(house: House) -> Made:
    who, options = _annotation(house)
    house.person(who).post(f"/api/v1/sensors/{options['sensor_id']}/annotations", json=options["json"])
    return "victor", {"sensor_id": options["sensor_id"]}


def _view(house: House) -> Made:
    known = house.person("victor").get("/api/v1/saved-views").json()["items"]
    return "victor", {"json": {"name": "Runs", "path": f"/runs?sensor={len(known) + 1}"}}


def _saved_view(house: House) -> Made:
    who, options = _view(house)
    return who, {"view_id": house.person(who).post("/api/v1/saved-views", **options).json()["id"]}


def _archive_profile(house: House) -> Made:
    number = _saved_profile(house)["id"]
    read = house.person("ada").get(f"/api/v1/import-profiles/{number}")
    return "ada", {"profile_id": number, "headers": {"If-Match": read.headers["etag"]}}


def _imported(house: House) -> Made:
    form = {"sensor_id": str(house.new_sensor()["id"]), "profile": "contract"}
    files = {"file": ("t.csv", house.telemetry_csv)}
    made = house.person("ada").post("/api/v1/telemetry-sets", data=form, files=files)
    return "victor", {"telemetry_set_id": made.json()["id"]}


def _launch(house: House) -> Made:
    sensor_id, set_id = house.ready_sensor()
    return "ada", {"json": {"sensor_id": sensor_id, "telemetry_set_id": set_id}}


def _edit(house: House) -> Made:
    row = house.new_sensor()
    return "ada", {"sensor_id": row["id"], "json": row["document"], "headers": _versioned(row)}


def _submit(house: House) -> Made:
    row = house.candidate()
    return "ada", {"parameter_set_id": row["id"], "json": {"reason": "It moved."}, "headers": _versioned(row)}


def _withdraw(house: House) -> Made:
    approval = house.submitted()
    client = house.person("ada")
    row = client.get(f"/api/v1/parameter-sets/{approval['parameter_set_id']}").json()
    return "ada", {"parameter_set_id": row["id"], "headers": _versioned(row)}


def _promote(house: House) -> Made:
    row = house.approved()
    return "olga", {"parameter_set_id": row["id"], "headers": _versioned(row)}


ABOUT_COVERAGE = {"kind": "gate", "name": "coverage", "text": "Is a corner empty?"}


def _thread(house: House) -> dict[str, Any]:
    approval_id = house.submitted()["id"]
    made = house.person("ada").post(f"/api/v1/approvals/{approval_id}/threads", json=ABOUT_COVERAGE)
    return {"approval_id": approval_id, "thread_id": made.json()["id"]}


def _reopen_thread(house: House) -> Made:
    path = _thread(house)
    address = "/api/v1/approvals/{approval_id}/threads/{thread_id}:resolve".format(**path)
    house.person("ada").post(address, headers={"If-Match": '"v1"'})
    return "alan", {**path, "headers": {"If-Match": '"v2"'}}


def _sign(house: House) -> Made:
    approval = house.submitted()
    body = {"meaning": "I have read it.", "comment": "Seen.", "password": PASSWORD}
    return "alan", {"approval_id": approval["id"], "json": body, "headers": _versioned(approval)}


def _sign_beside(house: House) -> Made:
    _, options = _sign(house)
    return "victor", {**options, "json": {**options["json"], "name": "alan", "decision": "APPROVE"}}


def _opening(house: House) -> Made:
    approval = house.submitted()
    house.person("alan").get(f"/api/v1/approvals/{approval['id']}/figures/radial")
    with open_writing(house.app.state.engine) as session:
        alan = session.scalar(sa.select(User.id).where(User.name == "alan"))
        given = approval_queries.find_delivery(session, approval["id"], alan, "radial")
        given.given_utc = utc_after(-60.0)
    return "alan", {"approval_id": approval["id"], "json": {"evidence": "radial"}}


def _roll_back(house: House) -> Made:
    row = house.approved()
    client = house.person("olga")
    client.post(f"/api/v1/parameter-sets/{row['id']}:promote", headers=_versioned(row))
    found = client.get("/api/v1/parameter-sets", params={"sensor_id": row["sensor_id"]}).json()["items"]
    former = next(one for one in found if one["ground_state"] == "SUPERSEDED")
    return "olga", {"parameter_set_id": former["id"], "json": {"reason": "It drifts."}, "headers": _versioned(former)}


def _assign(house: House) -> Made:
    approval = house.submitted()
    alan = house.person("alan").get("/api/v1/sessions/current").json()["user_id"]
    return "ada", {"approval_id": approval["id"], "json": {"user_id": alan}, "headers": _versioned(approval)}


def _record(house: House) -> Made:
    client = house.person("ada")
    sensor = house.new_sensor()
    found = client.get("/api/v1/parameter-sets", params={"sensor_id": sensor["id"]}).json()["items"][0]
    step = {"parameter_set_id": found["id"], "onboard_state": "SENT", "source": "Pass 1"}
    return "olga", {"json": step, "headers": _versioned(found)}


def _define(house: House) -> Made:
    row = house.new_sensor()
    fields = [
        {"name": f"F{place}", "parameter": name, "offset_bytes": 4 * place, "type": "float32"}
        for place, name in enumerate(row["document"]["initial"])
    ]
    document = {"table_id": "T", "flight_software_version": "1", "length_bytes": 32, "fields": fields}
    body = {"document": document, "reason": "Flight software 1."}
    return "ada", {"sensor_id": row["id"], "json": body, "headers": {"If-Match": '"v0"'}}


def _export(house: House) -> Made:
    sensor = house.new_sensor()
    found = house.person("ada").get("/api/v1/parameter-sets", params={"sensor_id": sensor["id"]}).json()["items"][0]
    return "olga", {"parameter_set_id": found["id"], "json": {}}


def _package(house: House) -> Made:
    number = _export(house)[1]["parameter_set_id"]
    made = house.person("olga").post(f"/api/v1/parameter-sets/{number}:export")
    return "victor", {"package_id": made.json()["id"]}


def _new_user(house: House) -> dict[str, Any]:
    name = house.sensor_file()["name"]
    return {"name": name, "printed_name": f"Someone {name}", "password": PASSWORD, "roles": ["viewer"]}


def _user(house: House, **options: Any) -> Made:
    client = house.person("adele")
    made = client.post("/api/v1/users", json=_new_user(house))
    return "adele", {"user_id": made.json()["id"], "headers": {"If-Match": made.headers["etag"]}, **options}


def _archive(house: House) -> Made:
    number = house.ready_sensor()[1]
    read = house.person("ada").get(f"/api/v1/telemetry-sets/{number}")
    return "ada", {"telemetry_set_id": number, "headers": {"If-Match": read.headers["etag"]}}


def _cancel(house: House) -> Made:
    number = house.launched()["id"]
    read = house.person("ada").get(f"/api/v1/runs/{number}")
    return "ada", {"run_id": number, "headers": {"If-Match": read.headers["etag"]}}


def _key(house: House) -> Made:
    client = house.person("ada")
    return "ada", {"key_id": client.post("/api/v1/api-keys", json={"label": "x"}).json()["id"]}


def _session(house: House) -> Made:
    listed = house.log_in("victor").get("/api/v1/sessions").json()["items"]
    return "victor", {"session_id": listed[0]["id"]}


def _webhook(house: House, **options: Any) -> Made:
    return "adele", {"webhook_id": house.person("adele").post("/api/v1/webhooks", json=HOOK).json()["id"], **options}


def _delivery(house: House) -> Made:
    number = _webhook(house)[1]["webhook_id"]
    return "adele", {"delivery_id": house.person("adele").post(f"/api/v1/webhooks/{number}:try").json()["id"]}


def _compare(house: House) -> Made:
    return "victor", {"params": {"runs": f"{house.finished()},{house.finished()}"}}


def _enrolment(house: House) -> Made:
    name, _ = house.new_person("viewer")
    begun = house.person(name).post("/api/v1/second-factors:begin", json={"password": PASSWORD}).json()
    return name, {"json": {"challenge_id": begun["challenge_id"], "factor": App(begun["secret"]).code()}}


def _enrolled(house: House) -> tuple[Made, int]:
    name, number = house.new_person("viewer")
    app, _ = enrol_app(house.person(name))
    factor_id = house.person(name).get("/api/v1/second-factors").json()["items"][0]["id"]
    return (name, {"factor_id": factor_id, "json": {"password": PASSWORD, "factor": app.code()}}), number


def _renewal(house: House) -> Made:
    (name, options), _ = _enrolled(house)
    return name, {"json": options["json"]}


def _reset_factor(house: House) -> Made:
    _, number = _enrolled(house)
    tag = house.person("adele").get(f"/api/v1/users/{number}").headers["etag"]
    return "adele", {"user_id": number, "headers": {"If-Match": tag}}


def _with_security_key(house: House) -> Made:
    name, number = house.new_person("viewer")
    house.person(name)  # logged in before a key is asked for
    about = {"user_id": number, "kind": "webauthn", "label": "key", "secret": "AA", "created_utc": utc_after(0.0)}
    with open_writing(house.app.state.engine) as session:
        session.put(SecondFactor(**about, credential_id=f"AA{number:06d}", rp_id="127.0.0.1"))
        audit.append(session, COMMAND_LINE, "enrolled", f"users/{number}")
    return name, {}


GOOD: dict[str, Callable[[House], Made]] = {
    **alarms.GOOD,
    "compare_runs": _compare,
    "compare_runs_data": _compare,
    "draw_radial_contrast": _compare,
    "get_radial_contrast_data": _compare,
    "health": lambda _: ("victor", {}),
    "readiness": lambda _: ("victor", {}),
    "metrics": lambda _: ("victor", {}),
    "list_sensors": lambda _: ("victor", {}),
    "register_sensor": lambda house: ("ada", {"json": house.sensor_file()}),
    "get_sensor": lambda house: ("victor", {"sensor_id": house.new_sensor()["id"]}),
    "edit_sensor": _edit,
    "get_sensor_at": lambda house: (
        "victor",
        {"sensor_id": house.new_sensor()["id"], "params": {"at": "2099-01-01T00:00:00Z"}},
    ),
    "get_sensor_as_of": lambda house: ("victor", {"sensor_id": house.new_sensor()["id"]}),
    "plan_pointings": lambda house: (
        "victor",
        {
            "sensor_id": house.new_sensor()["id"],
            "json": {
                "start_utc": "2026-10-01T00:00:00Z",
                "minutes": 2.0,
                "candidates": [[10.0, 5.0, 0.0], [200.0, 60.0, 90.0]],
            },
        },
    ),
    "list_sensor_timeline": lambda house: ("victor", {"sensor_id": house.new_sensor()["id"]}),
    "list_telemetry_sets": lambda _: ("victor", {}),
    "upload_telemetry_set": _upload,
    "get_telemetry_source": _imported,
    "list_import_profiles": lambda _: ("victor", {}),
    "save_import_profile": lambda house: ("ada", {"json": _new_profile(house)}),
    "get_import_profile": lambda house: ("victor", {"profile_id": _saved_profile(house)["id"]}),
    "archive_import_profile": _archive_profile,
    "get_telemetry_set": lambda house: ("victor", {"telemetry_set_id": house.ready_sensor()[1]}),
    "get_telemetry_file": lambda house: ("victor", {"telemetry_set_id": house.ready_sensor()[1]}),
    "diagnose_telemetry_set": lambda house: ("ada", {"telemetry_set_id": house.ready_sensor()[1]}),
    "archive_telemetry_set": _archive,
    "list_runs": lambda _: ("victor", {}),
    "launch_run": _launch,
    "get_run": lambda house: ("victor", {"run_id": house.launched()["id"]}),
    "cancel_run": _cancel,
    "archive_run": lambda house: ("ada", {"run_id": house.finished()}),
    "restore_run": lambda house: ("ada", {"run_id": house.finished()}),
    "get_run_result": lambda house: ("victor", {"run_id": house.finished()}),
    "choose_camera": lambda house: ("ada", {"run_id": house.finished()}),
    "get_run_choice": lambda house: ("victor", {"run_id": house.chosen()}),
    "get_run_choice_figure": lambda house: ("victor", {"run_id": house.chosen()}),
    "get_run_passes_figure": lambda house: ("victor", {"run_id": house.finished()}),
    "get_run_passes_data": lambda house: ("victor", {"run_id": house.finished()}),
    "get_run_removed_data": lambda house: ("victor", {"run_id": house.finished()}),
    "get_run_choice_data": lambda house: ("victor", {"run_id": house.chosen()}),
    "get_run_log": lambda house: ("victor", {"run_id": house.finished()}),
    "get_run_report": lambda house: ("victor", {"run_id": house.finished()}),
    "get_run_camera_file": lambda house: (
        "victor",
        {"run_id": house.finished(), "params": {"to": "opencv", "allow_px": 1000}},
    ),
    "list_frames": lambda house: ("victor", {"run_id": house.finished()}),
    "get_frame": lambda house: ("victor", {"run_id": house.finished(), "frame": 1}),
    **campaigns.GOOD,
    "list_figures": lambda house: ("victor", {"run_id": house.finished()}),
    "get_figure": lambda house: ("victor", {"run_id": house.finished(), "name": "radial"}),
    "get_figure_data": lambda house: ("victor", {"run_id": house.finished(), "name": "radial"}),
    **pairs.GOOD,
    **decisions.GOOD,
    "list_parameter_sets": lambda _: ("victor", {}),
    "create_parameter_set": lambda house: ("ada", {"json": {"run_id": house.finished()}}),
    "get_parameter_set": lambda house: ("victor", {"parameter_set_id": house.candidate()["id"]}),
    "convert_parameter_set": lambda house: (
        "victor",
        {"parameter_set_id": house.candidate()["id"], "params": {"to": "pinhole_radial", "allow_px": 100}},
    ),
    "get_parameter_set_camera_file": lambda house: (
        "victor",
        {"parameter_set_id": house.candidate()["id"], "params": {"to": "mrcal", "allow_px": 1000}},
    ),
    "submit_parameter_set": _submit,
    "withdraw_parameter_set": _withdraw,
    "promote_parameter_set": _promote,
    "roll_back_parameter_set": _roll_back,
    "list_gate_profiles": lambda house: ("victor", {"sensor_id": house.new_sensor()["id"]}),
    "set_gate_profile": gates.set_profile,
    "try_gate_profile": gates.try_profile,
    "assess_parameter_set": lambda house: ("ada", {"parameter_set_id": house.candidate()["id"]}),
    "get_gate_report": lambda house: ("victor", {"parameter_set_id": gates.blocked(house)["id"]}),
    "waive_gate": gates.waive,
    "list_table_definitions": lambda house: ("victor", {"sensor_id": _define(house)[1]["sensor_id"]}),
    "set_table_definition": _define,
    **proposals.GOOD,
    "export_parameter_set": _export,
    "list_packages": lambda _: ("victor", {}),
    "get_package": _package,
    "get_package_content": _package,
    "list_signers": lambda house: ("victor", {"approval_id": house.submitted()["id"]}),
    "list_approvals": lambda _: ("victor", {}),
    "get_approval": lambda house: ("victor", {"approval_id": house.submitted()["id"]}),
    "approve": _sign,
    "refuse": _sign,
    "sign_over_the_shoulder": _sign_beside,
    "assign_approval": _assign,
    "list_remarks": lambda house: ("victor", {"approval_id": house.submitted()["id"]}),
    "remark": lambda house: ("ada", {"approval_id": house.submitted()["id"], "json": {"text": "Was the heater on?"}}),
    "list_openings": lambda house: ("victor", {"approval_id": house.submitted()["id"]}),
    "record_opening": _opening,
    "list_points": lambda house: ("alan", {"approval_id": house.submitted()["id"]}),
    "open_figure": lambda house: ("alan", {"approval_id": house.submitted()["id"], "name": "radial"}),
    "list_threads": lambda house: ("victor", {"approval_id": house.submitted()["id"]}),
    "open_thread": lambda house: ("ada", {"approval_id": house.submitted()["id"], "json": ABOUT_COVERAGE}),
    "get_thread": lambda house: ("victor", _thread(house)),
    "answer_thread": lambda house: ("alan", {**_thread(house), "json": {"text": "It was."}}),
    "resolve_thread": lambda house: ("alan", {**_thread(house), "headers": {"If-Match": '"v1"'}}),
    "reopen_thread": _reopen_thread,
    "list_uplinks": lambda _: ("victor", {}),
    "record_uplink": _record,
    "get_uplink": onboard.uplink,
    "get_uplink_dump": onboard.uplink,
    "get_workflow": lambda house: ("victor", {"parameter_set_id": house.candidate()["id"]}),
    "hand_over_parameter_set": onboard.hand_over,
    "read_back": onboard.read_back,
    "activate_parameter_set": onboard.activate,
    "stream_events": lambda _: ("victor", {}),
    "list_audit": lambda _: ("victor", {}),
    "attach": _attachment,
    "get_attachment": _attached,
    "list_annotations": _annotated,
    "annotate": _annotation,
    "list_saved_views": lambda _: ("victor", {}),
    "save_view": _view,
    "remove_view": _saved_view,
    "list_anchors": lambda _: ("victor", {}),
    "make_anchor": lambda _: ("adele", {}),
    "get_public_keys": lambda _: ("victor", {}),
    "verify_audit": lambda _: ("victor", {}),
    "export_audit": lambda _: ("victor", {}),
    "get_audit_verifier": lambda _: ("victor", {}),
    "list_backups": lambda _: ("victor", {}),
    "list_users": lambda _: ("adele", {}),
    "create_user": lambda house: ("adele", {"json": _new_user(house)}),
    "get_user": lambda _: ("adele", {"user_id": 1}),
    "change_roles": lambda house: _user(house, json={"roles": ["operator"]}),
    "disable_user": _user,
    "enable_user": _user,
    "change_password": lambda house: _user(house, json={"password": "another good one"}),
    "end_sessions": _user,
    "list_api_keys": lambda _: ("ada", {}),
    "create_api_key": lambda _: ("ada", {"json": {"label": "nightly"}}),
    "revoke_api_key": _key,
    "list_message_addresses": lambda _: ("victor", {}),
    "add_message_address": lambda _: ("victor", {"json": {"address": "victor@mission.invalid", "kinds": ["alarm"]}}),
    "get_message_address": _address,
    "change_message_address": lambda house: _address(house, json={"kinds": ["mention"]}),
    "remove_message_address": _address,
    "try_message_address": _address,
    "list_address_messages": _address,
    "list_webhooks": lambda _: ("adele", {}),
    "create_webhook": lambda _: ("adele", {"json": HOOK}),
    "get_webhook": _webhook,
    "disable_webhook": _webhook,
    "enable_webhook": _webhook,
    "renew_webhook_secret": lambda house: _webhook(house, json={}),
    "try_webhook": _webhook,
    "list_webhook_deliveries": _webhook,
    "redeliver": _delivery,
    "log_in": lambda _: ("victor", {"json": {"name": "victor", "password": PASSWORD}}),
    "list_second_factors": lambda _: ("victor", {}),
    "begin_second_factor": lambda _: ("victor", {"json": {"password": PASSWORD}}),
    "enrol_second_factor": _enrolment,
    "challenge_security_key": _with_security_key,
    "renew_recovery_codes": _renewal,
    "remove_second_factor": lambda house: _enrolled(house)[0],
    "reset_second_factor": _reset_factor,
    "get_session": lambda _: ("victor", {}),
    "list_sessions": lambda _: ("victor", {}),
    "end_session": _session,
    "end_other_sessions": lambda _: ("victor", {}),
    "log_out": lambda _: ("victor", {}),
    "get_preferences": lambda _: ("victor", {}),
    "set_preference": lambda _: ("victor", {"name": "times", "json": {"value": {"form": "iso"}}}),
}


def ask(client: httpx.Client, name: str, options: dict[str, Any]) -> httpx.Response:
    operation = OPERATIONS[name]
    inside = re.findall(r"{(\w+)}", operation["path"])
    path = operation["path"].format(**{key: options.get(key, 1) for key in inside})
    kept = {key: value for key, value in options.items() if key not in inside}
    if name != "stream_events":
        return client.request(operation["method"], path, **kept)
    with client.stream(operation["method"], path, **kept) as answer:
        return answer


def _shapes(shape: type[BaseModel] = BaseModel) -> dict[str, type[BaseModel]]:
    found = {one.__name__: one for one in shape.__subclasses__() if one.__module__.startswith("boresight.")}
    return found | {name: each for one in shape.__subclasses__() for name, each in _shapes(one).items()}


SHAPES = _shapes()


def documented_shape(name: str, status: int) -> Any:
    content = OPERATIONS[name]["responses"][str(status)].get("content", {})
    named = content.get("application/json", {}).get("schema", {}).get("$ref", "").rsplit("/", 1)[-1]
    listed = re.fullmatch(r"Page_(\w+)_", named)
    return Page[SHAPES[listed[1]]] if listed else SHAPES.get(named)
