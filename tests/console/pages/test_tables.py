"""Long lists: the address holds the whole view, a heading turns the order, and the file is what is looked at."""

import csv
import io
import json
import math
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from html import unescape
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.console.alarms.pages import ALARMS
from boresight.console.approvals.pages.approval import REQUESTS
from boresight.console.audit.pages import RECORDS
from boresight.console.campaigns.pages import CAMPAIGNS
from boresight.console.change_proposals.pages import PROPOSALS
from boresight.console.fleet.pages import sensors
from boresight.console.fleet.pages.sensors import EXAMPLE
from boresight.console.list_queries import LISTS
from boresight.console.pages import formats
from boresight.console.pages.drawings import (
    MARGIN,
    SPARKLINE_HEIGHT,
    SPARKLINE_WIDTH,
    detector_map,
    histogram,
    number_bars,
    round_steps,
    sparkline,
)
from boresight.console.pages.rendering import TEMPLATES
from boresight.console.parameter_sets.pages import SETS as PARAMETER_SETS
from boresight.console.runs.pages.list import RUNS
from boresight.console.telemetry.pages import SETS as TELEMETRY
from boresight.console.uplinks.pages.steps import BOARDS
from boresight.platform.db.times import STYLE
from boresight.telemetry.quality.report import DetectorCoverage, Distribution
from boresight.verdicts import numbers as verdict_numbers
from boresight.verdicts.numbers import MINUS

TABLES = {
    table.address.strip("/"): table
    for table in (RUNS, TELEMETRY, PARAMETER_SETS, REQUESTS, RECORDS, ALARMS, CAMPAIGNS, PROPOSALS, BOARDS)
}
WITHOUT_FILE = {"change-proposals", "uplink"}


def rows(answer):
    return list(csv.DictReader(io.StringIO(answer.text)))


def numbers(page):
    return [int(found) for found in re.findall(r'<th scope="row"><a href="/runs/(\d+)"', page)]


@pytest.mark.parametrize("name", TABLES)
def test_every_order_of_a_table_is_one_that_the_database_knows(name):
    sort_keys = {column.sort.removeprefix("-") for column in TABLES[name].columns if column.sort}
    assert sort_keys <= set(LISTS[TABLES[name].name].keys)
    assert TABLES[name].sort.removeprefix("-") in sort_keys
    assert any(column.head for column in TABLES[name].columns)


@pytest.mark.few(4)
@pytest.mark.parametrize("name", TABLES)
def test_every_order_and_every_column_of_a_table_opens_as_page_and_as_file(site, name):
    table, visitor = TABLES[name], site.visitor("both")
    every = ",".join(column.name for column in table.columns)
    for column in table.columns:
        page = visitor.get(f"{table.address}?sort={column.sort}&columns={every}")
        assert page.count("aria-sort=") <= 1
    if name not in WITHOUT_FILE:
        assert rows(visitor.send("GET", f"{table.address}.csv?columns={every}")) is not None


def test_a_heading_sorts_by_its_column_a_second_press_turns_it_round_and_the_file_has_the_view(site):
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
    answer = visitor.send("GET", "/runs.csv?state=QUEUED&sort=label&columns=label,rms&before=1")
    assert answer.text.splitlines()[0] == "run,label,rms_initial_arc_rad,rms_final_arc_rad"
    assert [row["label"] for row in rows(answer)] == ["alpha", "Zeta"]


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


STATIC = Path(__file__).parents[3] / "frontend" / "static"


def headings(table):
    return re.findall(r"<th scope=.col.*?</th>", table.partition("</thead>")[0])


@pytest.mark.parametrize("address", ["/users", "/presets"])
def test_a_short_table_is_sorted_by_its_headings(site, address):
    page = site.visitor("adele").get(address)
    assert '/shared/sort-table.js"' in page
    tables = re.findall(r"<table class=.data[^>]* data-sortable>.*?</table>", page, re.DOTALL)
    assert tables
    for table in tables:
        assert "data-sort=" in headings(table)[0]
        width = len(headings(table))
        first = table.partition("<tbody>")[2].partition("</tr>")[0]
        assert len(re.findall(r"<t[hd][ >]", first)) == width


def list_names(page):
    return re.findall(r'<a href="/sensors/\d+">([^<]*)</a>', page.partition("<tbody")[2])


@pytest.fixture
def fleet(site):
    visitor = site.visitor("ada")
    for name, f_m, rows in (("A-1", 0.02, 500), ("A-2", 0.03, 9000), ("B-3", 0.05, 600), ("B-4", 0.04, 700)):
        document = json.loads(EXAMPLE) | {"name": name}
        document["initial"] |= {"f_m": f_m, "m0_px": rows / 2}
        document["detector"]["rows"] = rows
        assert visitor.post("/sensors", document=json.dumps(document)).status_code == 303


@pytest.mark.few(5)
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
    assert list_names(visitor.get(f"/sensors{query}")) == names
    assert [row["sensor"] for row in csv.DictReader(io.StringIO(visitor.get(f"/sensors.csv{query}")))] == names


@pytest.mark.usefixtures("fleet")
def test_a_long_list_of_sensors_comes_page_by_page_and_says_how_many_stand_so(site, read, monkeypatch):
    monkeypatch.setattr(sensors, "SENSORS", replace(sensors.SENSORS, rows_a_page=2))
    visitor, address, seen = site.visitor("victor"), "/sensors?sort=-f", []
    while address:
        page = visitor.get(address)
        seen.append(list_names(page))
        following = re.search(r'<a href="([^"]*)" rel="next">Further sensors', page)
        address = following and unescape(following[1])
    assert seen == [["B-3", "B-4"], ["A-2", "A-1"], ["ST16-1"]]
    assert "5 registered" in read(visitor.get("/sensors"))
    assert re.search("5 registered; 4 with status NO TELEMETRY", read(visitor.get("/sensors?status=off")))


def test_a_csv_of_sensors_has_the_fields_of_the_columns_that_are_picked(site):
    visitor = site.visitor("victor")
    address = re.search(r'<a href="(/sensors\?status=\w+)">1</a>', visitor.get("/"))[1]
    assert list_names(visitor.get(address)) == ["ST16-1"]  # the overview leads from a count to the sensors behind it
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


FINITE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12)


def plain(text: str) -> float:
    raised = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    text = text.replace(verdict_numbers.NARROW_SPACE, "").replace(MINUS, "-")
    mantissa, _, power = text.partition("·10")
    return float(mantissa) * 10.0 ** int(power.translate(raised) or 0)


@given(FINITE)
def test_a_printed_number_is_the_number_to_its_digits(value):
    assert plain(verdict_numbers.number(value, 6)) == pytest.approx(value, rel=1e-5, abs=1e-300)


@given(FINITE, st.floats(min_value=1e-9, max_value=1e9))
def test_a_parameter_stops_within_the_second_digit_of_its_sigma(value, sigma):
    shown = plain(verdict_numbers.parameter(value, "m0_px", sigma))
    assert abs(shown - value) <= 0.05 * sigma + abs(value) * 1e-12


def test_a_parameter_has_its_unit_and_no_digit_that_its_sigma_does_not_know_or_all_that_were_declared():
    assert verdict_numbers.parameter(0.01602671234, "f_m", 8.0e-6) == "16.0267"
    assert verdict_numbers.parameter(971.4837, "m0_px", 31.0) == "971"
    assert verdict_numbers.parameter(1.2345e8, "b4_per_m4", 2.0e6) == "1.234·10⁸"
    declared = {("f_m", 0.016095): "16.095", ("m0_px", 971.5): "971.5", ("a1_rad", 0): "0"}
    assert {given: verdict_numbers.parameter(given[1], given[0]) for given in declared} == declared
    assert verdict_numbers.sigma(None, "f_m") == "fixed"
    assert verdict_numbers.sigma(8.0e-6, "f_m") == "0.0080"
    units = {"f_m": "mm", "b2_per_m2": "m⁻²", "b4_per_m4": "m⁻⁴", "a1_rad": "mrad", "g_y": ""}
    assert {name: verdict_numbers.unit(name) for name in units} == units


@pytest.mark.parametrize("value", [None, math.nan, math.inf, True, "text"])
def test_what_is_no_number_is_a_dash(value):
    for print_it in (
        verdict_numbers.number,
        verdict_numbers.fixed,
        verdict_numbers.count,
        verdict_numbers.percent,
        verdict_numbers.urad,
        verdict_numbers.duration,
    ):
        assert print_it(value) == verdict_numbers.MISSING
    assert verdict_numbers.parameter(value, "f_m", 1.0) == verdict_numbers.MISSING


def test_negative_numbers_have_a_true_minus_and_digits_are_parted():
    assert verdict_numbers.fixed(-12345.678, 1) == f"{MINUS}12{verdict_numbers.NARROW_SPACE}345.7"
    assert verdict_numbers.count(1234567) == f"1{verdict_numbers.NARROW_SPACE}234{verdict_numbers.NARROW_SPACE}567"


def test_what_rounds_to_nothing_has_no_sign_and_a_hash_stays_in_its_attribute():
    assert verdict_numbers.fixed(-0.04, 1) == "0.0"
    assert verdict_numbers.fixed(-0.06, 1) == f"{MINUS}0.1"
    assert '"><b' not in str(formats.short_hash('"><b>'))


def test_a_time_has_its_day_of_year_and_its_calendar_date():
    shown = str(formats.time_element("2026-11-21T03:04:11.123456Z", STYLE))
    assert ">2026-325 03:04:11Z<" in shown
    assert 'title="2026-11-21 03:04:11Z"' in shown
    assert formats.time_element(None, STYLE) == verdict_numbers.MISSING


def test_an_age_counts_from_the_time_to_now():
    now = datetime.now(UTC)
    assert "2\u202fh ago" in _age((now - timedelta(hours=2, seconds=5)).isoformat()).replace(" 5\u202fs", "")
    assert "just now" in _age(now.isoformat())


def _age(text: str) -> str:
    return TEMPLATES.from_string("{{ text | age }}").render(text=text)


@given(st.floats(min_value=0, max_value=1e9))
def test_a_duration_names_at_most_two_units(seconds):
    assert verdict_numbers.duration(seconds).count(" ") <= 1


WORDS = {"name": "n", "title": "t", "x_title": "x", "y_title": "y"}


@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=40))
def test_bars_are_as_high_as_their_counts(counts):
    drawing = histogram(list(range(len(counts) + 1)), counts, **WORDS)
    tallest = max(drawing.bars, key=lambda bar: bar.count)
    for bar in drawing.bars:
        assert bar.height * max(tallest.count, 1) == pytest.approx(tallest.height * bar.count)
        assert bar.y + bar.height == pytest.approx(drawing.bottom)
    assert [count for _, count in drawing.rows] == counts


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_ticks_are_round_and_inside(low, span):
    steps = round_steps(low, low + span)
    assert 1 <= len(steps) <= 12
    assert all(low - 1e-6 * span <= step <= low + span + 1e-6 * span for step in steps)


def test_an_axis_reaches_the_corner_though_the_data_end_before():
    drawing = histogram([0, 10, 20], [1, 1], **WORDS, extent=40.0, mark=(20.0, "no data beyond"))
    assert drawing.bars[-1].x + drawing.bars[-1].width < drawing.right - 100
    assert drawing.mark_x == pytest.approx(drawing.bars[-1].x + drawing.bars[-1].width, abs=1.0)


def test_an_empty_cell_is_marked_and_a_full_one_is_opaque():
    edges = [-0.5, 9.5, 19.5]
    coverage = DetectorCoverage(row_edges_px=edges, col_edges_px=edges, counts=[[0, 4], [2, 1]])
    bars = detector_map(coverage).bars
    assert [bar.opacity for bar in bars][:2] == [0.0, 1.0]
    assert bars[2].opacity > bars[3].opacity > 0
    assert bars[0].y < bars[2].y  # row 0 is on top


def test_a_number_that_never_occurs_keeps_its_place():
    drawing = number_bars(Distribution(smallest=3, median=6.0, largest=6, stars=[3, 6], exposures=[10, 20]), **WORDS)
    assert drawing.rows == [("3", 10), ("4", 0), ("5", 0), ("6", 20)]


@given(st.lists(st.floats(1e-7, 1e-2), min_size=1, max_size=40))
def test_every_point_is_inside_and_the_last_is_marked(values):
    drawn = sparkline(values)
    points = [tuple(map(float, pair)) for pair in re.findall(r"([\d.]+) ([\d.]+)", drawn.path)]
    assert len(points) == drawn.count == len(values)
    assert all(
        MARGIN <= x <= SPARKLINE_WIDTH - MARGIN + 0.05 and MARGIN <= y <= SPARKLINE_HEIGHT - MARGIN for x, y in points
    )
    assert abs(points[-1][0] - drawn.x) < 0.1
    assert abs(points[-1][1] - drawn.y) < 0.1


def test_larger_is_higher_and_nothing_is_nothing():
    drawn = sparkline([1.0, 2.0])
    assert drawn.path.startswith(f"M{MARGIN:.1f} {SPARKLINE_HEIGHT - MARGIN:.1f}")
    assert drawn.y == MARGIN
    assert sparkline([3.0, 3.0]).y == SPARKLINE_HEIGHT / 2
    assert sparkline([]) is None


def test_a_scatter_of_a_percent_does_not_fill_the_height():
    drawn = sparkline([8.2e-5, 8.28e-5, 8.2e-5, 8.28e-5])
    heights = [float(y) for _, y in re.findall(r"([\d.]+) ([\d.]+)", drawn.path)]
    assert max(heights) - min(heights) < (SPARKLINE_HEIGHT - 2 * MARGIN) / 4
    assert sparkline([0.0, 0.0]).y == SPARKLINE_HEIGHT / 2
