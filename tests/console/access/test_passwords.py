"""Passwords that somebody else knows: they let a person do nothing but set another, and never stand for a signature."""

import re
import time
from typing import Any
from unittest.mock import Mock

import pytest
from argon2.exceptions import VerifyMismatchError
from zxcvbn.matching import RANKED_DICTIONARIES

from boresight.console import list_queries as lists
from boresight.console.access import confirmations, passwords, users
from boresight.console.access.log_in_attempts import FORGET_S, HELD_S, LoginAttempt, LoginLimiter, name_network
from boresight.console.access.passwords import describe_weakness, name_password_setter
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals.tables import Approval
from boresight.errors import ForbiddenError, PasswordDueError, RefusedInputError, TooManyAttemptsError
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Engine, open_reading, open_writing
from tests.console.conftest import PASSWORD
from tests.passwords import PRODUCT, add_person, approve, new_password, proved
from tests.refusals import has_code

GIVEN, OWN = "given by the administrator", "known to nobody else"


@pytest.fixture
def cy(engine, people) -> Actor:
    with open_writing(engine) as session:
        users.change_password(session, people["root"], people["cy"].user_id, new_password(GIVEN))
    return people["cy"]


def test_a_reset_is_on_record_as_a_reset(engine, cy):
    with open_reading(engine) as session:
        record = audit.find_last_change(session, f"users/{cy.user_id}")
    assert (record.action, record.actor) == ("reset the password of", "Root")
    assert record.after == {"must_change_password": True}
    assert record.rows is not None


def test_whoever_comes_with_a_given_password_may_only_set_their_own(engine, cy):
    with open_reading(engine) as session, pytest.raises(PasswordDueError, check=has_code("password-due")):
        users.get_actor(session, cy.user_id)
    with open_reading(engine) as session, pytest.raises(PasswordDueError):
        confirmations.require(session, cy, proved(session, cy, GIVEN))
    with open_writing(engine) as session:
        actor = users.get_actor(session, cy.user_id, sets_password=True)
        users.change_password(session, actor, cy.user_id, new_password(OWN), proved(session, cy, GIVEN))
    with open_reading(engine) as session:
        assert users.get_actor(session, cy.user_id).name == "cy"


def test_a_given_password_signs_nothing_and_ones_own_does(engine, cy, submitted):
    row = submitted()
    with open_reading(engine) as session:
        approval = lists.list_newest(session, Approval, set=row.id)[0]

    def sign(password: str) -> None:
        with open_writing(engine) as session:
            approve(session, cy, approval, password=password)

    with pytest.raises(ForbiddenError, check=has_code("password-due")):
        sign(GIVEN)
    with open_writing(engine) as session:
        users.change_password(session, cy, cy.user_id, new_password(OWN), proved(session, cy, GIVEN))
    sign(OWN)


def test_a_person_may_be_added_with_a_password_for_the_first_log_in_only(engine, people):
    with open_writing(engine) as session:
        fay = {"name": "fay", "printed_name": "Fay", "password": new_password(GIVEN), "roles": ["approver"]}
        row = users.create_user(session, people["root"], **fay, must_change_password=True)
        actor = users.authenticate(session, proved(session, "fay", GIVEN))
        assert users.must_change_password(session, actor)
        with pytest.raises(PasswordDueError):
            users.get_actor(session, row.id)


AT = "given by Command line at 2026-11-20T12:00:00Z"
RESET = "reset by Root at 2026-11-20T18:00:00Z"


def _told(engine: Engine, root: Actor, monkeypatch: pytest.MonkeyPatch, *events: tuple[str, str]) -> str | None:
    def at(time: str) -> None:
        monkeypatch.setattr("boresight.platform.audit.chain.utc_now", lambda: f"{time}.000000Z")

    at("2026-11-20T12:00:00")
    with open_writing(engine) as session:
        row = add_person(session, "new", "approver")
        new_id, current = row.id, PASSWORD
        for number, (who, time) in enumerate(events):
            at(time)
            fresh, own = f"{OWN} {number}", who == "new"
            actor = Actor(new_id, "new", "New", frozenset({"approver"}), "session") if own else root
            users.change_password(session, actor, new_id, new_password(fresh), proved(session, actor, current))
            current = fresh
        return name_password_setter(session, new_id)


@pytest.mark.parametrize(
    ("events", "told"),
    [
        ((), f"{AT}, not changed since"),
        ((("new", "2026-11-20T12:00:40"),), f"{AT}, changed 40 s later"),
        ((("new", "2026-11-20T12:03:00"),), f"{AT}, changed 3 min later"),
        ((("new", "2026-11-21T11:59:59"),), f"{AT}, changed 24 h later"),
        ((("new", "2026-11-21T12:00:00"),), None),
        ((("root", "2026-11-20T18:00:00"),), f"{RESET}, not changed since"),
        ((("root", "2026-11-20T18:00:00"), ("new", "2026-11-20T18:03:00")), f"{RESET}, changed 3 min later"),
        (
            (("root", "2026-11-20T18:00:00"), ("new", "2026-11-20T18:03:00"), ("new", "2026-11-20T20:00:00")),
            f"{RESET}, changed 2 h later",
        ),
        ((("new", "2026-11-22T12:00:00"), ("new", "2026-11-22T12:01:00")), None),
    ],
)
def test_who_else_gave_a_password_is_told_until_it_is_long_ones_own(engine, people, monkeypatch, events, told):
    assert _told(engine, people["root"], monkeypatch, *events) == told
    with open_reading(engine) as session:
        assert name_password_setter(session, 4711) == "given by nobody on record"


def test_a_signature_through_a_puppet_says_so_in_its_row_and_on_record(engine, submitted, cy):
    row = submitted()
    with open_writing(engine) as session:  # by who reset it, logged in as Cy
        puppet = users.get_actor(session, cy.user_id, sets_password=True)
        users.change_password(session, puppet, cy.user_id, new_password(OWN), proved(session, puppet, GIVEN))
    with open_writing(engine) as session:
        approval = lists.list_newest(session, Approval, set=row.id)[0]
        signature = approve(session, puppet, approval, password=OWN)
        record = audit.find_last_change(session, f"approvals/{approval.id}")
    assert re.fullmatch(r"reset by Root at \S+Z, changed \d+ s later", str(signature.password_by))
    assert record.after["password_by"] == signature.password_by
    with open_reading(engine) as session:
        assert approval_queries.list_signatures(session, approval.id)[0].password_by == signature.password_by
        assert audit.verify(session).ok


NAMES = ("j.doe", "Jane Q. Doesmith")
COMMONEST = sorted(RANKED_DICTIONARIES["passwords"], key=RANKED_DICTIONARIES["passwords"].get)


def test_the_commonest_passwords_that_satisfy_the_length_rule_are_refused():
    long_enough = [one for one in COMMONEST if len(one) >= passwords.MINIMUM_PASSWORD_LENGTH]
    assert len(COMMONEST) >= 10_000
    assert len(long_enough) > 200
    assert [one for one in long_enough if describe_weakness(one) is None] == []


def test_the_10000_commonest_are_refused_padded_to_the_length_rule():
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
def test_what_is_guessed_early_is_refused(password):
    assert "easy to guess" in str(describe_weakness(password, NAMES))


@pytest.mark.parametrize("password", ["xq ruhige wolken blech", "ruhige-XQ-wolken blech", "ruhige wolken blech.xq"])
def test_a_name_of_two_letters_counts_where_it_stands_as_a_word(password):
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
def test_what_contains_a_name_of_the_person_is_refused(password):
    assert "contains" in str(describe_weakness(password, NAMES))


@pytest.mark.parametrize(
    "password",
    ["correct horse battery", "another good one", "kühl-Mast-7-Kompott", "x" * 20 + "correct horse battery staple"],
)
def test_what_is_hard_to_guess_is_allowed(password):
    assert describe_weakness(password, NAMES) is None


@pytest.mark.parametrize("unit", ["a4@0o1l!|$5s+7tx%2z", "4@31!05$7", "1234567890", "a", "password", "abc123@$!4"])
def test_the_longest_password_is_judged_in_bounded_time(unit):
    began_s = time.process_time()
    describe_weakness((unit * 256)[: passwords.MAXIMUM_PASSWORD_LENGTH], NAMES)
    assert time.process_time() - began_s < 2.0


@pytest.mark.parametrize(
    ("password", "says"),
    [("short", "has 5 characters; use at least 12"), ("a" * 129, "over 128 characters"), ("x\ud800" * 8, "surrogate")],
)
def test_what_cannot_be_a_password_is_refused_in_words(password, says):
    with pytest.raises(RefusedInputError, match=says):
        passwords.prepare(password, *NAMES).hash()


def test_a_password_that_cannot_be_written_proves_nothing_and_costs_as_much():
    for odd in ("\ud800", "x" * 100_000):
        assert not passwords.check(passwords.StoredPassword(), odd).fits


@pytest.mark.usefixtures("product_hashes")
def test_the_parameters_of_the_hash_are_at_least_what_owasp_asks() -> None:
    variant, _, parameters = passwords.prepare("correct horse battery").hash().split("$")[1:4]
    named = dict(part.split("=") for part in parameters.split(","))
    assert variant == "argon2id"
    assert (int(named["m"]) >= 46 * 1024, int(named["t"]) >= 1) == (True, True)


@pytest.fixture
def clock() -> Any:
    clock = Mock(now_s=1000.0)
    clock.side_effect = lambda: clock.now_s
    return clock


@pytest.fixture
def limiter(clock) -> LoginLimiter:
    return LoginLimiter(5, clock)


def _fail(limiter: LoginLimiter, clock: Any, tried: LoginAttempt) -> float:
    began_s = clock.now_s
    while True:
        try:
            clock.now_s += limiter.admit(tried)
        except TooManyAttemptsError as refusal:
            clock.now_s += refusal.wait_s
            continue
        limiter.record_outcome(tried, failed=True)
        return clock.now_s - began_s


def _tries_in_an_hour(limiter: LoginLimiter, clock: Any, tried: list[LoginAttempt]) -> int:
    tries, end_s = 0, clock.now_s + 3600.0
    while clock.now_s < end_s:
        for one in tried:
            try:
                limiter.admit(one)
            except TooManyAttemptsError:
                continue
            limiter.record_outcome(one, failed=True)
            tries += 1
        clock.now_s += 1.0
    return tries


def test_failures_slow_down_more_and_more(limiter, clock):
    waits = [_fail(limiter, clock, LoginAttempt("ana", "1.2.3.4")) for _ in range(13)]
    assert waits == [0, 0, 0, 0, 0, 1, 2, 4, 8, 16, 32, 64, 100]


def test_one_place_has_at_most_about_100_tries_an_hour_at_a_name(limiter, clock):
    tries, began_s = 0, clock.now_s
    while clock.now_s - began_s <= 3600.0:
        _fail(limiter, clock, LoginAttempt("ana", "1.2.3.4"))
        tries += 1
    assert tries <= 100


def test_nobody_elses_failures_keep_a_person_waiting(limiter, clock):
    for _ in range(20):
        _fail(limiter, clock, LoginAttempt("cy", "6.6.6.6"))
    for name, place, known in (("cy", "1.2.3.4", True), ("ana", "1.2.3.4", False), ("cy", "session 7", True)):
        assert limiter.admit(LoginAttempt(name, place, known)) == 0.0


@pytest.mark.full
def test_an_account_bears_at_most_100_wrong_passwords_an_hour_from_100_strange_places_and_one_known(limiter, clock):
    strange = [LoginAttempt("cy", f"6.6.6.{number}") for number in range(100)]
    assert _tries_in_an_hour(limiter, clock, [*strange, LoginAttempt("cy", "1.2.3.4", known=True)]) <= 100
    assert limiter.admit(LoginAttempt("cy", "1.2.3.5", known=True)) == 0.0


def test_one_who_types_a_name_at_their_console_has_no_more_tries_from_many_addresses(limiter, clock):
    beside = [LoginAttempt("cy", f"10.0.0.{number}", known=True, console="person 5") for number in range(50)]
    assert _tries_in_an_hour(limiter, clock, beside) <= 60


def test_many_names_from_a_place_keep_nobody_waiting_who_logged_in_from_there(limiter, clock):
    for number in range(60):
        _fail(limiter, clock, LoginAttempt(f"name-{number}", "1.2.3.4"))
    assert limiter.admit(LoginAttempt("cy", "1.2.3.4", known=True)) == 0.0
    with pytest.raises(TooManyAttemptsError):
        limiter.admit(LoginAttempt("yet-another", "1.2.3.4"))


def test_what_is_refused_pushes_out_no_count(limiter, clock, monkeypatch):
    monkeypatch.setattr("boresight.console.access.log_in_attempts.MOST_COUNTS", 200)
    for number in range(34):
        _fail(limiter, clock, LoginAttempt(f"name-{number}", "6.6.6.6"))
    for number in range(1000):
        with pytest.raises(TooManyAttemptsError):
            limiter.admit(LoginAttempt(f"more-{number}", "6.6.6.6"))
    assert len(limiter._counts) == 2 * 34 + 1


def test_a_wait_that_is_long_is_told_and_not_held(limiter, clock):
    for _ in range(8):
        _fail(limiter, clock, LoginAttempt("ana", "1.2.3.4"))
    with pytest.raises(TooManyAttemptsError) as refusal:
        limiter.admit(LoginAttempt("ana", "1.2.3.4"))
    assert HELD_S < refusal.value.wait_s <= 8


def test_attempts_that_come_at_once_wait_for_each_other(limiter):
    waits = [limiter.admit(LoginAttempt("ana", "1.2.3.4")) for _ in range(7)]
    assert waits == [0, 0, 0, 0, 0, 1, 3]
    with pytest.raises(TooManyAttemptsError):
        limiter.admit(LoginAttempt("ana", "1.2.3.4"))


def test_one_place_that_tries_many_names_is_slowed_down_and_others_are_not(limiter, clock):
    waits = [_fail(limiter, clock, LoginAttempt(f"name-{number}", "6.6.6.6")) for number in range(36)]
    assert waits[:30] == [0] * 30
    assert waits[30:] == [1, 2, 4, 8, 10, 10]
    assert limiter.admit(LoginAttempt("name-1", "1.2.3.4")) == 0.0


@pytest.mark.parametrize(
    "tried", [LoginAttempt("ana", "1.2.3.4"), LoginAttempt("cy", "1.2.3.4", known=True, console="person 5")]
)
def test_a_right_password_or_a_while_makes_up_for_the_wrong_ones_of_its_name(limiter, clock, tried):
    for _ in range(6):
        _fail(limiter, clock, tried)
    clock.now_s += limiter.admit(tried)
    limiter.record_outcome(tried, failed=False)
    assert [_fail(limiter, clock, tried) for _ in range(5)] == [0] * 5
    for _ in range(7):
        _fail(limiter, clock, tried)
    clock.now_s += FORGET_S + 1
    assert limiter.admit(tried) == 0.0


def test_the_counts_do_not_grow_without_bound(limiter, monkeypatch):
    monkeypatch.setattr("boresight.console.access.log_in_attempts.MOST_COUNTS", 100)
    for number in range(1000):
        limiter.admit(LoginAttempt(f"name-{number}", f"place-{number}"))
        limiter.record_outcome(LoginAttempt(f"name-{number}", f"place-{number}"), failed=True)
    assert len(limiter._counts) <= 100


@pytest.mark.parametrize(
    ("address", "place"),
    [
        ("1.2.3.4", "1.2.3.4"),
        ("::ffff:1.2.3.4", "1.2.3.4"),
        ("2001:db8:1:2:3::4", "2001:db8:1:2::/64"),
        ("testclient", "testclient"),
    ],
)
def test_an_address_of_ipv6_stands_for_its_network(address, place):
    assert name_network(address) == place


def test_the_dummy_hash_has_the_costs_of_a_stored_one_and_no_password_fits():
    dummy = passwords.write_dummy_hash(PRODUCT)
    assert not PRODUCT.check_needs_rehash(dummy)
    assert len(dummy) == len(PRODUCT.hash(PASSWORD))
    with pytest.raises(VerifyMismatchError):
        PRODUCT.verify(dummy, "")
