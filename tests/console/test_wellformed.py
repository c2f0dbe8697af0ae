"""What no store, hash or answer can hold is refused at the door, wherever it comes in: never 500."""

import csv
import io
from typing import Any
from urllib.parse import quote

import orjson
import pytest

from boresight.console.runs.tables import Preset, Run
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.actors import SYSTEM
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import register_blob
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from boresight.platform.web.concurrency_limit import SMALL_BODY_BYTES
from tests.served import House

JSON = {"Content-Type": "application/json"}
ENDS = ("0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00")
HUGE = "9" * 30
UNREADABLE = {
    "a lone surrogate": b'{"name": "\\ud800", "password": "\\udfff", "text": "\\ud800"}',
    "a lone surrogate as a name": b'{"\\ud800": 1}',
    "a surrogate in the bytes": b'{"name": "\xed\xa0\x80"}',
    "NUL": b'{"name": "a\\u0000b"}',
    "NUL as a name": b'{"a\\u0000b": 1}',
    "NaN": b'{"f_m": NaN}',
    "infinity": b'{"f_m": -Infinity}',
    "a number beyond a double": b'{"f_m": 1e400}',
    "an integer beyond a double": b'{"f_m": ' + b"9" * 400 + b"}",
    "an integer longer than Python reads": b'{"f_m": ' + b"9" * 5000 + b"}",
    "a hundred lists in one another": b"[" * 100 + b"]" * 100,
    "a hundred thousand lists in one another": b"[" * 100_000 + b"]" * 100_000,
    "a hundred objects in one another": b'{"a":' * 100 + b"1" + b"}" * 100,
    "no UTF-8": b'{"name": "\xff"}',
    "UTF-16": '{"name": "ada"}'.encode("utf-16"),
    "half of it": b'{"name": ',
}
POSTS = (
    "/api/v1/sessions",
    "/api/v1/sensors",
    "/api/v1/runs",
    "/api/v1/campaigns",
    "/api/v1/presets",
    "/api/v1/users",
    "/api/v1/api-keys",
    "/api/v1/message-addresses",
    "/api/v1/webhooks",
    "/api/v1/uplinks",
    "/api/v1/sensors/1/notes",
    "/api/v1/sensors/1/gate-profiles:dry-run",
)


@pytest.mark.parametrize("what", UNREADABLE)
def test_json_that_is_none_or_cannot_be_kept_is_refused_by_every_post(house, what):
    for path in POSTS:
        answer = house.person("adele").post(path, content=UNREADABLE[what], headers=JSON)
        assert answer.status_code == 422, (path, answer.text)
        assert answer.json()["title"] == "Malformed request"
    answer = house.anybody().post("/api/v1/sessions", content=UNREADABLE[what], headers=JSON)
    is_long = len(UNREADABLE[what]) > SMALL_BODY_BYTES  # not read of who is not known
    assert answer.status_code == (401 if is_long else 422)


@pytest.mark.parametrize("charset", ["unicode_escape", "utf-16", "idna", "undefined", "utf-7", "nothing"])
def test_a_form_in_another_charset_is_refused_and_a_byte_order_mark_read_over(house, charset):
    marked = b'\xef\xbb\xbf{"label": "from a spreadsheet"}'  # its byte order is
    assert house.person("ada").post("/api/v1/api-keys", content=marked, headers=JSON).status_code == 201
    body = b'--b\r\nContent-Disposition: form-data; name="name"\r\n\r\n\\ud800\r\n--b--\r\n'
    headers = {"Content-Type": f"multipart/form-data; boundary=b; charset={charset}"}
    for path in ("/login", "/api/v1/telemetry-sets", "/api/v1/parameter-sets/1:read-back", "/telemetry"):
        assert house.person("ada").post(path, content=body, headers=headers).status_code == 415, path


TIMES = (
    "/api/v1/audit?since={}",
    "/api/v1/audit?until={}",
    "/api/v1/sensors/{sensor}/history?at={}",
    "/api/v1/sensors/{sensor}/as-of?time={}",
    "/api/v1/sensors/{sensor}/timeline?until={}",
    "/audit?since={}",
    "/audit?until={}",
    "/audit.csv?until={}",
    "/sensors/{sensor}/history?at={}",
)


@pytest.mark.few(12)
@pytest.mark.parametrize("time", [*ENDS, "9" * 400, "\ud7ff", "10000-01-01", "0000-01-01"])
@pytest.mark.parametrize("address", TIMES)
def test_a_time_beyond_the_calendar_is_no_time(house, address, time):
    house.new_sensor()
    path = address.format(quote(time), sensor=1)
    answer = house.person("ada").get(path, headers={"Accept": "text/html"} if "/api/" not in path else {})
    assert answer.status_code < 500, answer.text
    if "/api/" in path:
        assert answer.status_code == 422


@pytest.mark.parametrize("time", ["0001-01-01T00:00:00Z", "9999-12-31T23:59:59Z", "0033-04-03"])
def test_a_time_at_the_end_of_the_calendar_sorts_as_time(house, time):
    found = house.person("ada").get("/api/v1/audit", params={"since": time}).json()["items"]
    assert bool(found) == time.startswith("0")


def test_the_audit_log_comes_as_csv(house):
    answer = house.person("adele").get("/audit.csv")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/csv; charset=utf-8")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert {"id", "at_utc", "actor", "action", "changed", "hash", "roles"} <= set(rows[0])
    assert len(rows) == len({row["hash"] for row in rows})


@pytest.mark.parametrize("part", ["", "/data"])
@pytest.mark.parametrize("other", [HUGE, "9" * 5000, "99999999999999999999,1"])
def test_a_run_that_none_can_be_is_compared_with_nothing(house, part, other):
    path = f"/api/v1/runs/{house.finished()}/figures/radial{part}"
    assert house.person("ada").get(path, params={"compare": other}).status_code == 404


@pytest.mark.few(2)
@pytest.mark.parametrize("window", [("0", "1"), ("-1e308", "1e308"), ("-inf", "inf"), ("nan", "1"), ("1", "0")])
def test_every_figure_takes_a_window_or_refuses_it(house, window):
    run_id, client = house.finished(), house.person("ada")
    names = [item["name"] for item in client.get(f"/api/v1/runs/{run_id}/figures").json()["items"]]
    ascending = float(window[0]) < float(window[1])
    for name in names:
        answer = client.get(f"/api/v1/runs/{run_id}/figures/{name}", params={"x_from": window[0], "x_to": window[1]})
        assert answer.status_code == (200 if ascending else 422), (name, answer.text[:300])


def test_an_empty_idempotency_key_is_refused(house):
    client, headers = house.person("ada"), {"Idempotency-Key": ""}
    answers = [
        client.post("/api/v1/presets", json={"name": "A", "sentence": "s"}, headers=headers),
        client.post("/api/v1/api-keys", json={"label": "x"}, headers=headers),
        house.upload(client, 1, headers=headers),
        client.post(
            "/api/v1/parameter-sets/1:read-back", data={"source": "x"}, headers={**headers, "If-Match": '"v1"'}
        ),
    ]
    assert [answer.status_code for answer in answers] == [422] * 4
    assert "Idempotency-Key" in answers[0].text or "idempotency-key" in answers[0].text


@pytest.mark.parametrize("tag", [f'"v{"9" * 30}"', f'"v{"9" * 5000}"', '"v"', '"v-1"', "*"])
def test_a_tag_of_no_version_is_stale(house, tag):
    row = house.new_sensor()
    answer = house.person("ada").put(f"/api/v1/sensors/{row['id']}", json=row["document"], headers={"If-Match": tag})
    assert answer.status_code == 412


PAGES = (
    "/runs?before={}",
    "/runs?runs={}",
    "/runs?sensor={}",
    "/runs?data={}",
    "/telemetry?sensor={}",
    "/parameter-sets?before={}",
    "/audit?before={}",
    "/alarms?before={}",
    "/alarms?sensor={}",
    "/campaigns?before={}",
    "/compare?runs={}",
    "/compare?runs=1,2&reference={}",
    "/runs/new?sensor={}",
    "/runs/new?clone={}",
    "/runs/1?frame={}",
    "/sensors/{}",
    "/runs/{}",
)


@pytest.mark.few(3)
@pytest.mark.parametrize("value", [HUGE, "9" * 5000, "--5", "%00", "%ED%A0%80", "٣", "-1", "1e5", "²"])
def test_no_page_fails_for_what_stands_in_its_address(house, value):
    client = house.person("adele")
    house.finished()
    for page in PAGES:
        answer = client.get(page.format(value), headers={"Accept": "text/html"})
        assert answer.status_code < 500, (page, value)


@pytest.mark.parametrize("name", ["a" * 300, "a/" * 3000, "%00", "..%2f" * 20])
def test_a_file_name_that_no_disk_has_is_not_found(house, name):
    assert house.anybody().get(f"/static/{name}").status_code == 404
    for path in ("/static/a%00b", "/runs/%00", "/api/v1/runs/1/figures/%00"):
        assert house.person("ada").get(path).status_code == 404, path


@pytest.mark.parametrize("asked", ["sqlite", "postgresql"])
def test_what_a_column_cannot_hold_is_refused_by_the_store_itself(house, asked, request):
    engine: Engine = house.app.state.engine if asked == "sqlite" else request.getfixturevalue("postgresql")
    with pytest.raises(NotFoundError), open_reading(engine) as session:
        session.get(Run, 2**63)
    given: dict[str, Any] = {"number": 1, "sentence": "", "document": {}, "created_utc": "", "created_by": None}
    for wrong in ({"name": "\ud800"}, {"name": "a", "number": 2**70}):
        with pytest.raises(RefusedInputError), open_writing(engine) as session:
            session.add(Preset(**{**given, **wrong}))  # written when it is committed


NONSENSE = {
    "no JSON": b"frame,exposure\n1,2\n",
    "a list": b"[]",
    "nothing in it": b"{}",
    "only its schema": b'{"schema": "boresight.calibration/1", "status": "converged"}',
    "another schema": b'{"schema": "boresight.evaluation/1", "frames": 3}',
}


def _with_result(house: House, content: bytes) -> int:
    run_id, blobs = house.launched()["id"], house.app.state.blobs
    with open_writing(house.app.state.engine) as session:
        sha256 = blobs.put(content)
        register_blob(session, blobs, sha256, "application/json")
        run = session.get_one(Run, run_id)
        run.state, run.result_sha256 = "SUCCEEDED", sha256
        audit.append(session, SYSTEM, "ended", f"runs/{run_id}")
    return run_id


@pytest.mark.few(2)
@pytest.mark.parametrize("what", [*NONSENSE, "numbers that are words", "a course of words"])
def test_a_stored_result_that_is_no_calibration_is_refused_everywhere(house, what):
    wrong = {"parameters": {"f_m": "long"}} if what == "numbers that are words" else {"history": {"frame": ["first"]}}
    run_id = _with_result(house, NONSENSE.get(what) or orjson.dumps({**house.result, **wrong}))
    client = house.person("ada")
    for path in ("result", "report", "figures/radial", "figures/radial/data", "figures/rms?x_from=0&x_to=1"):
        answer = client.get(f"/api/v1/runs/{run_id}/{path}")
        assert answer.status_code == 409, (path, answer.text[:300])
        assert f"run {run_id}" in answer.json()["detail"]
    made = client.post("/api/v1/parameter-sets", json={"run_id": run_id})
    assert made.status_code == 409
    for page in (f"/runs/{run_id}", f"/runs/{run_id}?part=evidence", f"/compare?runs={run_id},{house.finished()}"):
        answer = client.get(page, headers={"Accept": "text/html"})
        assert answer.status_code == 409, (page, answer.status_code)
        assert f"run {run_id}" in answer.text
    for page in ("/", "/runs", f"/sensors/{client.get(f'/api/v1/runs/{run_id}').json()['sensor_id']}"):
        assert client.get(page, headers={"Accept": "text/html"}).status_code == 200, page
