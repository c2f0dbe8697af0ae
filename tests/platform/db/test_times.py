"""Times: whatever is shown can be typed, in every form, and a browser shows what the server does."""

import json
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.platform.db.times import TIME_FORMS, TimeStyle, list_zones, read_time, utc_text
from tests.effort import effort

MODULE = Path(__file__).parents[3] / "frontend" / "static" / "shared" / "times.js"
ZONES = ("UTC", "Europe/Amsterdam", "America/St_Johns", "Asia/Kathmandu", "Pacific/Kiritimati", "Pacific/Niue")
MOMENTS = st.datetimes(timezones=st.just(UTC))
STYLES = st.builds(TimeStyle, st.sampled_from(TIME_FORMS), st.sampled_from(list_zones()))


@settings(max_examples=effort(300, 3000), deadline=None)
@given(moment=MOMENTS, style=STYLES, mark=st.sampled_from(" T"))
def test_every_time_that_is_shown_can_be_typed(moment, style, mark):
    shown = style.show(moment)
    assert read_time(f" {shown.replace(' ', mark, 1)} ") == utc_text(moment.replace(microsecond=0))


@settings(max_examples=effort(100, 1000), deadline=None)
@given(moment=MOMENTS, style=STYLES.filter(lambda one: one.form != "local"))
def test_fractions_and_minutes_alone_are_taken_in_every_form(moment, style):
    shown = style.show(moment)
    assert read_time(f"{shown[:-1]}.{moment.microsecond:06d}Z") == utc_text(moment)
    assert read_time(shown[:-4]) == utc_text(moment.replace(second=0, microsecond=0))
    assert read_time(f"{shown[:-1]} UTC") == read_time(shown)


def test_each_form_is_as_it_is_documented():
    moment = datetime(2026, 11, 21, 23, 4, 5, tzinfo=UTC)
    shown = [TimeStyle(form, "Europe/Amsterdam").show(moment) for form in TIME_FORMS]
    assert shown == [
        "2026-325 23:04:05Z",
        "2026-11-21 23:04:05Z",
        "2026-11-21 23:04:05Z (2026-11-22 00:04:05+01:00)",
    ]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "soon",
        "2026-366",  # 2026 has 365 days
        "2026-000 00:00Z",
        "2026-3251",
        "2026-11-21 03:04:05Z (05:04:05+01:00)",
        "2026-11-21 23:04:05Z (2026-11-21 00:04:05+01:00)",
        "2026-325 03:04:05Z (04:04:05)",
    ],
)
def test_what_is_no_time_or_two_of_them_is_refused(text):
    with pytest.raises(RefusedInputError):
        read_time(text)


@pytest.mark.few(6)
@pytest.mark.parametrize("form", TIME_FORMS)
@pytest.mark.parametrize("zone", ZONES)
def test_a_browser_shows_a_time_as_the_server_does(form, zone):
    begin = datetime(2023, 12, 30, 21, 59, 58, tzinfo=UTC)
    moments = [begin + timedelta(hours=7.3 * step) for step in range(1500)]
    given = [moment.isoformat(timespec="milliseconds") for moment in moments]
    code = f"""
        globalThis.document = {{ documentElement: {{ dataset: {{ times: "{form}", zone: "{zone}" }} }} }};
        const {{ showTime, showTimes }} = await import("{MODULE.as_uri()}");
        console.log(JSON.stringify({json.dumps(given)}.map((text) => showTime(new Date(text)))));
        console.log(showTimes("from {given[0][:23]}Z until {given[1][:19]}Z, not 2026-13-45T99:99:99Z."));
    """
    done = subprocess.run(["node", "--input-type=module", "-"], input=code, capture_output=True, text=True, check=True)
    shown = [TimeStyle(form, zone).show(moment) for moment in moments]
    assert (
        done.stdout
        == f"{json.dumps(shown, separators=(',', ':'))}\nfrom {shown[0]} until {shown[1]}, not 2026-13-45T99:99:99Z.\n"
    )


@pytest.mark.parametrize(
    "text",
    ["a" + 60 * " " + "b", "x" * 81, "2026-11-21T03:04:05Z" + " (03:04:05+00:00)" * 3, "9999-99-99T99:99:99Z"],
)
def test_a_time_is_short_and_names_at_most_one_other(text):
    with pytest.raises(RefusedInputError):
        read_time(text)


def test_a_long_text_is_refused_before_it_is_looked_at():
    with pytest.raises(RefusedInputError):
        read_time("a" + " " * 10_000_000 + "b")
