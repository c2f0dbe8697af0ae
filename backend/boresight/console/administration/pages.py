"""What keeps an installation going, on one page, and the gallery: every figure and element of the pages in all their states.

The gallery reads nothing from the store: its figures draw `boresight.figures.example_calibration`, and the screenshot
tests look at it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from fastapi import Request
from fastapi.responses import HTMLResponse, Response

from boresight.console.access import api_keys, users
from boresight.console.access.dependencies import Blobs, Reading, ServerPolicy, ServerSettings, Who, Workers
from boresight.console.access.tables import ROLES, ApiKey, User
from boresight.console.backups import service as backups
from boresight.console.jobs.dependencies import ServerMaintenance
from boresight.console.pages.formats import LEVEL_OF_STATE
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import render
from boresight.console.runs import service as runs
from boresight.errors import NotFoundError, RefusedInputError
from boresight.figures import CHAPTERS, FIGURES, WIDE, figure_json
from boresight.figures.chart import labelled
from boresight.figures.example_calibration import get_example_calibrations, make_example_traces
from boresight.figures.tables import parameter_rows
from boresight.platform.db.sessions import utc_after, utc_now
from boresight.platform.web.media import CsvFile, csv_text
from boresight.verdicts.verdict import LEVELS, make_verdict_marks

SOON_S = 14 * 86400.0
ALONE = ("approver", "administrator")  # roles that one person alone should not be the only one to have

router = PageRouter()


@dataclass(frozen=True)
class KeyCounts:
    """Counts of the API keys by state."""

    valid: int
    unused: int
    expiring: int
    endless: int


def roles_held(people: Sequence[User]) -> list[tuple[str, int]]:
    """Count the people who may log in, by role."""
    held = Counter(role for person in people if person.disabled_utc is None for role in person.roles)
    return [(role, held[role]) for role in ROLES]


def warnings(people: Sequence[User], *, four_eyes: bool) -> list[str]:
    """List problems with people and roles that would hold up work."""
    held = dict(roles_held(people))
    said = [f"There is only one user with the role {role}; nobody can stand in." for role in ALONE if held[role] == 1]
    said += [f"No user has the role {role}." for role in ROLES[1:] if not held[role]]
    if four_eyes and held["approver"] and not any("approver" in p.roles and "analyst" not in p.roles for p in people):
        said.append("Every approver is also an analyst: whoever submits a set needs another approver to sign it.")
    return said


def keys_at(keys: Sequence[ApiKey], now: str, soon: str) -> KeyCounts:
    """Count the keys that are valid, and of them those never used, soon expired, or valid forever."""
    valid = [key for key in keys if not key.revoked_utc and (key.expires_utc is None or key.expires_utc > now)]
    return KeyCounts(
        valid=len(valid),
        unused=sum(key.last_used_utc is None for key in valid),
        expiring=sum(key.expires_utc is not None and key.expires_utc <= soon for key in valid),
        endless=sum(key.expires_utc is None for key in valid),
    )


@router.get("/administration", response_class=HTMLResponse)
def administration_page(
    request: Request,
    session: Reading,
    actor: Who,
    settings: ServerSettings,
    policy: ServerPolicy,
    workers: Workers,
    blobs: Blobs,
    maintenance: ServerMaintenance,
) -> HTMLResponse:
    """Show the state of the installation."""
    people = users.list_users(session)
    return render(
        request,
        "administration/administration.html",
        people=people,
        due=[person.printed_name for person in people if person.must_change_password and not person.disabled_utc],
        roles=roles_held(people),
        warnings=warnings(people, four_eyes=policy.four_eyes),
        keys=keys_at(api_keys.list_keys(session), utc_now(), utc_after(SOON_S)),
        workers=workers.state() if workers else None,
        counts=runs.count_by_state(session),
        policy=policy,
        session_hours=settings.session_hours,
        login_attempts=settings.login_attempts,
        backups=backups.look(session),
        blobs_at=blobs.kept_at,
        light=maintenance.light(),
        administrator="administrator" in actor.roles,
    )


PARTS = {"figures": "Figures", "elements": "Elements"}
STATES = {
    "one": ("One run", ("filter",)),
    "two": ("Two runs compared", ("filter", "batch")),
    "weak": ("Weak directions", ("weak",)),
    "partial": ("Half-way", ("partial",)),
    "nothing": ("Nothing yet", ("nothing",)),
}

gallery_router = PageRouter()


def _find_traces(name: str, of: str) -> tuple[str, ...]:
    if name not in FIGURES:
        raise NotFoundError(f"There is no figure {name}; choose from {', '.join(FIGURES)}.")
    return _state(of)[1]


def _state(of: str) -> tuple[str, tuple[str, ...]]:
    if of not in STATES:
        raise NotFoundError(f"There is no state {of}; choose from {', '.join(STATES)}.")
    return STATES[of]


@gallery_router.get("/gallery", response_class=HTMLResponse)
def gallery_page(request: Request, part: str = "figures", of: str = "one") -> HTMLResponse:
    """Show the figures in a state, or the elements."""
    if part not in PARTS:
        raise NotFoundError(f"There is no part {part}; choose from {', '.join(PARTS)}.")
    _state(of)
    result = get_example_calibrations()["filter"]
    return render(
        request,
        "administration/gallery.html",
        part=part,
        parts=PARTS,
        of=of,
        states=STATES,
        chapters=CHAPTERS,
        wide=WIDE,
        levels=LEVELS,
        words=LEVEL_OF_STATE,
        marks=make_verdict_marks(result),
        rows=parameter_rows(result),
    )


@gallery_router.get("/gallery/figures/{name}")
def gallery_figure(name: str, of: str = "one", size: Literal["large", "medium", "narrow"] = "large") -> Response:
    """Send a figure of the example as Plotly JSON."""
    if of == "broken":
        raise RefusedInputError("This figure fails on purpose, to show an error in its panel; choose another.")
    traces = labelled(make_example_traces(_find_traces(name, of)), size)
    return Response(figure_json(FIGURES[name].draw_for(size, traces)), media_type="application/json")


@gallery_router.get("/gallery/figures/{name}/data")
def gallery_data(name: str, of: str = "one") -> Response:
    """Send the numbers of a figure of the example as CSV."""
    shown = _find_traces(name, of)
    table = FIGURES[name].table(get_example_calibrations()[shown[0]])
    return CsvFile(csv_text(table))
