"""What the palette finds: anything by a part of its name or by its number, for who is logged in, however strange the text."""

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
        ("calibration", "Telemetry", "/telemetry/1"),
    ],
)
def test_a_part_of_a_name_or_a_number_finds_its_page(found, text, kind, href):
    assert (kind, href) in {(one["kind"], one["href"]) for one in found(text)}


@pytest.mark.parametrize("text", ["", "   ", "%", "_", "no such name", "#0", "9" * 30, "x" * 5000, "'; --"])
def test_a_strange_text_finds_nothing_and_harms_nothing(found, text):
    assert found(text) == []


def test_nothing_is_found_for_who_is_not_logged_in(site):
    answer = replace(site.visitor("victor"), cookies=httpx.Cookies()).send("GET", "/search", params={"q": "st16"})
    assert answer.status_code in {303, 401}
