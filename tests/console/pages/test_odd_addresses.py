"""No page fails for what stands in its address: every page that is read by GET, with made-up parameters."""

from __future__ import annotations

import re
from typing import Any
from urllib.parse import quote

import hypothesis
import pytest
from fastapi.routing import APIRoute
from hypothesis import strategies as st

from boresight.console import pages
from tests.served import House, house

__all__ = ["house"]

NAMES = (
    "sensor", "sensor_id", "set", "data", "state", "method", "sort", "columns", "before", "runs", "reference", "clone", "preset",
    "since", "until", "at", "time", "object", "actor", "action", "verify", "frame", "worst", "scale", "part", "align", "overlay",
    "everything", "q", "find", "page", "next", "free-1", "kind", "purpose", "archived", "telemetry_set_id", "validation_set_id",
    "label", "model", "against", "form", "step", "days", "sha256",
)  # fmt: skip
ODD = st.sampled_from((
    "", "0", "1", "-1", "--1", "1,2", "1,1", ",", "9" * 19, "9" * 30, "9" * 5000, "nan", "inf", "1e400", "x", "é", "\ud7ff", "٣",
    "²", "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00", "2026-11-21", "-run", "run", "state,run,x", "BASELINE",
    "FAILED", "batch", "trust", "summary", "time", "band", "a" * 3000, "%", "=1", "';--", "<b>", "\n", "\u202e",
))  # fmt: skip
QUERY = st.lists(st.tuples(st.sampled_from(NAMES), ODD), max_size=4)


def _paths() -> list[str]:
    routes = [route for module in pages.modules() for router in pages.routers(module) for route in router.routes]
    return sorted({route.path for route in routes if isinstance(route, APIRoute) and "GET" in route.methods})


PATHS = _paths()


def test_the_pages_are_all_there() -> None:
    assert {"/", "/runs", "/audit", "/audit.csv", "/compare", "/sensors/{sensor_id:int}"} & set(PATHS)
    assert len(PATHS) > 30


@pytest.mark.parametrize("path", PATHS)
def test_no_page_ends_in_a_server_error_whatever_its_address_says(path: str, house: House) -> None:
    client = house.person("adele")
    house.finished()

    @hypothesis.settings(max_examples=4, database=None, suppress_health_check=list(hypothesis.HealthCheck))
    @hypothesis.given(query=QUERY, number=st.sampled_from((1, 1, 1, 2, 10**30, "x")))
    def ask(query: list[Any], number: Any) -> None:
        address = re.sub(r"{[^}]+}", str(number), path)
        asked = "&".join(f"{name}={quote(value)}" for name, value in query)
        answer = client.get(f"{address}?{asked}", headers={"Accept": "text/html"})
        assert answer.status_code < 500, (address, query, answer.text[-500:])

    ask()
