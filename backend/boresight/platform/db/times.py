"""Times as the store writes them: text in one form, `2026-11-21T03:04:05.123456Z`, which sorts as time."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from boresight.errors import RefusedInputError


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


def read_time(text: str) -> str:
    """Convert a time in ISO 8601, UTC where it names no zone, to the store's form."""
    try:
        return utc_text(datetime.fromisoformat(text.strip()))
    except (ValueError, OverflowError) as error:
        raise RefusedInputError(f"{text[:40]!r} is not a time; write it like 2026-11-21T03:04:05Z.") from error
