"""The OpenAPI document: valid, every answer typed, and what every method of every address answers."""

from __future__ import annotations

import re
from typing import Any

import pytest
from openapi_spec_validator import OpenAPIV31SpecValidator

from boresight.calibration.options import OPTIONS
from boresight.platform.actors import SCOPES
from tests.console.operations import OPEN, OPENAPI, OPERATIONS

PROBLEM = "application/problem+json"
VERBS = [operation for operation in OPERATIONS.values() if ":" in operation["path"]]
LOOSE: tuple[Any, ...] = (None, {}, {"type": "object", "additionalProperties": True})


def test_the_document_is_valid_no_two_shapes_have_one_name_and_scopes_are_an_enumeration():
    assert OPENAPI["openapi"].startswith("3.1")
    assert [error.message for error in OpenAPIV31SpecValidator(OPENAPI).iter_errors()] == []
    assert [name for name in OPENAPI["components"]["schemas"] if "__" in name] == []
    scopes = OPENAPI["components"]["schemas"]["NewKey"]["properties"]["scopes"]
    assert scopes["items"]["enum"] == list(SCOPES)


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_success_of_every_operation_is_typed(name):
    answers = {status: one for status, one in OPERATIONS[name]["responses"].items() if status.startswith("2")}
    assert answers
    for status, answer in answers.items():
        assert status == "204" or answer["content"], status
        for media_type, content in answer.get("content", {}).items():
            assert content.get("schema") not in LOOSE, (status, media_type)


@pytest.mark.parametrize("name", [name for name in OPERATIONS if name not in OPEN])
def test_every_operation_says_what_every_request_may_meet(name):
    operation = OPERATIONS[name]
    documented = set(operation["responses"])
    assert {"400", "401", "403", "408", "422", "431", "503"} <= documented
    assert "requestBody" not in operation or {"413", "415"} <= documented
    assert "{" not in operation["path"] or "404" in documented
    assert operation["method"] == "GET" or "409" in documented
    assert "Retry-After" in operation["responses"]["503"]["headers"]
    for status, answer in operation["responses"].items():
        if status[0] in "45":
            assert answer["content"][PROBLEM]["schema"] == {"$ref": "#/components/schemas/ProblemDocument"}


@pytest.mark.parametrize("operation", ["runs", "campaigns", "presets"])
def test_every_choice_of_a_calibration_is_described_where_settings_are_given(operation):
    body = OPENAPI["paths"][f"/api/v1/{operation}"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    shape = OPENAPI["components"]["schemas"][body["$ref"].rpartition("/")[2]]
    assert set(shape["properties"]["settings"]["properties"]) == set(OPTIONS)


@pytest.mark.few(10)
@pytest.mark.parametrize("verb", VERBS, ids=lambda operation: operation["operationId"])
def test_get_of_a_verb_is_405_and_says_what_it_takes(verb, house):
    path = re.sub(r"{\w+}", "1", verb["path"])
    for method in ("GET", "HEAD", "PUT", "DELETE"):
        answer = house.person("ada").request(method, path)
        assert (answer.status_code, answer.headers["allow"]) == (405, "POST, OPTIONS"), (method, path)


@pytest.mark.parametrize(
    ("path", "takes"),
    [
        ("/api/v1/sensors", "GET, POST, HEAD, OPTIONS"),
        ("/api/v1/sensors/1", "GET, PUT, HEAD, OPTIONS"),
        ("/api/v1/runs/1:cancel", "POST, OPTIONS"),
        ("/api/v1/runs/1", "GET, HEAD, OPTIONS"),
        ("/healthz", "GET, HEAD, OPTIONS"),
        ("/login", "GET, POST, HEAD, OPTIONS"),
    ],
)
def test_allow_names_every_method_of_an_address(path, takes, house):
    refused, asked = house.person("ada").request("PATCH", path), house.anybody().request("OPTIONS", path)
    assert (refused.status_code, refused.headers["allow"]) == (405, takes)
    assert (asked.status_code, asked.headers["allow"]) == (204, takes)
    for method in ("POST", "GET"):
        assert house.person("ada").request(method, "/api/v1/runs/1:fly").status_code == 404  # no such verb


def test_all_that_the_documentation_loads_comes_from_this_server(house):
    page = house.anybody().get("/api/v1/docs").text
    loaded = re.findall(r'(?:src|href)="(.*?)"', page)
    assert {"/static/swagger-ui.css", "/static/swagger-ui-bundle.js"} <= set(loaded)
    for address in loaded:
        answer = house.anybody().get(address)
        assert answer.status_code == 200, address
