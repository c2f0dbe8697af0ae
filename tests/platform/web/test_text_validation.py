"""Names are stored in one form: what looks alike is alike, and nothing in them is hidden."""

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.platform.web.text_validation import LONGEST_NAME, is_hidden, normal_name


@pytest.mark.parametrize(
    ("given_name", "stored"),
    [
        ("cafe\u0301.csv", "caf\u00e9.csv"),
        ("\uff50ass 12.csv", "pass 12.csv"),
        (" pass\u00a0 12.csv ", "pass 12.csv"),
        ("\ufb01le.csv", "file.csv"),
    ],
)
def test_a_name_is_stored_in_its_normal_form(given_name: str, stored: str) -> None:
    assert normal_name("file name", given_name) == stored


@pytest.mark.parametrize(
    "letter",
    [
        "\x00", "\t", "\x7f", "\u00ad", "\u034f", "\u115f", "\u200b", "\u200e", "\u202e", "\u2028",
        "\u2060", "\u2066", "\u2800", "\u3164", "\ud800", "\ue000", "\ufe0f", "\ufeff", "\uffff", "\U000e0041", "\U000e0100",
    ],
)  # fmt: skip
def test_a_character_that_is_not_seen_or_turns_the_writing_is_refused(letter: str) -> None:
    with pytest.raises(RefusedInputError):
        normal_name("file name", f"invoice{letter}vsc.exe")


def test_a_name_of_255_characters_is_taken_and_one_of_256_is_not() -> None:
    assert normal_name("file name", "n" * 255) == "n" * 255
    with pytest.raises(RefusedInputError, match="256"):
        normal_name("file name", "n" * 256)
    with pytest.raises(RefusedInputError):
        normal_name("file name", "\ufdfa" * 20)  # its normal form has 18 characters


@given(st.text(max_size=40))
def test_a_normal_form_is_its_own_normal_form(text: str) -> None:
    try:
        name = normal_name("name", text)
    except RefusedInputError:
        return
    assert normal_name("name", name) == name == unicodedata.normalize("NFKC", name)
    assert len(name) <= LONGEST_NAME
    assert not any(is_hidden(letter) for letter in name)
