"""Every page is for people who are logged in, but for those that log them in and out."""

import re

import httpx
import pytest
from fastapi.routing import APIRoute

from boresight.console import pages
from tests.sites import Visitor

OPEN = {"/login", "/login/second-factor", "/logout", "/login/single-sign-on"}
ROUTES = [
    (method, route.path)
    for module in pages.modules()
    for router in pages.routers(module)
    for route in router.routes
    if isinstance(route, APIRoute)
    for method in route.methods
]
CLOSED = sorted(one for one in ROUTES if not one[1].startswith("/login") and one[1] != "/logout")


def test_only_the_log_in_and_the_log_out_are_for_everybody():
    assert {re.sub("(single-sign-on)/.*", r"\1", path) for _, path in {*ROUTES} - {*CLOSED}} == OPEN
    assert len(CLOSED) > 150


@pytest.mark.parametrize(("method", "path"), CLOSED)
def test_who_is_not_logged_in_is_led_to_the_log_in(site, method, path):
    nobody = Visitor(site.app, "", httpx.Cookies())
    answer = nobody.send(method, re.sub(r"{[^}]+}", "1", path), headers={"Accept": "text/html"})
    assert answer.status_code == 303
    assert answer.headers["location"].startswith("/login?next=")
