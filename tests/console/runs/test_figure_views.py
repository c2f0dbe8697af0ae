"""Figures over REST as they are looked at: kept by the browser, aligned, as a band, and a window of them in full."""

import csv
import io

import pytest

from tests.served import House


def test_a_browser_that_has_a_figure_is_told_that_it_still_holds(house: House) -> None:
    client, address = house.person("victor"), f"/api/v1/runs/{house.finished()}/figures/rms"
    first = client.get(address)
    again = client.get(address, headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert client.get(address, headers={"If-None-Match": '"other"'}).content == first.content
    assert first.headers["cache-control"] == "private, no-cache"


def test_every_view_of_a_figure_has_a_tag_of_its_own(house: House) -> None:
    client, run, other = house.person("victor"), house.finished(), house.finished()
    address = f"/api/v1/runs/{run}/figures/rms"
    views = [{}, {"compare": str(other)}, {"align": "update"}, {"overlay": "band"}, {"x_from": 1, "x_to": 5}]
    tags = [client.get(address, params=view).headers["etag"] for view in views]
    assert len(set(tags)) == len(views)


def test_a_figure_of_a_run_that_may_still_change_is_kept_by_nobody(house: House) -> None:
    answer = house.person("victor").get(f"/api/v1/runs/{house.launched()['id']}/figures/rms")
    assert answer.headers["cache-control"] == "no-store"
    assert "etag" not in answer.headers


@pytest.mark.parametrize(
    ("view", "said"),
    [
        ({"x_from": 1}, "both ends"),
        ({"x_from": 5, "x_to": 1}, "x_from below x_to"),
        ({"align": "moon"}, "update"),
        ({"overlay": "pie"}, "band"),
    ],
)
def test_a_view_that_there_is_not_is_refused(house: House, view: dict[str, str], said: str) -> None:
    answer = house.person("victor").get(f"/api/v1/runs/{house.finished()}/figures/convergence", params=view)
    assert answer.status_code == 422
    assert said in answer.text


def test_a_comparison_comes_with_its_assumption_its_table_and_its_curves(house: House) -> None:
    client, runs = house.person("victor"), [house.finished(), house.finished()]
    query = {"runs": ",".join(map(str, runs)), "reference": str(runs[1])}
    found = client.get("/api/v1/runs/compare", params=query).json()
    assert (found["reference"], [run["id"] for run in found["runs"]]) == (runs[1], runs)
    assert "share" in found["assumption"]
    table = list(csv.DictReader(io.StringIO(client.get("/api/v1/runs/compare/data", params=query).text)))
    assert [int(row["run"]) for row in table[:2]] == [runs[1], runs[0]]
    figure = client.get("/api/v1/runs/compare/figures/radial", params=query)
    assert f"Run {runs[0]}" in figure.text
    curves = list(
        csv.DictReader(io.StringIO(client.get("/api/v1/runs/compare/figures/radial/data", params=query).text))
    )
    assert {int(row["run"]) for row in curves} == {runs[0]}


@pytest.mark.parametrize(
    ("asked", "status"),
    [("1", 422), ("1,x", 422), ("999999,1", 404), ("9" * 5000, 404), (",".join(map(str, range(1, 25))), 422)],
)
def test_a_comparison_that_there_cannot_be_is_refused(house: House, asked: str, status: int) -> None:
    assert house.person("victor").get("/api/v1/runs/compare", params={"runs": asked}).status_code == status
