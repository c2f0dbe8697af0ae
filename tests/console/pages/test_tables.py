"""Long lists: the address holds the whole view, a heading turns the order, and the file is what is looked at."""

import csv
import io
import re

import pytest

from boresight.console.approvals.pages.approval import REQUESTS
from boresight.console.audit.pages import RECORDS
from boresight.console.list_queries import LISTS
from boresight.console.parameter_sets.pages import SETS as PARAMETER_SETS
from boresight.console.runs.pages.list import RUNS
from boresight.console.telemetry.pages import SETS as TELEMETRY

TABLES = {table.name: table for table in (RUNS, TELEMETRY, PARAMETER_SETS, REQUESTS, RECORDS)}


def rows(answer):
    return list(csv.DictReader(io.StringIO(answer.text)))


def numbers(page):
    return [int(found) for found in re.findall(r'<th scope="row"><a href="/runs/(\d+)"', page)]


@pytest.mark.parametrize("name", TABLES)
def test_every_order_of_a_table_is_one_that_the_database_knows(name):
    orders = {column.sort.removeprefix("-") for column in TABLES[name].columns if column.sort}
    assert orders <= set(LISTS[name].keys)
    assert TABLES[name].sort.removeprefix("-") in orders
    assert any(column.head for column in TABLES[name].columns)


@pytest.mark.parametrize("name", TABLES)
def test_every_order_and_every_column_of_a_table_opens_as_page_and_as_file(site, name):
    table, visitor = TABLES[name], site.visitor("both")
    every = ",".join(column.name for column in table.columns)
    for column in table.columns:
        page = visitor.get(f"{table.address}?sort={column.sort}&columns={every}")
        assert page.count("aria-sort=") <= 1
    assert rows(visitor.send("GET", f"{table.address}.csv?columns={every}")) is not None


def test_a_heading_sorts_by_its_column_and_a_second_press_turns_it_round(site):
    site.add_run(label="Zeta")
    site.add_run(label="alpha")
    visitor = site.visitor("victor")
    address = re.search(r'href="([^"]+)">Label</a>', visitor.get("/runs?state=QUEUED"))[1].replace("&amp;", "&")
    page = visitor.get(address)
    assert numbers(page) == [4, 3]
    assert 'aria-sort="ascending"' in page
    turned = visitor.get(re.search(r'href="([^"]+)">Label</a>', page)[1].replace("&amp;", "&"))
    assert numbers(turned) == [3, 4]
    assert "selected>QUEUED" in turned


def test_the_file_has_the_filters_the_order_and_the_columns_of_the_view(site):
    for label in ("b", "a"):
        site.add_run(label=label, state="FAILED")
    answer = site.visitor("victor").send("GET", "/runs.csv?state=FAILED&sort=label&columns=label,rms&before=1")
    assert answer.text.splitlines()[0] == "run,label,rms_initial_arc_rad,rms_final_arc_rad"
    assert [row["label"] for row in rows(answer)] == ["a", "b"]


def test_columns_are_picked_by_a_plain_form_and_the_row_s_name_always_stays(site):
    picked = site.visitor("victor").get("/runs?columns=state&columns=ended")
    heads = re.findall(r'<th scope="col"[^>]*>.*?</th>', picked)
    assert [re.sub("<[^>]+>", "", head).strip() for head in heads] == ["Select", "State", "Run", "Ended"]
    assert "state,run,ended" in picked


def test_what_is_chosen_stays_chosen_on_another_page_of_the_list(site):
    for number in range(60):
        site.add_run(label=f"many-{number}")
    older = site.visitor("victor").get("/runs?runs=60,1&before=12")
    assert '<input type="checkbox" name="runs" value="1" checked' in older
    assert '<input type="checkbox" name="runs" value="60" checked>' in older.split("data-elsewhere>")[1][:100]


def test_the_address_of_a_view_gives_the_same_view_again(site):
    site.add_run(state="FAILED", label="a pass")
    address = "state=FAILED&q=pass&sort=-rms&columns=run,rms&runs=1,2"
    page = site.visitor("victor").get(f"/runs?{address}")
    assert f"/runs?{address.replace('-rms', 'rms')}".replace("&", "&amp;") in page
    assert '<input type="hidden" name="sort" value="-rms">' in page


@pytest.mark.parametrize("name", TABLES)
def test_nonsense_in_the_address_shows_the_whole_list(site, name):
    visitor, table = site.visitor("victor"), TABLES[name]
    usual = visitor.get(table.address)
    odd = visitor.get(f"{table.address}?sort=-;drop&columns=nothing&before=x&runs=,x&page=9")
    assert odd.count("<tr") == usual.count("<tr")
