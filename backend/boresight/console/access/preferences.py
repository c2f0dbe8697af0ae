"""What each person prefers: small JSON values under names that are declared here, each with its default and its check.

A preference decides what its person is shown and nothing else, so it is neither sealed nor in the audit log. A new one is a line of
`PREFERENCES`. A value that an older version kept and this one does not know counts as not chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from boresight.console.access import queries as rows
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_person
from boresight.platform.db.sessions import Session
from boresight.platform.db.times import STYLE, TIME_FORMS, TimeStyle, list_zones

THEMES = ("system", "dark", "light", "contrast")


@dataclass(frozen=True)
class Preference:
    """A preference: its value until a person chooses, and what puts a chosen one in its normal form or refuses it."""

    default: Any
    check: Callable[[Any], Any]


def _check_times(value: Any) -> dict[str, str]:
    """Refuse a form of times or a zone that is not known here."""
    given = value if isinstance(value, dict) else {}
    form, zone = given.get("form"), given.get("zone", "")
    if form not in TIME_FORMS:
        raise RefusedInputError(f"Times are shown as {', '.join(TIME_FORMS)}; choose one of them.")
    if form == "local" and zone not in list_zones():
        raise RefusedInputError(f"{str(zone)[:60]!r} is not a known time zone; type one such as Europe/Amsterdam.")
    return asdict(TimeStyle(form, zone) if form == "local" else TimeStyle(form))


def _check_theme(value: Any) -> str:
    """Refuse a theme that pages do not have."""
    if value not in THEMES:
        raise RefusedInputError(f"Pages have the themes {', '.join(THEMES)}; choose one of them.")
    return str(value)


PREFERENCES: Mapping[str, Preference] = {
    "times": Preference(asdict(STYLE), _check_times),
    "theme": Preference("system", _check_theme),
}


def get_preferences(session: Session, user_id: int | None) -> dict[str, Any]:
    """Return every preference of a person, by its name; of nobody the defaults."""
    chosen = {} if user_id is None else rows.read_preferences(session, user_id)
    return {name: _known(one, chosen[name]) if name in chosen else one.default for name, one in PREFERENCES.items()}


def _known(preference: Preference, value: Any) -> Any:
    try:
        return preference.check(value)
    except RefusedInputError:
        return preference.default


def get_time_style(session: Session, user_id: int | None) -> TimeStyle:
    """Return how a person has times shown."""
    return TimeStyle(**get_preferences(session, user_id)["times"])


def set_preference(session: Session, actor: Actor, name: str, value: Any) -> Any:
    """Keep what the acting person prefers under a name; returns it in its normal form."""
    user_id = require_person(actor, "choose how pages are shown")
    if name not in PREFERENCES:
        raise NotFoundError(f"There is no preference {name[:40]!r}; choose from {', '.join(PREFERENCES)}.")
    kept = PREFERENCES[name].check(value)
    rows.write_preference(session, user_id, name, kept)
    return kept
