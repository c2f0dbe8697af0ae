"""Logs as JSON: one object a line, that names the request, person, run and trace, and holds no secret."""

import io
import json
import logging
import re
import subprocess
import sys

import pytest

from boresight.errors import RefusedInputError
from boresight.platform.observability import logs
from boresight.platform.observability.logs import BELONGS_TO, JsonFormatter, belonging_to, hide_secrets
from boresight.settings import read_settings

PLACE = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"


@pytest.fixture
def lines():
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(JsonFormatter())
    boresight = logging.getLogger("boresight")
    boresight.addHandler(handler)
    before = boresight.level
    boresight.setLevel(logging.INFO)
    yield lambda: [json.loads(line) for line in stream.getvalue().splitlines()]
    boresight.removeHandler(handler)
    boresight.setLevel(before)


def test_each_request_is_a_line_with_its_id_person_route_and_status(house, lines):
    given = {"X-Request-ID": "passes-7", "traceparent": PLACE}
    house.person("ada").get("/api/v1/sensors?limit=1", headers=given)
    (line,) = [line for line in lines() if line.get("request_id") == "passes-7"]
    told = {"level": "INFO", "logger": "boresight.requests", "person": "ada", "status": 200, "route": "/api/v1/sensors"}
    assert told.items() <= line.items()
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", line["time"])
    assert "trace_id" not in line, "traces are off"


def test_a_line_of_a_run_names_run_attempt_and_trace_and_its_traceback_is_one_member(lines):
    with belonging_to(run_id=7, attempt=2, traceparent=PLACE):
        failure = ValueError("postgresql://boresight:hunter22@db/x")
        logging.getLogger("boresight.workers.tasks").error("A run failed", exc_info=failure)
    assert BELONGS_TO.get() == {}
    (line,) = lines()
    assert (line["run_id"], line["attempt"], line["trace_id"], line["span_id"]) == (7, 2, PLACE[3:35], PLACE[36:52])
    assert "ValueError" in line["exception"]
    assert "hunter22" not in line["exception"]


@pytest.mark.parametrize(
    "text",
    ["Bearer bs_abcdef_HUSH123456", "whsec_HUSHaaaaaaa=", "mailtos://bs:HUSHpw@smtp.example", "password=HUSHpw",
     '{"token": "HUSH"}', "Authorization: Bearer HUSH", "Cookie: HUSH=1", "fernet:gAAAAHUSHHUSH"],
)  # fmt: skip
def test_what_looks_like_a_secret_is_taken_out(text):
    assert "HUSH" not in hide_secrets(text)


def test_a_process_writes_json_alone_where_it_is_asked_to_also_of_its_libraries_and_its_start():
    words = """
import logging, warnings
from boresight.platform.observability import logs
logs.configure("json")
logs.sayer("json", print)("Boresight on http://127.0.0.1:8000")
logging.getLogger("uvicorn.error").warning("port %d", 8000)
logging.getLogger("distributed").info("chatter")
logging.getLogger("distributed.nanny.memory").warning("Worker exceeded 95% memory budget")
warnings.warn("old")
"""
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    told = [json.loads(line) for line in done.stderr.splitlines()]
    names = ["boresight.service", "uvicorn.error", "distributed.nanny.memory", "py.warnings"]
    assert ([line["logger"] for line in told], done.stdout) == (names, "")


def test_a_format_that_there_is_not_is_refused_and_text_changes_nothing():
    with pytest.raises(RefusedInputError, match="BORESIGHT_LOG_FORMAT"):
        read_settings({"BORESIGHT_LOG_FORMAT": "xml"})
    before = logging.getLogger().handlers[:]
    logs.configure("text")
    assert logging.getLogger().handlers == before
    assert logs.sayer("text", print) is print
