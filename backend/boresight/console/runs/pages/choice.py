"""The part of the run page about which camera model the data ask for: the choice, how it was made, or how to have one made."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any
from urllib.parse import urlencode

from fastapi import Depends, Request
from fastapi.responses import JSONResponse, Response

from boresight.calibration.choice.result import Candidate, Choice, State, Sufficiency, TermTest, write_p
from boresight.console.access.dependencies import Reading, Who, csrf, get_server
from boresight.console.fleet.tables import Sensor
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import make_change
from boresight.console.runs import choices
from boresight.console.runs import service as runs
from boresight.console.runs.pages.live import StateNotice, describe_progress, heard_s, list_notices
from boresight.console.runs.tables import TERMINAL_RUN_STATES, Run, parse_progress
from boresight.errors import ConflictError
from boresight.figures import held_out_error
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session
from boresight.telemetry.sensors import parse_sensor, sensor_document
from boresight.verdicts.numbers import MISSING, count, fixed, urad

VERDICTS = {
    Sufficiency.SUFFICES: ("normal", "suffices"),
    Sufficiency.NOISE_NOT_AS_STATED: ("caution", "noise differs from stated"),
    Sufficiency.SOMETHING_LEFT: ("serious", "remaining misfit"),
}
STATE_WORDS = {
    State.DETERMINED: ("normal", "determined"),
    State.UNDETERMINED: ("caution", "undetermined"),
    State.IMPLAUSIBLE: ("caution", "implausible"),
    State.FAILED: ("serious", "failed"),
    State.REJECTED: ("off", "rejected"),
}
HELD_OUT_BY = {"validation": "on the validation set", "cross-validation": "by cross-validation"}


@dataclass(frozen=True)
class CandidateRow:
    """A candidate of the tables: its camera, its terms, how its fit ended, and its numbers as they are printed."""

    camera_model: str
    terms: str
    is_chosen: bool
    level: str
    word: str
    cells: tuple[str, ...]


@dataclass(frozen=True)
class TestRow:
    """A test of the chosen camera's terms, printed."""

    terms: str
    level: str
    word: str
    cells: tuple[str, ...]


@dataclass(frozen=True)
class ChoiceView:
    """What the part shows: the run that chooses, if anybody asked, what its state means, and the choice, if there is one."""

    asked: Run | None
    why_not: str | None
    notices: Sequence[StateNotice] = ()
    heard_s: float | None = None
    fraction: float = 0.0
    message: str = ""
    pace: str = ""
    found: Choice | None = None
    level: str = "off"
    word: str = ""
    facts: str = ""
    cameras: Sequence[CandidateRow] = ()
    tests: Sequence[TestRow] = ()
    candidates: Sequence[CandidateRow] = ()
    launch_href: str | None = None

    @property
    def is_on_its_way(self) -> bool:
        """Whether workers have it."""
        return self.asked is not None and self.asked.state not in TERMINAL_RUN_STATES


def make_choice_part(request: Request, session: Session, actor: Actor, run: Run) -> dict[str, Any]:
    """Gather what the part `choice` of `runs/run.html` shows."""
    asked = choices.find_choice_run(session, run.id)
    view = ChoiceView(asked, _why_not(session, run, actor, asked))
    if asked is None:
        return {"choice": view}
    if asked.state != "SUCCEEDED":
        return {"choice": _show_state(request, session, view, asked)}
    try:
        found = choices.get_choice(session, get_server(request).blobs, run.id)
    except ConflictError as error:
        return {"choice": replace(view, notices=[StateNotice("serious", str(error), error.code)])}
    return {"choice": _show_answer(session, view, found, run), "held_out": held_out_error}


def _why_not(session: Session, run: Run, actor: Actor, asked: Run | None) -> str | None:
    """Say why a person may not ask for a choice or stop it, or why nobody may ask."""
    if "analyst" not in actor.roles:
        return "Only an analyst may choose a camera; ask an administrator for the role."
    is_on_its_way = asked is not None and asked.state not in TERMINAL_RUN_STATES
    return None if is_on_its_way else choices.find_obstacle(session, run)


def _show_state(request: Request, session: Session, view: ChoiceView, asked: Run) -> ChoiceView:
    log = runs.list_log_lines(session, asked.id)
    if asked.state in TERMINAL_RUN_STATES:
        cause = (asked.reason or "").strip() or "No cause was recorded; see the last lines of its log."
        level = "off" if asked.state == "CANCELLED" else "serious"
        return replace(view, notices=[StateNotice(level, cause)])
    workers = get_server(request).workers
    notices = list_notices(session, asked, log, workers.state() if workers else None)
    progress = parse_progress(asked.progress)
    return replace(
        view,
        notices=notices,
        heard_s=heard_s(asked, log),
        fraction=progress.fraction or 0.0,
        message=progress.message or "",
        pace=describe_progress(session, asked),
    )


def _show_answer(session: Session, view: ChoiceView, found: Choice, run: Run) -> ChoiceView:
    level, word = VERDICTS[found.sufficiency]
    return replace(
        view,
        found=found,
        level=level,
        word=word,
        facts=_say_facts(found),
        cameras=list(_list_cameras(found)),
        tests=list(_list_tests(found)),
        candidates=list(_list_candidates(found)),
        launch_href=_find_launch_href(session, found, run),
    )


def _say_facts(found: Choice) -> str:
    by = "" if found.held_out_by is None else f" Held out {HELD_OUT_BY[found.held_out_by]}."
    took = f"{count(found.frames)} frames, {count(found.stars)} stars, {count(found.arcs)} arcs"
    return f"{took}; the same stars and weights for every candidate.{by}"


def _list_cameras(found: Choice) -> Iterator[CandidateRow]:
    """Yield each camera's least sufficient candidate, the chosen one first."""
    tests = {one.place: one.test for one in found.other_cameras}
    for one in found.list_cameras():
        yield _row(found, one, tests.get(found.models.index(one)))


def _list_candidates(found: Choice) -> Iterator[CandidateRow]:
    """Yield every candidate, camera by camera, the chosen one's first, fewer parameters first."""
    order = [one.camera_model for one in found.list_cameras()]
    places = {
        name: place for place, name in enumerate(dict.fromkeys([*order, *(one.camera_model for one in found.models)]))
    }
    for one in sorted(found.models, key=lambda one: (places[one.camera_model], len(one.free))):
        yield _row(found, one, None)


def _row(found: Choice, one: Candidate, test: TermTest | None) -> CandidateRow:
    level, word = STATE_WORDS[one.state]
    return CandidateRow(
        camera_model=one.camera_model,
        terms=", ".join(one.terms) or "focal length alone",
        is_chosen=one is found.model,
        level=level,
        word=word,
        cells=(
            count(len(one.free)),
            fixed(one.chi2, 1),
            count(one.dof),
            fixed(one.bic, 1),
            urad(one.rms_arc_rad),
            _with_interval(one),
            MISSING if test is None else _p(test),
            MISSING if one is found.model else _with_sigma(one),
        ),
    )


def _list_tests(found: Choice) -> Iterator[TestRow]:
    """Yield the tests of the terms that the chosen camera has, then of those that it does not."""
    for has, tests in ((True, found.needed), (False, found.beyond)):
        for one in tests:
            level, word = (
                ("normal", "needed") if has else ("caution", "not determined") if one.needed else ("off", "not needed")
            )
            saved = None if one.held_out_ratio is None else 100.0 * (one.held_out_ratio - 1.0)
            cells = (
                fixed(one.chi2_difference, 1),
                count(one.df),
                _p(one),
                MISSING if saved is None else f"{'+' if saved > 0 else ''}{fixed(saved, 2)} %",
                _with_sigma(one),
            )
            yield TestRow(" + ".join(one.terms), level, word, cells)


def _p(test: TermTest) -> str:
    """Print a p-value, corrected for the number of tests."""
    return write_p(test.log10_p_corrected)


def _with_interval(one: Candidate) -> str:
    low, high = one.held_out_interval_rad or (None, None)
    ends = "" if low is None or high is None else f" ({urad(low)} to {urad(high)})"
    return f"{urad(one.held_out_rms_arc_rad)}{ends}"


def _with_sigma(one: Candidate | TermTest) -> str:
    if one.change_px is None or one.change_3_sigma_px is None:
        return MISSING
    return f"{fixed(one.change_px, 3)} ± {fixed(one.change_3_sigma_px / 3, 3)}"


def _find_launch_href(session: Session, found: Choice, run: Run) -> str | None:
    """Return the form of a run with these free parameters; None where the sensor has another camera, which is its own first."""
    if session.get_known(Sensor, run.sensor_id).document["camera_model"] != found.chosen.camera_model:
        return None
    ticked = [("clone", str(run.id)), *((f"free-{run.sensor_id}", name) for name in found.chosen.free)]
    return f"/runs/new?{urlencode(ticked)}"


router = PageRouter(dependencies=[Depends(csrf)])


@router.post("/runs/{run_id:int}/choice")
async def choose_camera(request: Request, actor: Who, run_id: int) -> Response:
    """Ask for the choice of a camera."""
    blobs = get_server(request).blobs
    change = partial(choices.request_choice, actor=actor, blobs=blobs, run_id=run_id)
    return await make_change(
        request, change, f"/runs/{run_id}?part=distortion#choice", "The choice of a camera is queued."
    )


@router.get("/runs/{run_id:int}/choice/sensor.json")
def chosen_sensor_file(request: Request, session: Reading, actor: Who, run_id: int) -> JSONResponse:  # noqa: ARG001 - who is not known gets none
    """Give the run's sensor file with the chosen camera, what was found of it as start, and its free parameters."""
    found = choices.get_choice(session, get_server(request).blobs, run_id)
    sensor = found.describe_sensor(parse_sensor(runs.get_run(session, run_id).sensor_document))
    headers = {"Content-Disposition": f'attachment; filename="run-{run_id}-choice.sensor.json"'}
    return JSONResponse(sensor_document(sensor), headers=headers)
