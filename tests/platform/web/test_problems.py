"""Refusals: one shape, one sentence, the right status, never a trace."""

import copy
import inspect
import logging
import re
from typing import Any

import pytest

from boresight import errors
from boresight.errors import BoresightError, ConflictError, Fault, RefusedInputError
from boresight.platform.web.problems import KINDS, make_problem
from tests.served import House


def test_every_kind_of_error_has_its_status() -> None:
    kinds = {
        kind
        for _, kind in inspect.getmembers(errors, inspect.isclass)
        if issubclass(kind, BoresightError) and kind is not BoresightError
    }
    assert kinds == set(KINDS)


def test_a_problem_names_type_title_status_detail_instance_and_request(house: House) -> None:
    answer = house.person("ada").get("/api/v1/runs/987654", headers={"X-Request-ID": "abc-1"})
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json() == {
        "type": "urn:boresight:problem:not-found",
        "title": "Not found",
        "status": 404,
        "code": None,
        "detail": "There is no run 987654; choose one from the list.",
        "instance": "/api/v1/runs/987654",
        "request_id": "abc-1",
        "errors": [],
    }


def test_a_reason_for_programs_is_the_problem_s_code_however_the_sentence_reads() -> None:
    assert make_problem(ConflictError("You signed it.", code="already-signed")).code == "already-signed"
    assert make_problem(copy.copy(ConflictError("You signed it.", code="already-signed"))).code


def test_faults_become_places() -> None:
    refusal = RefusedInputError("The file is refused.", (Fault(12, "row_px", "It is no number; correct it."),))
    problem = make_problem(refusal)
    assert problem.status == 422
    assert problem.errors == [{"row": 12, "column": "row_px", "detail": "It is no number; correct it."}]


def test_a_malformed_body_is_refused_with_the_pointer(house: House) -> None:
    answer = house.person("ada").post("/api/v1/runs", json={"sensor_id": "one", "telemetry_set_id": 1, "colour": 2})
    body = answer.json()
    assert answer.status_code == 422
    assert {place["pointer"] for place in body["errors"]} == {"/sensor_id", "/colour"}
    assert "/sensor_id" in body["detail"]


def test_json_that_is_none_is_refused(house: House) -> None:
    answer = house.person("ada").post(
        "/api/v1/runs", content=b"{nonsense", headers={"Content-Type": "application/json"}
    )
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize(
    ("method", "path", "status"), [("GET", "/api/v1/nothing", 404), ("PATCH", "/api/v1/runs", 405)]
)
def test_what_the_framework_refuses_is_a_problem_too(house: House, method: str, path: str, status: int) -> None:
    answer = house.person("ada").request(method, path)
    assert answer.status_code == status
    assert answer.json()["request_id"] == answer.headers["x-request-id"]


def test_what_nobody_foresaw_tells_its_request_id_and_nothing_else(
    house: House, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_args: Any, **_named: Any) -> None:
        raise ZeroDivisionError("the secret of the house")

    monkeypatch.setattr("boresight.console.runs.service.list_runs", fail)
    with caplog.at_level(logging.ERROR):
        answer = house.person("ada").get("/api/v1/runs?method=asked-for-once")  # no answer to it is kept
    assert answer.status_code == 500
    assert "secret" not in answer.text
    assert answer.json()["request_id"] in caplog.text
    assert "the secret of the house" in caplog.text
    assert "content-security-policy" in answer.headers


@pytest.mark.parametrize(
    "broken",
    [
        "boresight.console.runs.pages.list.read_page",  # what the page shows
        "boresight.console.pages.rendering.make_page_frame",  # what every page shows
        "boresight.console.access.dependencies.open_reading",  # the database itself
    ],
)
def test_what_nobody_foresaw_gives_a_person_a_page_with_the_request_id(
    house: House, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    def fail(*_args: Any, **_named: Any) -> None:
        raise ZeroDivisionError("the secret of the house")

    monkeypatch.setattr(broken, fail)
    answer = house.person("ada").get("/runs", headers={"Accept": "text/html", "X-Request-ID": "quote-me-7"})
    assert answer.status_code == 500
    assert answer.headers["content-type"].startswith("text/html")
    assert "quote-me-7" in answer.text
    assert "report the request id" in answer.text
    assert not re.search("secret|Traceback|ZeroDivision", answer.text)
    assert "content-security-policy" in answer.headers


def test_a_body_over_the_limit_is_refused_while_it_is_read(house: House) -> None:
    def endless() -> Any:
        for _ in range(2000):
            yield b"x" * 1000

    answer = house.person("ada").post("/api/v1/runs", content=endless(), headers={"Content-Type": "application/json"})
    assert answer.status_code == 413
    assert "1,000,000 bytes" in answer.json()["detail"]


def test_a_person_gets_a_page_where_a_program_gets_a_problem(house: House) -> None:
    page = house.person("ada").get("/nothing-here", headers={"Accept": "text/html"})
    assert page.status_code == 404
    assert page.headers["content-type"].startswith("text/html")
    program = house.person("ada").get("/nothing-here", headers={"Accept": "application/json"})
    assert program.headers["content-type"] == "application/problem+json"


def test_who_is_not_logged_in_is_sent_to_the_log_in_and_back(house: House) -> None:
    answer = house.anybody().get("/runs?state=FAILED", headers={"Accept": "text/html"})
    assert answer.status_code == 303
    assert answer.headers["location"] == "/login?next=%2Fruns%3Fstate%3DFAILED"
