"""Which passwords are refused: those guessed early, however they are dressed, and those made of the person's names."""

import time

import pytest
from zxcvbn.matching import RANKED_DICTIONARIES

from boresight.console.access import passwords
from boresight.console.access.passwords import describe_weakness
from boresight.errors import RefusedInputError

NAMES = ("j.doe", "Jane Q. Doesmith")
COMMONEST = sorted(RANKED_DICTIONARIES["passwords"], key=RANKED_DICTIONARIES["passwords"].get)


def test_the_commonest_passwords_that_satisfy_the_length_rule_are_refused() -> None:
    long_enough = [one for one in COMMONEST if len(one) >= passwords.MINIMUM_PASSWORD_LENGTH]
    assert len(COMMONEST) >= 10_000
    assert len(long_enough) > 200
    assert [one for one in long_enough if describe_weakness(one) is None] == []


def test_the_10000_commonest_are_refused_padded_to_the_length_rule() -> None:
    sample = COMMONEST[:10_000:97]  # all of them take minutes
    for padded in (lambda one: one * -(-12 // len(one)), lambda one: one.ljust(12, "1")):
        accepted = [padded(one) for one in sample if describe_weakness(padded(one)) is None]
        assert len(accepted) <= 0.02 * len(sample), accepted


@pytest.mark.parametrize(
    "password",
    [
        "password1234",
        "Password1234!",
        "P@ssw0rd1234",
        "passwordpassword",
        "qwertyuiop12",
        "123456789012",
        "aaaaaaaaaaaa",
        "abcabcabcabc",
        "\uff50assword1234",
        "november2026",
        "a" * 128,
        "password" * 32,
    ],
)
def test_what_is_guessed_early_is_refused(password: str) -> None:
    assert "guessed early" in str(describe_weakness(password, NAMES))


@pytest.mark.parametrize("password", ["xq ruhige wolken blech", "ruhige-XQ-wolken blech", "ruhige wolken blech.xq"])
def test_a_name_of_two_letters_counts_where_it_stands_as_a_word(password: str) -> None:
    assert describe_weakness(password, ("xq",)) is not None
    assert describe_weakness(password.lower().replace("xq", "xqu"), ("xq",)) is None


@pytest.mark.parametrize(
    "password",
    [
        "j.doe-horse-battery",
        "horse-J.DOE-battery",
        "horse-jdoe-battery-7",
        "eod.j horse battery",
        "my DOESMITH battery!",
        "htimseod battery x!",
        "janeq.doesmith horse",
        "\uff2a.\uff44oe horse battery",
    ],
)
def test_what_contains_a_name_of_the_person_is_refused(password: str) -> None:
    assert "contains" in str(describe_weakness(password, NAMES))


@pytest.mark.parametrize(
    "password",
    ["correct horse battery", "another good one", "kühl-Mast-7-Kompott", "x" * 20 + "correct horse battery staple"],
)
def test_what_is_hard_to_guess_is_allowed(password: str) -> None:
    assert describe_weakness(password, NAMES) is None


@pytest.mark.parametrize("unit", ["a4@0o1l!|$5s+7tx%2z", "4@31!05$7", "1234567890", "a", "password", "abc123@$!4"])
def test_the_longest_password_is_judged_in_bounded_time(unit: str) -> None:
    began_s = time.process_time()
    describe_weakness((unit * 256)[: passwords.MAXIMUM_PASSWORD_LENGTH], NAMES)
    assert time.process_time() - began_s < 2.0


@pytest.mark.parametrize(
    ("password", "says"),
    [("short", "has 5 characters; use at least 12"), ("a" * 129, "over 128 characters"), ("x\ud800" * 8, "surrogate")],
)
def test_what_cannot_be_a_password_is_refused_in_words(password: str, says: str) -> None:
    with pytest.raises(RefusedInputError, match=says):
        passwords.prepare(password, *NAMES).hash()


def test_a_password_that_cannot_be_written_proves_nothing_and_costs_as_much() -> None:
    for odd in ("\ud800", "x" * 100_000):
        assert not passwords.check(passwords.StoredPassword(), odd).fits


@pytest.mark.usefixtures("product_hashes")
def test_the_parameters_of_the_hash_are_at_least_what_owasp_asks() -> None:
    variant, _, parameters = passwords.prepare("correct horse battery").hash().split("$")[1:4]
    named = dict(part.split("=") for part in parameters.split(","))
    assert variant == "argon2id"
    assert (int(named["m"]) >= 46 * 1024, int(named["t"]) >= 1) == (True, True)
