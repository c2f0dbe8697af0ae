"""Refusals as pages: each names the problem, the request and the next step; a missing role, who can give it."""

import pytest
from starlette.exceptions import HTTPException
from starlette.requests import Request

from boresight.console.pages.rendering import problem_page
from boresight.errors import (
    OverloadedError,
    PasswordDueError,
    SessionEndedError,
    TooManyAttemptsError,
    UnauthenticatedError,
)
from boresight.platform.web.problems import KINDS

SENTENCE = "This is what happened."
LOG_IN = {PasswordDueError, SessionEndedError, UnauthenticatedError}  # they lead to a page where something can be done
WAITS = {OverloadedError, TooManyAttemptsError}  # they say how long to wait
ERRORS = [
    *(kind(SENTENCE, 3) if kind in WAITS else kind(SENTENCE) for kind in KINDS if kind not in LOG_IN),
    *(HTTPException(status, SENTENCE) for status in (400, 405, 415, 503)),
    ZeroDivisionError("a secret"),
]


@pytest.mark.parametrize(
    "error", ERRORS, ids=lambda error: f"{type(error).__name__}-{getattr(error, 'status_code', '')}"
)
def test_every_refusal_says_what_happened_what_to_do_and_what_to_quote(site, read, error):
    scope = {"type": "http", "method": "POST", "path": "/runs", "headers": [], "query_string": b"", "app": site.app}
    request = Request(scope)
    request.state.actor, request.state.request_id = None, "request-4711"
    page = read(problem_page(request, error).body.decode())
    assert SENTENCE in page or isinstance(error, HTTPException | ZeroDivisionError)
    assert "a secret" not in page
    assert "request-4711" in page
    assert any(
        step in page for step in ("Go back", "Try again", "try again", "Read", "Split", "Wait", "Open", "It may")
    )


def test_a_missing_role_is_named_with_who_can_give_it(site, read):
    visitor = site.visitor("victor")
    token, page_wanted = {"csrf_token": visitor.csrf_token}, {"Accept": "text/html"}
    answer = visitor.send("POST", "/telemetry/1/archive", data=token, headers=page_wanted)
    page = read(answer.text)
    assert answer.status_code == 403
    assert "role analyst" in page
    assert "Adele Administrator can give roles" in page


def test_a_conflict_shows_the_version_that_was_seen_and_the_one_that_is(site, read):
    answer = site.visitor("ada").post("/sensors/1", document="{}", version="7")
    page = read(answer.text)
    assert "you saw v7" in page
    assert "it is v1" in page
