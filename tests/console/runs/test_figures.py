"""Figures over REST: drawn alone and over one another, and the numbers behind them."""

import csv
import io

import pytest

from boresight.console.runs.figure_routes import _stacked
from boresight.figures import FIGURES
from tests.served import House


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_drawn_alone_compared_and_with_nothing_to_draw(house: House, name: str) -> None:
    client, first, second, waiting = (
        house.person("victor"),
        house.finished(),
        house.finished(),
        house.launched()["id"],
    )
    alone = client.get(f"/api/v1/runs/{first}/figures/{name}")
    assert alone.status_code == 200
    assert alone.json()["data"]
    both = client.get(f"/api/v1/runs/{first}/figures/{name}", params={"compare": f"{second},{first}"})
    assert f"Run {second}" in both.text
    assert f"Run {second}" not in alone.text
    nothing = client.get(f"/api/v1/runs/{waiting}/figures/{name}")
    assert nothing.status_code == 200
    assert "layout" in nothing.json()


@pytest.mark.parametrize("name", FIGURES)
def test_the_numbers_behind_every_figure_come_as_csv(house: House, name: str) -> None:
    run_id = house.finished()
    answer = house.person("victor").get(f"/api/v1/runs/{run_id}/figures/{name}/data")
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    assert f'filename="run-{run_id}-{name}.csv"' in answer.headers["content-disposition"]
    rows = list(csv.reader(io.StringIO(answer.text)))
    table = FIGURES[name].table(house.result)
    assert rows[0] == list(table)
    assert len(rows) == 1 + max(len(column) for column in table.values())


@pytest.mark.parametrize("name", FIGURES)
def test_the_numbers_of_several_runs_come_below_one_another_with_the_run_first(house: House, name: str) -> None:
    first, second, waiting = house.finished(), house.finished(), house.launched()["id"]
    address, client = f"/api/v1/runs/{first}/figures/{name}/data", house.person("victor")
    alone = list(csv.reader(io.StringIO(client.get(address).text)))
    answer = client.get(address, params={"compare": f"{second},{waiting},{second},{first}"})
    both = list(csv.reader(io.StringIO(answer.text)))
    assert f'filename="run-{first}-{second}-{waiting}-{name}.csv"' in answer.headers["content-disposition"]
    assert both[0] == ["run", *alone[0]]
    assert both[1:] == [[str(number), *row] for number in (first, second) for row in alone[1:]]


def test_a_column_that_one_run_lacks_is_empty_in_its_rows() -> None:
    tables = {4: {"frame": [0, 1], "f_m": [0.1, 0.2]}, 7: {}, 9: {"iteration": [0], "f_m": [0.3]}}
    assert _stacked(tables) == {
        "run": [4, 4, 9],
        "frame": [0, 1, None],
        "f_m": [0.1, 0.2, 0.3],
        "iteration": [None, None, 0],
    }


def test_figures_are_listed_with_how_to_read_them(house: House) -> None:
    run_id = house.finished()
    items = house.person("victor").get(f"/api/v1/runs/{run_id}/figures").json()["items"]
    assert [item["name"] for item in items] == list(FIGURES)
    assert all(house.person("victor").get(item["href"]).status_code == 200 for item in items)


def test_an_unknown_figure_names_the_ones_there_are(house: House) -> None:
    answer = house.person("victor").get(f"/api/v1/runs/{house.finished()}/figures/pie")
    assert answer.status_code == 404
    assert "convergence" in answer.json()["detail"]


@pytest.mark.parametrize("compare", ["a", "1;2", ",".join(["1"] * 30)])
def test_runs_to_compare_that_are_none_are_refused(house: House, compare: str) -> None:
    answer = house.person("victor").get(f"/api/v1/runs/{house.finished()}/figures/rms", params={"compare": compare})
    assert answer.status_code == 422
