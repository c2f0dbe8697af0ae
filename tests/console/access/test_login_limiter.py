"""How attempts are slowed down: by name and place together, and by places that try many names."""

import pytest

from boresight.console.access.log_in_attempts import FORGET_S, HELD_S, LoginAttempt, LoginLimiter, place_of_address
from boresight.errors import TooManyAttemptsError


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def limiter(clock: Clock) -> LoginLimiter:
    return LoginLimiter(5, clock)


def _fail(limiter: LoginLimiter, clock: Clock, tried: LoginAttempt) -> float:
    began_s = clock.now_s
    while True:
        try:
            clock.now_s += limiter.admit(tried)
        except TooManyAttemptsError as refusal:
            clock.now_s += refusal.wait_s
            continue
        limiter.ended(tried, failed=True)
        return clock.now_s - began_s


def _tries_in_an_hour(limiter: LoginLimiter, clock: Clock, tried: list[LoginAttempt]) -> int:
    tries, end_s = 0, clock.now_s + 3600.0
    while clock.now_s < end_s:
        for one in tried:
            try:
                limiter.admit(one)
            except TooManyAttemptsError:
                continue
            limiter.ended(one, failed=True)
            tries += 1
        clock.now_s += 1.0
    return tries


def test_failures_slow_down_more_and_more(limiter: LoginLimiter, clock: Clock) -> None:
    waits = [_fail(limiter, clock, LoginAttempt("ana", "1.2.3.4")) for _ in range(13)]
    assert waits == [0, 0, 0, 0, 0, 1, 2, 4, 8, 16, 32, 64, 100]


def test_one_place_has_at_most_about_100_tries_an_hour_at_a_name(limiter: LoginLimiter, clock: Clock) -> None:
    tries, began_s = 0, clock.now_s
    while clock.now_s - began_s <= 3600.0:
        _fail(limiter, clock, LoginAttempt("ana", "1.2.3.4"))
        tries += 1
    assert tries <= 100


def test_nobody_elses_failures_keep_a_person_waiting(limiter: LoginLimiter, clock: Clock) -> None:
    for _ in range(20):
        _fail(limiter, clock, LoginAttempt("cy", "6.6.6.6"))
    for name, place, known in (("cy", "1.2.3.4", True), ("ana", "1.2.3.4", False), ("cy", "session 7", True)):
        assert limiter.admit(LoginAttempt(name, place, known)) == 0.0


def test_an_account_bears_at_most_100_wrong_passwords_an_hour_from_100_strange_places_and_one_known(
    limiter: LoginLimiter, clock: Clock
) -> None:
    strange = [LoginAttempt("cy", f"6.6.6.{number}") for number in range(100)]
    assert _tries_in_an_hour(limiter, clock, [*strange, LoginAttempt("cy", "1.2.3.4", known=True)]) <= 100
    assert limiter.admit(LoginAttempt("cy", "1.2.3.5", known=True)) == 0.0


def test_one_who_types_a_name_at_their_console_has_no_more_tries_from_many_addresses(
    limiter: LoginLimiter, clock: Clock
) -> None:
    beside = [LoginAttempt("cy", f"10.0.0.{number}", known=True, console="person 5") for number in range(50)]
    assert _tries_in_an_hour(limiter, clock, beside) <= 60


def test_many_names_from_a_place_keep_nobody_waiting_who_logged_in_from_there(
    limiter: LoginLimiter, clock: Clock
) -> None:
    for number in range(60):
        _fail(limiter, clock, LoginAttempt(f"name-{number}", "1.2.3.4"))
    assert limiter.admit(LoginAttempt("cy", "1.2.3.4", known=True)) == 0.0
    with pytest.raises(TooManyAttemptsError):
        limiter.admit(LoginAttempt("yet-another", "1.2.3.4"))


def test_what_is_refused_pushes_out_no_count(
    limiter: LoginLimiter, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("boresight.console.access.log_in_attempts.MOST_COUNTS", 200)
    for number in range(34):
        _fail(limiter, clock, LoginAttempt(f"name-{number}", "6.6.6.6"))
    for number in range(1000):
        with pytest.raises(TooManyAttemptsError):
            limiter.admit(LoginAttempt(f"more-{number}", "6.6.6.6"))
    assert len(limiter._counts) == 2 * 34 + 1


def test_a_wait_that_is_long_is_told_and_not_held(limiter: LoginLimiter, clock: Clock) -> None:
    for _ in range(8):
        _fail(limiter, clock, LoginAttempt("ana", "1.2.3.4"))
    with pytest.raises(TooManyAttemptsError) as refusal:
        limiter.admit(LoginAttempt("ana", "1.2.3.4"))
    assert HELD_S < refusal.value.wait_s <= 8


def test_attempts_that_come_at_once_wait_for_each_other(limiter: LoginLimiter) -> None:
    waits = [limiter.admit(LoginAttempt("ana", "1.2.3.4")) for _ in range(7)]
    assert waits == [0, 0, 0, 0, 0, 1, 3]
    with pytest.raises(TooManyAttemptsError):
        limiter.admit(LoginAttempt("ana", "1.2.3.4"))


def test_one_place_that_tries_many_names_is_slowed_down_and_others_are_not(limiter: LoginLimiter, clock: Clock) -> None:
    waits = [_fail(limiter, clock, LoginAttempt(f"name-{number}", "6.6.6.6")) for number in range(36)]
    assert waits[:30] == [0] * 30
    assert waits[30:] == [1, 2, 4, 8, 10, 10]
    assert limiter.admit(LoginAttempt("name-1", "1.2.3.4")) == 0.0


def test_a_right_password_makes_up_for_the_wrong_ones_of_its_name(limiter: LoginLimiter, clock: Clock) -> None:
    for _ in range(6):
        _fail(limiter, clock, LoginAttempt("ana", "1.2.3.4"))
    clock.now_s += limiter.admit(LoginAttempt("ana", "1.2.3.4"))
    limiter.ended(LoginAttempt("ana", "1.2.3.4"), failed=False)
    assert [_fail(limiter, clock, LoginAttempt("ana", "1.2.3.4")) for _ in range(5)] == [0] * 5


def test_a_right_password_over_the_shoulder_makes_up_for_the_wrong_ones_there(
    limiter: LoginLimiter, clock: Clock
) -> None:
    beside = LoginAttempt("cy", "1.2.3.4", known=True, console="person 5")
    for _ in range(6):
        _fail(limiter, clock, beside)
    clock.now_s += limiter.admit(beside)
    limiter.ended(beside, failed=False)
    assert [_fail(limiter, clock, beside) for _ in range(5)] == [0] * 5


def test_after_a_while_failures_are_forgotten(limiter: LoginLimiter, clock: Clock) -> None:
    for _ in range(12):
        _fail(limiter, clock, LoginAttempt("ana", "1.2.3.4"))
    clock.now_s += FORGET_S + 1
    assert limiter.admit(LoginAttempt("ana", "1.2.3.4")) == 0.0


def test_the_counts_do_not_grow_without_bound(limiter: LoginLimiter, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("boresight.console.access.log_in_attempts.MOST_COUNTS", 100)
    for number in range(1000):
        limiter.admit(LoginAttempt(f"name-{number}", f"place-{number}"))
        limiter.ended(LoginAttempt(f"name-{number}", f"place-{number}"), failed=True)
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
def test_an_address_of_ipv6_stands_for_its_network(address: str, place: str) -> None:
    assert place_of_address(address) == place
