"""`Accept-Encoding` as RFC 9110, 12.5.3 has it, on every kind of route."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.platform.web.middleware import takes_gzip
from tests.served import House

TABLE = {
    "gzip": True,
    "GZIP": True,
    "x-gzip": True,
    "*": True,
    "gzip, deflate, br, zstd": True,
    "br;q=1.0, gzip;q=0.8, *;q=0.1": True,
    "gzip;q=0.001": True,
    "Gzip ; Q=1": True,
    "identity;q=0, *": True,
    "gzip;q=0": False,
    "gzip; q=0.000": False,
    "gzip;q=0, identity": False,
    "gzip;q=0, *": False,
    "*;q=0": False,
    "identity": False,
    "identity;q=1, gzip;q=0.5": False,
    "": False,
    "br": False,
    "gzipped": False,
    "gzip;q=much": False,
    "gzip;q=nan": False,
    "gzip;q=2": False,
}
ROUTES = ("/static/shared/style.css", "/metrics", "/api/v1/runs", "/runs", "/api/v1/openapi.json")


@pytest.mark.parametrize(("accepted", "taken"), TABLE.items())
def test_weights_stars_and_capitals_are_read_as_the_standard_has_them(accepted: str, taken: bool) -> None:
    assert takes_gzip(accepted.encode()) is taken


@given(
    st.lists(st.sampled_from(("gzip", "*", "identity", "br", ";q=", ";", ",", "0", "1", ".5", " ", "é")), max_size=12)
)
def test_nothing_is_packed_unless_gzip_or_anything_is_named_and_no_header_is_an_error(parts: list[str]) -> None:
    accepted = "".join(parts)
    assert not takes_gzip(accepted.encode()) or {"gzip", "*"} & set(parts)


@pytest.mark.parametrize("path", ROUTES)
def test_every_route_sends_what_is_accepted(house: House, path: str) -> None:
    for _ in range(3):
        house.launched()
    client = house.person("ada")
    for accepted, taken in TABLE.items():
        answer = client.get(path, headers={"Accept-Encoding": accepted})
        assert answer.status_code == 200
        assert ("content-encoding" in answer.headers) is taken, accepted


def test_a_header_given_in_two_lines_is_one_list(house: House) -> None:
    lines = [("Accept-Encoding", "br"), ("Accept-Encoding", "gzip;q=0")]
    assert "content-encoding" not in house.anybody().get("/static/shared/style.css", headers=lines).headers
