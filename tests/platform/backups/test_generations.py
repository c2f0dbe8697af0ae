"""Which backups are kept: of each of the newest days, weeks and months the newest."""

from datetime import UTC, datetime, timedelta

from hypothesis import given
from hypothesis import strategies as st

from boresight.platform.backups.generations import Generations, choose_kept
from boresight.platform.db.sessions import utc_text


def _taken(days: int, start: datetime = datetime(2026, 1, 1, 2, tzinfo=UTC), hours: int = 24) -> list[str]:
    return [utc_text(start + timedelta(hours=hours * number)) for number in range(days * 24 // hours)]


def test_a_year_of_nights_leaves_days_weeks_and_months():
    kept = sorted(choose_kept(_taken(365), Generations(7, 5, 12)))
    days = [datetime.fromisoformat(one).date().isoformat() for one in kept]
    assert days[-7:] == [f"2026-12-{day}" for day in range(25, 32)]
    sundays, ends = ["2026-12-06", "2026-12-13", "2026-12-20"], ["2026-01-31", "2026-02-28", "2026-11-30"]
    assert set(sundays) | set(ends) <= set(days)
    assert len(days) == 7 + 3 + 11  # 27 December and the end of the year are among the days


def test_of_a_day_with_many_the_newest_is_kept():
    kept = choose_kept(_taken(2, hours=6), Generations(2, 0, 0))
    assert sorted(kept) == [f"2026-01-0{day}T20:00:00.000000Z" for day in (1, 2)]


@given(
    st.lists(st.integers(0, 5000), unique=True, min_size=1),
    st.builds(Generations, *[st.integers(0, 9)] * 3),
)
def test_the_newest_always_stays_and_choosing_again_removes_nothing(hours, generations):
    taken = [utc_text(datetime(2026, 1, 1, tzinfo=UTC) + timedelta(hours=hour)) for hour in hours]
    kept = choose_kept(taken, generations)
    assert max(taken) in kept
    assert choose_kept(sorted(kept), generations) == kept
    assert len(kept) <= max(1, generations.daily + generations.weekly + generations.monthly)
