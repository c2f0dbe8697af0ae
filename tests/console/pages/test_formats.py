"""Numbers, times and addresses as they are printed."""

import math
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.console.pages import formats
from boresight.verdicts import numbers
from boresight.verdicts.numbers import MINUS

FINITE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12)


def plain(text: str) -> float:
    raised = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    text = text.replace(numbers.NARROW_SPACE, "").replace(MINUS, "-")
    mantissa, _, power = text.partition("·10")
    return float(mantissa) * 10.0 ** int(power.translate(raised) or 0)


@given(FINITE)
def test_a_printed_number_is_the_number_to_its_digits(value):
    assert plain(numbers.number(value, 6)) == pytest.approx(value, rel=1e-5, abs=1e-300)


@given(FINITE, st.floats(min_value=1e-9, max_value=1e9))
def test_a_parameter_stops_within_the_second_digit_of_its_sigma(value, sigma):
    shown = plain(numbers.parameter(value, "m0_px", sigma))
    assert abs(shown - value) <= 0.05 * sigma + abs(value) * 1e-12


def test_a_parameter_shows_no_digit_that_its_sigma_does_not_know():
    assert numbers.parameter(0.01602671234, "f_m", 8.0e-6) == "16.0267"
    assert numbers.parameter(971.4837, "m0_px", 31.0) == "971"
    assert numbers.parameter(1.2345e8, "b4_per_m4", 2.0e6) == "1.234·10⁸"


def test_a_declared_parameter_is_printed_as_declared():
    assert numbers.parameter(0.016095, "f_m") == "16.095"
    assert numbers.parameter(971.5, "m0_px") == "971.5"
    assert numbers.parameter(0, "a1_rad") == "0"


@pytest.mark.parametrize("value", [None, math.nan, math.inf, True, "text"])
def test_what_is_no_number_is_a_dash(value):
    for print_it in (numbers.number, numbers.fixed, numbers.count, numbers.percent, numbers.urad, numbers.duration):
        assert print_it(value) == numbers.MISSING
    assert numbers.parameter(value, "f_m", 1.0) == numbers.MISSING


def test_a_sigma_that_was_not_estimated_says_fixed():
    assert numbers.sigma(None, "f_m") == "fixed"
    assert numbers.sigma(8.0e-6, "f_m") == "0.0080"


@pytest.mark.parametrize(
    ("name", "unit"), [("f_m", "mm"), ("b2_per_m2", "m⁻²"), ("b4_per_m4", "m⁻⁴"), ("a1_rad", "mrad"), ("g_y", "1")]
)
def test_a_parameter_is_shown_in_the_unit_an_operator_thinks_in(name, unit):
    assert numbers.unit(name) == unit


def test_negative_numbers_have_a_true_minus_and_digits_are_parted():
    assert numbers.fixed(-12345.678, 1) == f"{MINUS}12{numbers.NARROW_SPACE}345.7"
    assert numbers.count(1234567) == f"1{numbers.NARROW_SPACE}234{numbers.NARROW_SPACE}567"


def test_what_rounds_to_nothing_has_no_sign():
    assert numbers.fixed(-0.04, 1) == "0.0"
    assert numbers.fixed(-0.06, 1) == f"{MINUS}0.1"


def test_a_time_has_its_day_of_year_and_its_calendar_date():
    shown = str(formats.utc("2026-11-21T03:04:11.123456Z"))
    assert ">2026-325 03:04:11Z<" in shown
    assert 'title="2026-11-21 03:04:11 UTC"' in shown
    assert formats.utc(None) == numbers.MISSING


def test_an_age_counts_from_the_time_to_now():
    now = datetime.now(UTC)
    assert "2\u202fh ago" in str(formats.age((now - timedelta(hours=2, seconds=5)).isoformat())).replace(
        " 5\u202fs", ""
    )
    assert "just now" in str(formats.age(now.isoformat()))


@given(st.floats(min_value=0, max_value=1e9))
def test_a_duration_names_at_most_two_units(seconds):
    assert numbers.duration(seconds).count(" ") <= 1


def test_a_hash_cannot_break_out_of_its_attribute():
    assert '"><b' not in str(formats.short_hash('"><b>'))
