"""What the palette (Ctrl-K) finds by name or number: sensors, runs, sets, requests, telemetry, alarms, settings, terms and help.

Pages and the commands of the page at hand are in the page already, and the palette takes them from there.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any

from fastapi.responses import JSONResponse

from boresight.calibration.options import OPTIONS
from boresight.console import list_queries as lists
from boresight.console.access.dependencies import Reading
from boresight.console.alarms.tables import Alarm
from boresight.console.approvals.tables import Approval
from boresight.console.fleet.tables import Sensor
from boresight.console.help.glossary import list_terms
from boresight.console.pages.page_router import PageRouter
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.db.sessions import Session
from boresight.platform.web.paging import parse_row_id
from boresight.settings import SETTINGS

LONGEST_TEXT, MOST_OF_A_KIND = 64, 6
#: What one may say before a name or number, and the kind that is meant.
KINDS = {
    "sensor": "Sensor", "run": "Run", "set": "Parameter set", "parameter set": "Parameter set", "request": "Request",
    "approval": "Request", "telemetry": "Telemetry", "telemetry set": "Telemetry", "alarm": "Alarm",
}  # fmt: skip
SHORTEST_WORD = 2  # of what is no row: one letter would find them all
HELP = {
    "Glossary": "/help/glossary",
    "Settings": "/help/settings",
    "Documentation": "/docs/",
    "REST API": "/api/v1/docs",
    "Gallery of figures": "/gallery",
}

router = PageRouter()


@dataclass(frozen=True)
class Found:
    """One thing that was found: what it is, what it is called, how it stands, and its page."""

    kind: str
    title: str
    note: str
    href: str


@router.get("/search", response_class=JSONResponse)
def search(session: Reading, q: str = "") -> JSONResponse:
    """Find what a text names; a number finds what has that number too, and a kind before either keeps to it: `run 9`."""
    text = " ".join(q.split())[:LONGEST_TEXT]
    if meant := KINDS.get(text.lower()):
        unique = {one.href: one for one in (*_newest(session, meant), *_find(session, text))}
        return JSONResponse({"found": [asdict(one) for one in unique.values()]})
    kind, name = _split(text)
    found = {one.href: one for one in _find(session, name) if kind is None or one.kind == kind} if text else {}
    return JSONResponse({"found": [asdict(one) for one in found.values()]})


def _newest(session: Session, kind: str) -> Iterator[Found]:
    """Yield the newest of a kind."""
    match kind:
        case "Sensor":
            yield from map(_sensor, _rows(session, "sensors", "", "sensor"))
        case "Parameter set":
            yield from map(_set, _rows(session, "parameter-sets", "", "-set"))
        case "Request":
            for row in lists.list_newest(session, Approval, limit=MOST_OF_A_KIND):
                yield _request(row, session.get_one(ParameterSet, row.parameter_set_id))
        case "Run":
            yield from map(_run, _rows(session, "runs", "", "-run"))
        case "Telemetry":
            yield from map(_telemetry, _rows(session, "telemetry", "", "-uploaded"))
        case "Alarm":
            yield from map(_alarm, lists.list_newest(session, Alarm, limit=MOST_OF_A_KIND))


def _split(text: str) -> tuple[str | None, str]:
    """Part a kind from the name or number behind it; what is only a word is looked for as it is."""
    for word in sorted(KINDS, key=len, reverse=True):
        if text.lower().startswith(f"{word} ") and text[len(word) :].strip():
            return KINDS[word], text[len(word) :].strip()
    return None, text


def _find(session: Session, text: str) -> Iterator[Found]:
    number = parse_row_id(text.lstrip("#"))
    if number is not None:
        yield from _find_by_number(session, number)
    yield from map(_sensor, _rows(session, "sensors", text, "sensor"))
    sets = _rows(session, "parameter-sets", text, "-set")
    yield from map(_set, sets)
    for row in sets:
        yield from (_request(one, row) for one in lists.list_newest(session, Approval, set=row.id, limit=1))
    yield from map(_run, _rows(session, "runs", text, "-run"))
    yield from map(_telemetry, _rows(session, "telemetry", text, "-uploaded"))
    yield from map(_alarm, _alarms(session, text))
    if len(text) >= SHORTEST_WORD:
        for fitting in (
            _settings(text),
            _terms(text),
            _help(text.lower()),
        ):
            yield from islice(fitting, MOST_OF_A_KIND)


def _alarms(session: Session, text: str) -> list[Alarm]:
    """Return the newest alarms of a sensor, or whose sentence or kind has a text."""
    of_sensor = lists.read_page(session, "alarms", {"sensor_name": text}, "-alarm", limit=MOST_OF_A_KIND)
    said = _rows(session, "alarms", text, "-alarm") if len(text) >= SHORTEST_WORD else ()
    found = {row.id: row for row in (*of_sensor, *said)}
    return list(found.values())[:MOST_OF_A_KIND]


def _settings(text: str) -> Iterator[Found]:
    settings = [
        (Found("Setting", one.title, one.sentence, f"/help/settings#option-{one.name}"), (one.name, one.flag or ""))
        for one in OPTIONS.values()
    ] + [
        (Found("Setting", one.variable, one.sentence, f"/help/settings#setting-{one.name}"), (one.name,))
        for one in SETTINGS
    ]
    yield from _by_words(text, [(one, (one.title, *names)) for one, names in settings])


def _terms(text: str) -> Iterator[Found]:
    terms = [(Found("Term", ", ".join(one.names), one.meaning, one.address), one.names) for one in list_terms()]
    yield from _by_words(text, terms)


def _by_words(text: str, known: Sequence[tuple[Found, Sequence[str]]]) -> Iterator[Found]:
    """Yield what has a text in one of its names, then what has it as whole words in its sentence."""
    wanted = _plain(text)
    whole = re.compile(rf"(?<!\w){re.escape(wanted)}(?!\w)")
    named = [one for one, names in known if any(wanted in _plain(name) for name in names)]
    yield from named
    yield from (one for one, _ in known if one not in named and whole.search(_plain(one.note)))


def _plain(text: str) -> str:
    return re.sub("[-_]+", " ", text.lower().replace("σ", "sigma")).strip()


def _help(text: str) -> Iterator[Found]:
    yield from (Found("Help", title, "", href) for title, href in HELP.items() if text in title.lower())


def _rows(session: Session, name: str, text: str, sort: str) -> list[Any]:
    return list(lists.read_page(session, name, {"q": text}, sort, limit=MOST_OF_A_KIND))


def _find_by_number(session: Session, number: int) -> Iterator[Found]:
    if (run := session.get(Run, number)) is not None:
        yield _run(run)
    if (request := session.get(Approval, number)) is not None:
        yield _request(request, session.get_one(ParameterSet, request.parameter_set_id))
    if (alarm := session.get(Alarm, number)) is not None:
        yield _alarm(alarm)
    if (known := session.get(TelemetrySet, number)) is not None:
        yield _telemetry(known)


def _sensor(row: Sensor) -> Found:
    return Found("Sensor", row.name, "simulated" if row.simulated else "", f"/sensors/{row.id}")


def _set(row: ParameterSet) -> Found:
    return Found("Parameter set", row.name, f"{row.ground_state}, {row.onboard_state}", f"/parameter-sets/{row.id}")


def _telemetry(row: TelemetrySet) -> Found:
    return Found("Telemetry", row.name, row.purpose, f"/telemetry/{row.id}")


def _run(row: Run) -> Found:
    return Found(
        "Run", f"Run {row.id}: {row.own_label}" if row.own_label else f"Run {row.id}", row.state, f"/runs/{row.id}"
    )


def _request(row: Approval, of: ParameterSet) -> Found:
    return Found("Request", f"Request {row.id}: {of.name}", row.state, f"/approvals/{row.id}")


def _alarm(row: Alarm) -> Found:
    return Found("Alarm", f"Alarm {row.id}", row.sentence, f"/alarms/{row.id}")
