"""Short tables that a press on a heading sorts, the list of sensors, and the sheet that holds them in narrow windows."""

import csv
import io
import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import pytest

from boresight.console.fleet.pages import sensors
from boresight.console.fleet.pages.sensors import EXAMPLE

STATIC = Path(__file__).parents[3] / "frontend" / "static"


def headings(table):
    return re.findall(r"<th scope=.col.*?</th>", table.partition("</thead>")[0])


@pytest.mark.parametrize("address", ["/users", "/uplink", "/presets"])
def test_a_short_table_is_sorted_by_its_headings(site, address):
    page = site.visitor("adele").get(address)
    assert 'src="/static/shared/sort-table.js"' in page
    tables = re.findall(r"<table class=.data[^>]* data-sortable>.*?</table>", page, re.DOTALL)
    assert tables
    for table in tables:
        assert "data-sort=" in headings(table)[0]
        width = len(headings(table))
        first = table.partition("<tbody>")[2].partition("</tr>")[0]
        assert len(re.findall(r"<t[hd][ >]", first)) == width


def names_of(page):
    return re.findall(r'<a href="/sensors/\d+">([^<]*)</a>', page.partition("<tbody")[2])


@pytest.fixture
def fleet(site):
    visitor = site.visitor("ada")
    for name, f_m, rows in (("A-1", 0.02, 500), ("A-2", 0.03, 9000), ("B-3", 0.05, 600), ("B-4", 0.04, 700)):
        document = json.loads(EXAMPLE) | {"name": name}
        document["initial"] |= {"f_m": f_m, "m0_px": rows / 2}
        document["detector"]["rows"] = rows
        assert visitor.post("/sensors", document=json.dumps(document)).status_code == 303


@pytest.mark.usefixtures("fleet")
@pytest.mark.parametrize(
    ("query", "names"),
    [
        ("", ["A-1", "A-2", "B-3", "B-4", "ST16-1"]),
        ("?sort=-sensor", ["ST16-1", "B-4", "B-3", "A-2", "A-1"]),
        ("?sort=-f", ["B-3", "B-4", "A-2", "A-1", "ST16-1"]),
        ("?sort=-detector", ["A-2", "ST16-1", "B-4", "B-3", "A-1"]),
        ("?sort=-sets&q=1", ["ST16-1", "A-1"]),
        ("?q=b-", ["B-3", "B-4"]),
        ("?q=%25", []),
        ("?status=off", ["A-1", "A-2", "B-3", "B-4"]),
        ("?status=off&q=a", ["A-1", "A-2"]),
        ("?status=critical", []),
        ("?status=nonsense&sort=nonsense", ["A-1", "A-2", "B-3", "B-4", "ST16-1"]),
    ],
)
def test_sensors_are_narrowed_and_sorted_and_had_so_as_csv(site, query, names):
    visitor = site.visitor("victor")
    assert names_of(visitor.get(f"/sensors{query}")) == names
    assert [row["sensor"] for row in csv.DictReader(io.StringIO(visitor.get(f"/sensors.csv{query}")))] == names


@pytest.mark.usefixtures("fleet")
def test_a_long_list_of_sensors_comes_page_by_page(site, monkeypatch):
    monkeypatch.setattr(sensors, "SENSORS", replace(sensors.SENSORS, rows_a_page=2))
    visitor, address, seen = site.visitor("victor"), "/sensors?sort=-f", []
    while address:
        page = visitor.get(address)
        seen.append(names_of(page))
        following = re.search(r'<a href="([^"]*)" rel="next">Further sensors', page)
        address = following and unescape(following[1])
    assert seen == [["B-3", "B-4"], ["A-2", "A-1"], ["ST16-1"]]


@pytest.mark.usefixtures("fleet")
def test_the_list_says_how_many_are_registered_and_how_many_stand_so(site, read):
    visitor = site.visitor("victor")
    assert "5 registered" in read(visitor.get("/sensors"))
    assert "5 registered, of which 4 NO DATA" in read(visitor.get("/sensors?status=off"))


def test_the_overview_leads_from_a_count_to_the_sensors_behind_it(site):
    page = site.visitor("victor").get("/")
    address = re.search(r'<a href="(/sensors\?status=\w+)">1</a>', page)[1]
    assert names_of(site.visitor("victor").get(address)) == ["ST16-1"]


def test_a_csv_of_sensors_has_the_fields_of_the_columns_that_are_picked(site):
    visitor = site.visitor("victor")
    assert 'href="/sensors.csv?" download data-hotkey="e"' in visitor.get("/sensors")
    (row,) = csv.DictReader(io.StringIO(visitor.get("/sensors.csv")))
    assert (row["sensor"], row["camera_model"], row["rows"]) == ("ST16-1", "inverted_wang", "1944")
    assert float(row["f_m"]) == pytest.approx(0.016, rel=0.02)
    (row,) = csv.DictReader(io.StringIO(visitor.get("/sensors.csv?columns=f")))
    assert set(row) == {"number", "sensor", "simulated", "f_m"}


def test_in_a_narrow_window_counts_stand_off_names_end_in_dots_and_edges_hint_at_more():
    sheet = (STATIC / "shared" / "style.css").read_text()
    narrow = sheet.partition("@media (max-width: 900px)")[2]
    assert re.search(r"\.side \.badge { margin-left: var\(--space-2\); }", narrow)
    assert re.search(r"\.label a {[^}]*display: inline-block;[^}]*text-overflow: ellipsis;", narrow)
    assert len(re.findall(r"no-repeat local", narrow)) == 2
