"""Turning a template and its values into a page; answering a form.

After a POST a page answers with `redirect(location, flash="...")`. A refusal passes through the request's transaction
first, so nothing of a refused change is kept, and is then shown on the same page. Undefined names are errors, and
everything is escaped.
"""

from __future__ import annotations

import json
import logging
import math
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from http import HTTPStatus
from typing import Any, Generic, TypeVar
from urllib.parse import quote

from fastapi import Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, RedirectResponse, Response
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.datastructures import FormData
from starlette.exceptions import HTTPException

import boresight
from boresight.console.access import users
from boresight.console.access.credentials import current_actor
from boresight.console.access.dependencies import check_own, check_own_factor, get_server, open_write_session
from boresight.console.access.passwords import NO_PROOF
from boresight.console.fleet.timeline import describe_source
from boresight.console.help.glossary import mark_terms
from boresight.console.pages import formats
from boresight.console.pages.formats import LEVELS, get_level, show_times, worst
from boresight.console.pages.frame import FLASH_COOKIE, make_page_frame
from boresight.errors import (
    BoresightError,
    FactorEnrolmentDueError,
    Fault,
    NotFoundError,
    PasswordDueError,
    RefusedInputError,
    SessionEndedError,
    UnauthenticatedError,
)
from boresight.figures.tables import most_changed
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session, open_reading
from boresight.platform.web.paging import parse_row_id
from boresight.platform.web.problems import make_problem
from boresight.platform.web.response_cache import GAPS
from boresight.platform.web.static_files import has_documentation, static_version
from boresight.resources import folder
from boresight.verdicts.numbers import keep_typed, show_numbers

T = TypeVar("T")
_transaction = asynccontextmanager(open_write_session)


@dataclass(frozen=True)
class RefusalContext:
    """A refusal as a page shows it: its sentence, the fields it names, and the page's status and headers."""

    error: BoresightError
    sentence: str
    code: str
    faults: tuple[Fault, ...]
    status: int
    headers: Mapping[str, str]

    @classmethod
    def of(cls, error: BoresightError) -> RefusalContext:
        """Make the context from a refusal that was raised."""
        problem = make_problem(error)
        faults = tuple(getattr(error, "faults", ()))
        return cls(error, str(error), error.code, faults, problem.status, problem.headers or {})

    @property
    def is_ours(self) -> bool:
        """Whether the fault is the server's, such as a full disk, and not the request's."""
        return self.status >= HTTPStatus.INTERNAL_SERVER_ERROR


@dataclass(frozen=True)
class AttemptResult(Generic[T]):
    """The outcome of an attempt: a value or a refusal."""

    value: T | None
    refusal: RefusalContext | None

    @property
    def made(self) -> T:
        """The value, where nothing was refused."""
        if self.value is None:
            raise ValueError("there is no value: read the refusal first")
        return self.value


def ask(question: Callable[[], T]) -> AttemptResult[T]:
    """Return the result of a query or its refusal; a missing row is left to the problem page."""
    try:
        return AttemptResult(question(), None)
    except NotFoundError:
        raise
    except BoresightError as error:
        return AttemptResult(None, RefusalContext.of(error))


async def attempt(
    request: Request, change: Callable[..., T], prepare: Callable[[], Awaitable[Sequence[object]]] | None = None
) -> AttemptResult[T]:
    """Make a change in the request's writing transaction."""
    try:
        prepared = () if prepare is None else await prepare()
        async with _transaction(request) as session:
            return AttemptResult(await run_in_threadpool(change, session, *prepared), None)
    except NotFoundError:
        raise
    except BoresightError as error:
        return AttemptResult(None, RefusalContext.of(error))


async def make_change(
    request: Request,
    change: Callable[..., Any],
    address: str,
    said: str,
    *,
    prepare: Callable[[], Awaitable[Sequence[object]]] | None = None,
    again: Callable[[RefusalContext, Session], HTMLResponse] | None = None,
) -> Response:
    """Make a change and redirect to an address with a line about it; a refusal is shown as a line there, or as a page."""
    outcome = await attempt(request, change, prepare)
    if outcome.refusal is None:
        return redirect(address, flash=said.format(outcome.value))
    if again is None:
        return redirect_refused(address, outcome.refusal)
    return await read_again(request, partial(again, outcome.refusal))


async def read_again(request: Request, render_page: Callable[[Session], HTMLResponse]) -> HTMLResponse:
    """Render a page in a reading transaction of its own: after a form was refused, or with what was made just now."""

    def read() -> HTMLResponse:
        with open_reading(request.app.state.engine) as session:
            return render_page(session)

    return await run_in_threadpool(read)


def proof_of_own(
    request: Request, actor: Actor, form: Mapping[str, str], *, with_password: bool = True
) -> Callable[[], Awaitable[Sequence[object]]]:
    """Return a function that checks what a form gives to confirm the acting person, for `attempt` to call first."""

    async def prepare() -> Sequence[object]:
        if not with_password:
            return (replace(NO_PROOF, given=await check_own_factor(request, actor, form.get("factor", ""))),)
        return (await check_own(request, actor, form.get("password", ""), form.get("factor", "")),)

    return prepare


FLASH_SECONDS = 60
MOST_RENDERED = 8  # pages


class PageTemplates(FileSystemLoader):
    """The templates, with the version of the static files in their addresses."""

    def get_source(self, environment: Environment, template: str) -> tuple[str, str, Callable[[], bool]]:
        """Return a template's source, where it is, and a function that tells whether it is unchanged."""
        source, path, is_current = super().get_source(environment, template)
        return source.replace('"/static/', f'"/static/version-{static_version()}/'), path, is_current


def _environment() -> Environment:
    environment = Environment(
        loader=PageTemplates(folder("frontend") / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=keep_typed,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {function.__name__: function for function in formats.FILTERS}
    environment.filters |= {
        "level_of": get_level,
        "worst": worst,
        "how_known": describe_source,
        "most_changed": most_changed,
    }
    environment.globals |= {"LEVELS": LEVELS, "version": boresight.__version__, "has_documentation": has_documentation}
    return environment


TEMPLATES = _environment()


def render(
    request: Request,
    template: str,
    *,
    status_code: int = 200,
    headers: Mapping[str, str] | None = None,
    refused: RefusalContext | None = None,
    follows_from: Hashable = None,
    **values: Any,
) -> HTMLResponse:
    """Render a template inside the frame, its times in the reader's form and its terms explained."""
    if refused is not None:
        status_code, headers = refused.status, refused.headers
    frame = make_page_frame(request, is_answer=status_code == HTTPStatus.OK)
    given = (template, replace(frame, now=""), follows_from)  # the clock in the page is kept by its script
    rendered: OrderedDict[Hashable, str] = request.app.state.rendered
    shared = follows_from is not None and request.scope["state"].get(GAPS)
    page = rendered.get(given) if shared else None
    if page is None:
        written = TEMPLATES.get_template(template).render(frame=frame, request=request, **values)
        page = mark_terms(show_numbers(show_times(written, frame.times)))
        if shared:
            rendered[given] = page
            while len(rendered) > MOST_RENDERED:
                rendered.popitem(last=False)
    response = HTMLResponse(page, status_code=status_code, headers={**(headers or {}), "Cache-Control": "no-store"})
    if frame.flash:
        response.delete_cookie(FLASH_COOKIE, path="/")
    return response


def redirect(location: str, *, flash: str = "", level: str = "normal", code: str = "") -> RedirectResponse:
    """Send the browser to a page by GET, with one line to show there; `code`: which one, for scripts."""
    response = RedirectResponse(location, status_code=303)
    if flash:
        value = quote(json.dumps([level, flash, code]))
        response.set_cookie(FLASH_COOKIE, value, max_age=FLASH_SECONDS, path="/", httponly=True, samesite="lax")
    return response


def redirect_refused(location: str, refusal: RefusalContext) -> RedirectResponse:
    """Redirect to a form's page with the refusal as a line; a fault of the server is raised again."""
    if refusal.is_ours:
        raise refusal.error
    return redirect(location, flash=refusal.sentence, level="serious", code=refusal.code)


def get_texts(form: FormData) -> dict[str, str]:
    """Return the texts of a form, without its files."""
    return {name: value for name, value in form.items() if isinstance(value, str)}


async def read_texts(request: Request) -> dict[str, str]:
    """Read the texts of the form that a request carries."""
    return get_texts(await request.form())


def read_number(label: str, text: str) -> float:
    """Read a number of a form; refuses what is none, and what no quantity is."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RefusedInputError(f"{label} is {text[:20]!r}: give a number, such as 10 or 0.5.")
    return value


def read_whole_number(label: str, text: str) -> int:
    """Read a number of a form that counts something."""
    value = read_number(label, text)
    if value != int(value):
        raise RefusedInputError(f"{label} is {text[:20]}: give a whole number.")
    return int(value)


def seen_version(form: Mapping[str, str]) -> int:
    """Return the version that the page showed."""
    version = parse_row_id(form.get("version", ""))
    if version is None:
        raise RefusedInputError("The form does not say which version you saw; reload the page and try again.")
    return version


GREATEST_NUMBER = 2**63 - 1  # of a row: SQLite's and PostgreSQL's greatest integer
MOST_DIGITS = len(str(GREATEST_NUMBER))
NUMBERED = frozenset({"sensor", "set", "clone", "before", "runs", "reference"})


async def check_numbers(request: Request) -> None:
    """Refuse an address with a number too large for a row."""
    for text in _numbers(request):
        if len(text) > MOST_DIGITS or int(text) > GREATEST_NUMBER:
            raise NotFoundError("Nothing has this number; choose one from the list.")


def _numbers(request: Request) -> Iterator[str]:
    """Yield every number of the address in digits, without leading zeros."""
    queried = [value for name, value in request.query_params.multi_items() if name in NUMBERED]
    parts = (part.strip() for value in [*map(str, request.path_params.values()), *queried] for part in value.split(","))
    yield from (part.lstrip("0") or "0" for part in parts if part.isdecimal())


log = logging.getLogger(__name__)

FORBIDDEN = HTTPStatus.FORBIDDEN
NOBODY = "No administrator is left to give you a role; create one with boresight user add on the server."
SENTENCE = {404: "There is no page at this address.", 405: "This address does not accept what was sent."}
ADVICE = {
    400: "Go back, reload the page and submit the form again.",
    403: "Go back. If you need another role, ask an administrator.",
    404: "The number may be wrong or the address incomplete. Use the navigation to find the page.",
    405: "Open the page by a link or by the navigation, and use its buttons.",
    409: "Reload to see its current state, then decide again.",
    412: "Somebody changed it after you opened the page. Go back, reload, and check the current state.",
    413: "Split the file, or ask an administrator to raise the limit.",
    422: "Nothing was stored. Go back, correct what is named here, and submit it again.",
    428: "Go back, reload the page and do it from there.",
    429: "Wait for the time stated above; nothing was stored.",
    500: "Nothing was stored. Try again; if it fails again, report the request id below.",
    503: "Wait a moment and try again; if it fails again, tell your administrator, with the request id below.",
}
ADVICE_OF_ANY = "Go back and try again; if it fails again, report the request id below."


def is_page(request: Request) -> bool:
    """Tell whether a person's browser asks, and not a program."""
    return not request.url.path.startswith("/api/") and "text/html" in request.headers.get("accept", "")


def problem_page(request: Request, error: Exception) -> Response:
    """Answer an error as a page; who is not logged in is sent to the log-in and back."""
    if isinstance(error, PasswordDueError):
        return redirect("/password")
    if isinstance(error, FactorEnrolmentDueError):
        return redirect("/second-factor")
    if isinstance(error, UnauthenticatedError):
        ended = f"&ended={error.because}" if isinstance(error, SessionEndedError) else ""
        return redirect(f"/login?next={quote(_way_back(request), safe='')}{ended}")
    with suppress(Exception):  # for an unknown address no actor was identified, and a broken store cannot identify one
        current_actor(request)
    problem = make_problem(error)
    return render(
        request,
        "shared/problem.html",
        status_code=problem.status,
        headers=problem.headers,
        problem=problem,
        sentence=SENTENCE.get(problem.status, problem.detail) if isinstance(error, HTTPException) else problem.detail,
        advice=ADVICE.get(problem.status, ADVICE_OF_ANY) + _who_grants(request, problem.status),
        request_id=getattr(request.state, "request_id", None),
    )


def _who_grants(request: Request, status: int) -> str:
    """Return a sentence naming who can give a role, for a known actor who lacks it."""
    if status != FORBIDDEN or getattr(request.state, "actor", None) is None:
        return ""
    try:
        with open_reading(get_server(request).engine) as session:
            names = users.list_administrators(session)
    except Exception:
        log.exception("A refusal could not name the administrators")
        return ""
    said = f"On the page Users and keys {' or '.join(names)} can give roles." if names else NOBODY
    return f" {said}"


def bare_problem_page(request: Request, error: Exception) -> Response:
    """Answer an error without the frame, where that cannot be made: its sentence and the request id."""
    problem = make_problem(error)
    page = TEMPLATES.get_template("shared/bare_problem.html").render(
        problem=problem,
        advice=ADVICE.get(problem.status, ADVICE_OF_ANY),
        request_id=getattr(request.state, "request_id", None),
    )
    return HTMLResponse(
        page, status_code=problem.status, headers={**(problem.headers or {}), "Cache-Control": "no-store"}
    )


def _way_back(request: Request) -> str:
    """Return the address to open after the log-in: the requested one, or the start page after a form."""
    if request.method != "GET":
        return "/"
    return request.url.path + (f"?{request.url.query}" if request.url.query else "")
