"""Numbers as they are printed: to the digits that are known."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.verdicts.numbers import MINUS, QUANTITIES, quantity, to_second_digit, with_reach


@given(
    st.floats(allow_nan=False, min_value=-1e12, max_value=1e12),
    st.floats(min_value=1e-9, max_value=1e9),
    st.sampled_from([1e5, 1e7]),
)
def test_a_value_stops_within_the_second_digit_of_its_sigma_whatever_is_large(value, sigma, large):
    text = to_second_digit(value, sigma, large)
    assert abs(float(text) - value) <= 0.05 * sigma + abs(value) * 1e-12
    assert ("e" in text) == (abs(float(text)) >= large)


@pytest.mark.parametrize(
    ("name", "letters"),
    [
        ("f_m", ("f", "")),
        ("m0_px", ("m", "0")),
        ("g_y", ("g", "y")),
        ("k1", ("k", "1")),
        ("tilt_rad", ("tilt_rad", "")),
    ],
)
def test_a_symbol_is_a_letter_and_its_index_and_a_word_stays_whole(name, letters):
    assert quantity(name).letters == letters


@pytest.mark.parametrize("item", QUANTITIES.values(), ids=QUANTITIES)
def test_every_symbol_of_the_table_is_one_letter_with_an_index_or_none(item):
    assert len(item.letters[0]) == 1


def test_a_large_value_and_its_reach_share_one_power_of_ten():
    assert with_reach(1.033e8, 1.4e6, 1.4e6) == "(1.033 ± 0.014)·10⁸"
    assert with_reach(-2.1e8, 3 * 1.9e6, 1.9e6) == f"({MINUS}2.100 ± 0.057)·10⁸"
    assert with_reach(0.0, 4.2e7, 1.4e7) == "(0.0 ± 4.2)·10⁷"
    assert with_reach(16.0265, 0.0011, 0.0011) == "16.0265 ± 0.0011"


@given(
    st.floats(allow_nan=False, min_value=-1e12, max_value=1e12),
    st.floats(min_value=1e-6, max_value=1e9),
    st.sampled_from([1.0, 3.0]),
)
def test_value_and_reach_are_written_alike(value, sigma, times):
    text = with_reach(value, times * sigma, sigma)
    left, right = text.split(" ± ")
    assert ("·10" in text) == text.startswith("(")
    assert "·10" not in left
    assert len(left.rpartition(".")[2]) == len(right.partition(")")[0].rpartition(".")[2]) or "." not in text
