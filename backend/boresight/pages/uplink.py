"""Uplink: what every sensor's baseline is and what is known to be on board, side by side, the worst first.

Ground and board are two facts and never one word. MISMATCH is critical: the sensor runs with something that nobody sent.
Another set active on board than is baseline is a caution, for it may be meant, on the day after a promotion or a roll-back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from boresight.api.dependencies import Reading, Who
from boresight.pages.rendering import render
from boresight.pages.runs import read_names
from boresight.pages.states import LEVELS
from boresight.services import sensors, timeline
from boresight.services.history import how_known
from boresight.services.timeline import AsOf
from boresight.store.tables import ParameterSet, Uplink

router = APIRouter()

UNDER_WAY = ("SENT", "LOADED", "VERIFIED")


@dataclass(frozen=True)
class Line:
    """One sensor: what is said of it, how bad that is, and the newest record.

    Parameters
    ----------
    known
        What holds now.
    level, word
        The status and how it is printed.
    shown
        Of the sets on board the one to look at, with its newest record: the mismatch, else the active, else the newest.
    how
        What that record rests on.
    """

    known: AsOf
    level: str
    word: str
    shown: tuple[ParameterSet, Uplink] | None
    how: str


def line_of(known: AsOf) -> Line:
    """Judge a sensor by what is known of it."""
    by_state = {record.onboard_state: (row, record) for row, record in known.on_board}
    newest = known.on_board[-1] if known.on_board else None
    shown = by_state.get("MISMATCH") or known.active or newest
    level, word = _standing(known, by_state)
    return Line(known, level, word, shown, "" if shown is None else how_known(shown[1]))


def _standing(known: AsOf, states: dict[str, tuple[ParameterSet, Uplink]]) -> tuple[str, str]:
    """Return the worst of what is known, as a level and a word."""
    if "MISMATCH" in states:
        return "critical", "MISMATCH"
    if known.differs:
        return "caution", "DIFFERS"
    if any(state in states for state in UNDER_WAY):
        return "standby", next(state for state in reversed(UNDER_WAY) if state in states)
    if known.active is not None:
        return "normal", "THE SAME"
    return ("caution", "UNKNOWN") if states else ("off", "NOT SENT")


def lines_of(answers: Sequence[AsOf]) -> list[Line]:
    """Return a line for every sensor, the worst first and then by name."""
    lines = [line_of(known) for known in answers]
    return sorted(lines, key=lambda line: (-LEVELS.index(line.level), line.known.sensor.name))


@router.get("/uplink", response_class=HTMLResponse)
def uplink_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show the fleet on the ground and on board."""
    answers = [timeline.as_of(session, sensor.id) for sensor in sensors.list_sensors(session)]
    return render(request, "uplink.html", lines=lines_of(answers), names=read_names(session), actor=actor)
