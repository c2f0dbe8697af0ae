"""The list of runs."""

import csv
import io

import pytest


def test_a_row_says_how_much_the_rms_fell_in_microradians(site, read, results):
    house_page = read(site.visitor("victor").get("/runs"))
    rms = results["batch"]["rms_arc_rad"]
    assert f"{rms['initial'] * 1e6:.1f} → {rms['final'] * 1e6:.2f}" in house_page
    assert f"{100 * (rms['final'] / rms['initial'] - 1):.1f}".lstrip("-") in house_page
    assert "SUCCEEDED" in house_page
    assert "converged" in house_page


def test_a_fit_with_advice_is_a_caution_in_the_list_with_the_advice_at_hand(site, results):
    doubted = results["batch"] | {"advice": ["Too few frames took part."]}
    site.add_run(state="SUCCEEDED", result=doubted)
    page = site.visitor("victor").get("/runs")
    cell = page[page.index('title="Too few frames took part."') :][:400].split("</td>")[0]
    assert "converged, with reservations" in cell
    assert "status-caution" in cell
    page = site.visitor("victor").get("/sensors/1")
    assert "converged, with reservations" in page
    assert "reservations" not in site.visitor("victor").send("GET", "/runs.csv").text


def test_filters_leave_out_the_runs_that_do_not_fit(site, read):
    site.add_run("sqrf", state="FAILED", reason="No stars.", label="the poor one")
    page = site.visitor("victor").get("/runs?state=FAILED&method=sqrf")
    assert "the poor one" in read(page)
    assert "reference" not in read(page)
    assert "<option selected>FAILED" in page


def test_filters_that_fit_nothing_offer_to_show_everything(site):
    assert 'class="empty"' in site.visitor("victor").get("/runs?state=LOST")


@pytest.mark.parametrize("query", ["sensor=abc", "state=NONSENSE", "method=", "before=x"])
def test_an_address_with_nonsense_shows_the_whole_list(site, query, read):
    assert "#1" in read(site.visitor("victor").get(f"/runs?{query}"))


def test_a_second_page_begins_where_the_first_ended(site):
    for number in range(55):
        site.add_run(label=f"many-{number}")
    page = site.visitor("victor").get("/runs")
    assert "many-54" in page
    assert "many-0<" not in page
    address = page.split('rel="next"')[0].rsplit('href="', 1)[1].split('"')[0].replace("&amp;", "&")
    older = site.visitor("victor").get(address)
    assert "many-0<" in older
    assert "many-54" not in older


def test_the_csv_has_every_run_in_si_and_no_formula(site, results):
    site.add_run(label="=cmd()")
    answer = site.visitor("victor").send("GET", "/runs.csv")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert answer.headers["content-type"].startswith("text/csv")
    assert [row["run"] for row in rows] == ["3", "2", "1"]
    assert rows[0]["label"] == "'=cmd()"
    assert float(rows[2]["rms_final_arc_rad"]) == results["batch"]["rms_arc_rad"]["final"]


def test_the_list_is_not_shown_to_who_is_not_logged_in(site):
    stranger = site.visitor("victor")
    stranger.cookies = {}
    assert stranger.send("GET", "/runs").status_code in {303, 401}
