"""Times as the store writes them: text in one form, `2026-11-21T03:04:05.123456Z`, which sorts as time."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta


def utc_now() -> str:
    """Return the time as the store writes it, `2026-11-21T03:04:05.123456Z`; sorts as time."""
    return utc_after(0.0)


def utc_after(seconds: float) -> str:
    """Return the time so many seconds from now, in the same form; negative seconds are in the past."""
    return utc_text(datetime.now(UTC) + timedelta(seconds=seconds))


def utc_text(moment: datetime) -> str:
    """Return a moment as the store writes it; one without a zone is UTC already."""
    moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    return moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
