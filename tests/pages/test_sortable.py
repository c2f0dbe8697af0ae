"""Short tables that a press on a heading sorts, and the sheet that holds them in narrow windows."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import pytest

STATIC = Path(__file__).parents[2] / "frontend" / "static"


def headings(table):
    return re.findall(r"<th scope=.col.*?</th>", table.partition("</thead>")[0])


@pytest.mark.parametrize("address", ["/sensors", "/users", "/uplink", "/presets"])
def test_a_short_table_is_sorted_by_its_headings(house, address):
    page = house.visitor("adele").get(address)
    assert 'src="/static/sort-table.js"' in page
    tables = re.findall(r"<table class=.data[^>]* data-sortable>.*?</table>", page, re.DOTALL)
    assert tables
    for table in tables:
        assert "data-sort=" in headings(table)[0]
        width = len(headings(table))
        first = table.partition("<tbody>")[2].partition("</tr>")[0]
        assert len(re.findall(r"<t[hd][ >]", first)) == width


def test_numbers_of_sensors_are_sorted_as_numbers(house):
    page = house.visitor("victor").get("/sensors")
    assert '<button type="button" class="plain" data-sort="number">f</button>' in page
    assert 'data-value="0.016' in page


def test_sensors_can_be_had_as_csv(house):
    visitor = house.visitor("victor")
    assert 'href="/sensors.csv" download data-hotkey="e"' in visitor.get("/sensors")
    (row,) = csv.DictReader(io.StringIO(visitor.get("/sensors.csv")))
    assert (row["sensor"], row["camera_model"], row["rows"]) == ("ST16-1", "inverted_wang", "1944")
    assert float(row["f_m"]) == pytest.approx(0.016, rel=0.02)


def test_in_a_narrow_window_counts_stand_off_names_end_in_dots_and_edges_hint_at_more():
    sheet = (STATIC / "frame.css").read_text()
    narrow = sheet.partition("@media (max-width: 900px)")[2]
    assert re.search(r"\.side \.badge { margin-left: var\(--space-2\); }", narrow)
    assert re.search(r"\.label a {[^}]*display: inline-block;[^}]*text-overflow: ellipsis;", narrow)
    assert len(re.findall(r"no-repeat local", narrow)) == 2
