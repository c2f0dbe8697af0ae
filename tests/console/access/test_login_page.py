"""Logging in and out."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.console.access.pages import local_path

PASSWORD = "correct horse battery"


@pytest.fixture
def stranger(site):
    visitor = site.visitor("ada")
    visitor.cookies.clear()
    return visitor


def log_in(visitor, **form):
    return visitor.send("POST", "/login", data={"name": "ada", "password": PASSWORD, "next": "/audit", **form})


def test_the_right_password_leads_to_where_one_wanted_to_go(stranger):
    answer = log_in(stranger)
    assert (answer.status_code, answer.headers["location"]) == (303, "/audit")
    assert "HttpOnly" in answer.headers["set-cookie"]
    assert "Ada Analyst" in stranger.get("/audit")


@pytest.mark.parametrize("form", [{"password": "wrong"}, {"name": "nobody"}])
def test_a_wrong_name_and_a_wrong_password_sound_the_same_and_the_name_stays(stranger, form):
    answer = log_in(stranger, **form)
    assert answer.status_code == 401
    assert answer.status_code == 401
    assert f'value="{form.get("name", "ada")}"' in answer.text
    assert "wrong" not in answer.text


def test_too_many_failures_are_slowed_down_and_then_told_to_wait(stranger, read, monkeypatch):
    monkeypatch.setattr("boresight.console.access.log_in_attempts.HELD_S", 0.01)
    for _ in range(6):
        answer = log_in(stranger, password="wrong")
    answer = log_in(stranger)
    assert answer.status_code == 429
    assert "try again" in read(answer.text)
    assert 1 <= int(answer.headers["retry-after"]) <= 60


def test_another_site_cannot_log_a_browser_in(stranger):
    answer = stranger.send(
        "POST", "/login", data={"name": "ada", "password": PASSWORD}, headers={"sec-fetch-site": "cross-site"}
    )
    assert answer.status_code == 403


def test_who_is_logged_in_needs_no_form(site):
    answer = site.visitor("ada").send("GET", "/login?next=/runs")
    assert (answer.status_code, answer.headers["location"]) == (303, "/runs")


def test_logging_out_ends_the_log_in_of_this_browser(stranger):
    log_in(stranger)
    token = re.search(r'name="csrf_token" value="([^"]+)"', stranger.get("/audit"))[1]
    answer = stranger.send("POST", "/logout", data={"csrf_token": token})
    assert answer.headers["location"] == "/login"
    assert "You are logged out." in stranger.get("/login")
    assert stranger.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303


@given(st.text(max_size=40))
def test_the_way_back_never_leaves_this_server(address):
    way = local_path(address)
    assert way.startswith("/")
    assert not way.startswith(("//", "/\\"))


@pytest.mark.parametrize(
    "address", ["https://evil.example", "//evil.example", "/\\evil.example", "/a\r\nb", "javascript:x"]
)
def test_an_address_of_elsewhere_becomes_the_start(address):
    assert local_path(address) == "/"
