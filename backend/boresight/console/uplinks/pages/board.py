"""Uplink: what every sensor's baseline is and what is known to be on board, side by side, the worst first.

Ground and board are two facts and never one word. MISMATCH is critical: the sensor runs with something that nobody sent.
Another set active on board than is baseline is a caution, for it may be meant, on the day after a promotion or a roll-back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from boresight.console.access.dependencies import Reading, Who
from boresight.console.fleet import timeline
from boresight.console.fleet.timeline import AsOf, SensorSituation, describe_source
from boresight.console.pages.formats import LEVELS
from boresight.console.pages.rendering import render
from boresight.console.pages.tables import LONGEST_FILTER
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.pages.list import read_names
from boresight.console.uplinks.tables import Uplink

router = APIRouter()

UNDER_WAY = ("SENT", "LOADED", "VERIFIED")
WORDS = ("MISMATCH", "DIFFERS", "UNKNOWN", *UNDER_WAY, "THE SAME", "NOT SENT")
ROWS_A_PAGE = 50
LONGEST_NUMBER = 8


@dataclass(frozen=True)
class UplinkLine:
    """One sensor: what is said of it, how bad that is, and the newest record."""

    known: AsOf
    level: str
    word: str
    shown: tuple[ParameterSet, Uplink] | None
    how: str


def make_uplink_line(known: AsOf) -> UplinkLine:
    """Lay out a sensor by what is known of it."""
    by_state = {record.onboard_state: (row, record) for row, record in known.on_board}
    newest = known.on_board[-1] if known.on_board else None
    shown = by_state.get("MISMATCH") or known.active or newest
    baseline_id = None if known.baseline is None else known.baseline.id
    level, word = find_worst_known(baseline_id, [(row.id, record.onboard_state) for row, record in known.on_board])
    return UplinkLine(known, level, word, shown, "" if shown is None else describe_source(shown[1]))


def find_worst_known(baseline_id: int | None, on_board: Sequence[tuple[int, str]]) -> tuple[str, str]:
    """Return the worst of what is known, as a level and a word."""
    states = {state for _, state in on_board}
    active = next((set_id for set_id, state in on_board if state == "ACTIVE"), None)
    if "MISMATCH" in states:
        return "critical", "MISMATCH"
    if active is not None and active != baseline_id:
        return "caution", "DIFFERS"
    if any(state in states for state in UNDER_WAY):
        return "standby", next(state for state in reversed(UNDER_WAY) if state in states)
    if active is not None:
        return "normal", "THE SAME"
    return ("caution", "UNKNOWN") if states else ("off", "NOT SENT")


@dataclass(frozen=True)
class UplinkContext:
    """Which sensors are looked at: those whose name holds `q` and that stand as `word` says, and which page of them."""

    q: str
    word: str
    page: int

    def address(self, **changes: Any) -> str:
        """Return the address of this view, with changes; what is as on a first visit is left out."""
        held = {"q": self.q, "status": self.word, "page": self.page if self.page > 1 else ""} | changes
        query = urlencode({name: value for name, value in held.items() if value})
        return f"/uplink?{query}" if query else "/uplink"


def read_context(request: Request) -> UplinkContext:
    """Read the address; nonsense is left out."""
    asked = request.query_params
    word, page = asked.get("status", ""), asked.get("page", "")
    number = int(page) if page.isdecimal() and len(page) < LONGEST_NUMBER else 1
    return UplinkContext(asked.get("q", "").strip()[:LONGEST_FILTER], word if word in WORDS else "", max(number, 1))


def ordered(boards: Iterable[SensorSituation], shown: UplinkContext) -> list[int]:
    """Return the sensors of a view, the worst first and then by name."""
    found = []
    for board in boards:
        level, word = find_worst_known(board.baseline_id, board.on_board)
        if shown.q.casefold() in board.name.casefold() and shown.word in {"", word}:
            found.append((-LEVELS.index(level), board.name, board.sensor_id))
    return [sensor_id for _, _, sensor_id in sorted(found)]


@router.get("/uplink", response_class=HTMLResponse)
def uplink_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show a page of the fleet on the ground and on board."""
    shown = read_context(request)
    found = ordered(timeline.read_situations(session), shown)
    start = (shown.page - 1) * ROWS_A_PAGE
    lines = [
        make_uplink_line(timeline.get_state_at(session, sensor_id)) for sensor_id in found[start : start + ROWS_A_PAGE]
    ]
    return render(
        request,
        "uplinks/uplink.html",
        lines=lines,
        shown=shown,
        words=WORDS,
        following=shown.address(page=shown.page + 1) if len(found) > start + ROWS_A_PAGE else None,
        previous=shown.address(page=shown.page - 1 if shown.page > 2 else "") if shown.page > 1 else None,
        start=start,
        found=len(found),
        names=read_names(session),
        actor=actor,
    )
