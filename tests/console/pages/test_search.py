"""What the palette finds: anything by a part of its name or by its number, for who is logged in, however strange the text."""

from collections import Counter
from dataclasses import replace

import httpx
import pytest


@pytest.fixture
def found(site):
    site.add_run(label="After the focus step")

    def ask(text):
        answer = site.visitor("victor").send("GET", "/search", params={"q": text})
        assert answer.status_code == 200
        return answer.json()["found"]

    return ask


@pytest.mark.parametrize(
    ("text", "kind", "href"),
    [
        ("st16", "Sensor", "/sensors/1"),
        ("PS-ST16-1-0", "Parameter set", "/parameter-sets/1"),
        ("focus step", "Run", "/runs/3"),
        ("#2", "Run", "/runs/2"),
        ("run 2", "Run", "/runs/2"),
        ("Sensor st16-1", "Sensor", "/sensors/1"),
        ("telemetry set 1", "Telemetry", "/telemetry/1"),
        ("calibration", "Telemetry", "/telemetry/1"),
        ("tolerance", "Setting", "/help/settings#option-match_rule"),
        ("--noise-model", "Setting", "/help/settings#option-noise_model"),
        ("session hours", "Setting", "/help/settings#setting-session_hours"),
        ("BORESIGHT_PORT", "Setting", "/help/settings#setting-port"),
        ("Cramér", "Term", "/help/glossary#term-cramer-rao-bound"),
        ("nees", "Term", "/help/glossary#term-nis"),
        ("condition number", "Term", "/help/glossary#term-condition-number"),
        ("typical sigma", "Term", "/help/glossary#term-typical-sigma"),
        ("tail", "Term", "/help/glossary#term-tail"),
        ("C_SD", "Term", "/help/glossary#term-alignment"),
        ("back-out", "Term", "/help/glossary#term-uplink-package"),
        ("gloss", "Help", "/help/glossary"),
    ],
)
def test_a_part_of_a_name_or_a_number_finds_its_page(found, text, kind, href):
    assert (kind, href) in {(one["kind"], one["href"]) for one in found(text)}


def test_a_kind_before_a_name_keeps_to_it(found):
    assert {one["kind"] for one in found("parameter set st16")} == {"Parameter set"}


@pytest.mark.parametrize("text", ["", "   ", "%", "_", "no such name", "#0", "9" * 30, "x" * 5000, "'; --"])
def test_a_strange_text_finds_nothing_and_harms_nothing(found, text):
    assert found(text) == []


def test_nothing_is_found_for_who_is_not_logged_in(site):
    answer = replace(site.visitor("victor"), cookies=httpx.Cookies()).send("GET", "/search", params={"q": "st16"})
    assert answer.status_code in {303, 401}


@pytest.mark.parametrize("text", ["set", "tolerance", "boresight_", "nees"])
def test_each_setting_and_term_that_is_found_stands_where_its_address_says(site, found, text):
    for one in found(text):
        page, _, place = one["href"].partition("#")
        assert not place or f'id="{place}"' in site.visitor("victor").get(page)


def test_of_no_kind_are_more_than_six_found(found):
    kinds = Counter(one["kind"] for one in found("se"))
    assert kinds["Setting"] == 6
    assert max(kinds.values()) == 6
