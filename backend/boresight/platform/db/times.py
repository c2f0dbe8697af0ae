"""Times: as the store writes them, as people have them shown, and as people type them.

The store has text in one form, `2026-11-21T03:04:05.123456Z`, which sorts as time. Pages show a time in the form that a person
chose, by `TimeStyle.show`: with its day of year, by the calendar (ISO 8601), or by the calendar with local time beside it.

    2026-325 03:04:05Z    2026-11-21 03:04:05Z    2026-11-21 03:04:05Z (04:04:05+01:00)

`read_time` reads every one of them, whichever was chosen, with a `T` for the blank, with fractions of a second or without seconds,
and with any offset from UTC. So what is shown can be typed. `frontend/static/shared/times.js` shows times as `TimeStyle` does.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from functools import cache
from typing import Literal, get_args
from zoneinfo import ZoneInfo, available_timezones

from boresight.errors import RefusedInputError

TimeForm = Literal["day_of_year", "iso", "local"]
TIME_FORMS: tuple[TimeForm, ...] = get_args(TimeForm)
LONGEST = 80  # characters of a time in any form
_DAY_OF_YEAR = re.compile(r"(\d{4})-(\d{3})(?!\d|-)")
_WITH_LOCAL = re.compile(
    r"([^()]+?) ?\((?:(\d{4}-\d{2}-\d{2})[ T])?(\d{2}:\d{2}(?::\d{2})?[+-]\d{2}:\d{2}(?::\d{2})?)\)"
)


def utc_now() -> str:
    """Return the current time in the store's form, `2026-11-21T03:04:05.123456Z`; sorts as time."""
    return utc_after(0.0)


def utc_after(seconds: float) -> str:
    """Return the time so many seconds from now, in the same form; negative seconds are in the past."""
    return utc_text(datetime.now(UTC) + timedelta(seconds=seconds))


def seconds_between(earlier: str, later: str) -> float:
    """Return the seconds from one time of the store to another."""
    first, second = (datetime.fromisoformat(text) for text in (earlier, later))
    return (second - first).total_seconds()


def utc_text(moment: datetime) -> str:
    """Return a datetime in the store's form; one without a zone is taken as UTC."""
    moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    return f"{moment.replace(tzinfo=None).isoformat(timespec='microseconds')}Z"  # strftime writes the year 33 with two digits


@cache
def list_zones() -> tuple[str, ...]:
    """Return the names of the time zones that this machine knows."""
    return tuple(sorted(available_timezones()))


@dataclass(frozen=True)
class TimeStyle:
    """How a person has times shown: the form, and of `local` the zone."""

    form: TimeForm = "day_of_year"
    zone: str = "UTC"

    def show(self, moment: datetime) -> str:
        """Print a time to the second."""
        moment = moment.astimezone(UTC).replace(microsecond=0)
        clock = f"{moment:%H:%M:%S}Z"
        if self.form == "day_of_year":
            return f"{moment.year:04d}-{moment:%j} {clock}"
        return f"{moment.date()} {clock}{self._beside(moment) if self.form == 'local' else ''}"

    def _beside(self, moment: datetime) -> str:
        """Print the same in the zone, with its date where that is another."""
        try:
            local = moment.astimezone(ZoneInfo(self.zone))
        except OverflowError:  # a day before the first one, or after the last
            return ""
        day = "" if local.date() == moment.date() else f"{local.date()} "
        return f" ({day}{local.isoformat()[11:]})"


STYLE = TimeStyle()


def read_time(text: str) -> str:
    """Convert a time in any form that pages show to the store's form; one that names no zone is taken as UTC."""
    if len(text) > LONGEST:
        raise RefusedInputError(
            f"A time has at most {LONGEST} characters, and this has {len(text):,}; write a shorter one."
        )
    try:
        return utc_text(_read(text.strip()))
    except RefusedInputError:
        raise
    except (ValueError, OverflowError) as error:
        raise RefusedInputError(
            f"{text[:60]!r} is not a time; write it like 2026-11-21T03:04:05Z, or with the day of the year.",
            code="not-a-time",
        ) from error


def _read(text: str) -> datetime:
    if beside := _WITH_LOCAL.fullmatch(text):
        moment, local = _read(beside[1]), time.fromisoformat(beside[3])
        moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
        meant = moment.astimezone(local.tzinfo)
        on = meant.date() if beside[2] is None else date.fromisoformat(beside[2])
        if meant.replace(microsecond=0) != datetime.combine(on, local):
            raise RefusedInputError(f"{text[:80]!r} names two different times; type one of them.")
        return moment
    if numbered := _DAY_OF_YEAR.match(text):
        day = date(int(numbered[1]), 1, 1) + timedelta(days=int(numbered[2]) - 1)
        if day.year != int(numbered[1]):
            raise ValueError("no such day of the year")
        text = f"{day}{text[numbered.end() :]}"
    return datetime.fromisoformat(re.sub(r" ?UTC$", "Z", text))
