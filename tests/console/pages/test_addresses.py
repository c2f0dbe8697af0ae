"""Numbers in addresses that no row can have."""

import pytest

from boresight.console.pages.rendering import GREATEST_NUMBER

HUGE = "99999999999999999999999"


@pytest.mark.parametrize("number", [HUGE, str(GREATEST_NUMBER + 1), str(GREATEST_NUMBER)])
@pytest.mark.parametrize("page", ["runs", "sensors", "telemetry", "parameter-sets", "approvals"])
def test_a_number_that_no_row_can_have_is_not_found(site, page, number):
    answer = site.visitor("victor").send("GET", f"/{page}/{number}", headers={"Accept": "text/html"})
    assert answer.status_code == 404
    assert "<main" in answer.text


@pytest.mark.parametrize(
    "address",
    [
        f"/runs/{HUGE}/log",
        f"/runs?sensor={HUGE}",
        f"/runs?before={HUGE}",
        f"/compare?runs=1,{HUGE}",
        f"/compare?runs=1,{'9' * 5000}",
        f"/telemetry?sensor={HUGE}",
    ],
)
def test_a_query_with_such_a_number_is_not_found(site, address):
    answer = site.visitor("ada").send("GET", address, headers={"Accept": "text/html"})
    assert answer.status_code == 404


def test_leading_zeros_make_a_number_no_greater(site):
    assert site.visitor("ada").send("GET", f"/compare?runs={'0' * 40}1,2").status_code == 200
