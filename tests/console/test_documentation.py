"""The API's documentation: a maintained viewer, from this server alone."""

from __future__ import annotations

import re

from tests.served import House


def test_the_documentation_is_found_beside_the_routes_too(house: House) -> None:
    answer = house.anybody().get("/api/v1/docs")
    assert (answer.status_code, answer.headers["location"]) == (307, "/docs")


def test_all_that_the_documentation_loads_comes_from_this_server(house: House) -> None:
    page = house.anybody().get("/docs").text
    loaded = re.findall(r'(?:src|href)="(.*?)"', page)
    assert {"/static/swagger-ui.css", "/static/swagger-ui-bundle.js"} <= set(loaded)
    for address in loaded:
        answer = house.anybody().get(address)
        assert answer.status_code == 200, address
