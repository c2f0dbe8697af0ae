"""Turning a template and its values into a page; answering a form.

`render(request, "runs/run.html", run=row)` is all a page file needs: the frame around the content fills itself. After a POST
a page answers with `redirect(location, flash="...")`; the line travels in a short-lived cookie and is shown once on the
next page. Undefined names are errors, and everything is escaped.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Hashable, Mapping
from dataclasses import replace
from http import HTTPStatus
from typing import Any
from urllib.parse import quote

from fastapi import Request
from fastapi.responses import HTMLResponse, RedirectResponse
from jinja2 import Environment, FileSystemLoader, StrictUndefined

import boresight
from boresight.api.keeping import GAPS
from boresight.pages import formats
from boresight.pages.attempts import Refusal
from boresight.pages.frame import FLASH_COOKIE, frame_of
from boresight.pages.states import LEVELS, level_of, worst
from boresight.resources import folder
from boresight.services.history import how_known

FLASH_SECONDS = 60
MOST_WRITTEN = 8  # pages


def _environment() -> Environment:
    """Build the template environment with every filter of `formats`."""
    environment = Environment(
        loader=FileSystemLoader(folder("frontend") / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {function.__name__: function for function in formats.FILTERS}
    environment.filters |= {"level_of": level_of, "worst": worst, "how_known": how_known}
    environment.globals |= {"LEVELS": LEVELS, "version": boresight.__version__}
    return environment


TEMPLATES = _environment()


def render(
    request: Request,
    template: str,
    *,
    status_code: int = 200,
    headers: Mapping[str, str] | None = None,
    refused: Refusal | None = None,
    follows_from: Hashable = None,
    **values: Any,
) -> HTMLResponse:
    """Render a template inside the frame.

    Parameters
    ----------
    template
        File name in `frontend/templates`.
    status_code, headers
        Of the answer.
    refused
        The refusal that the page shows, where a form came back: it has status and headers.
    follows_from
        What all values follow from, where the page is worth being written once for those to whom the same is shown.
    values
        What the template names, besides `frame` and `request`.
    """
    if refused is not None:
        status_code, headers = refused.status, refused.headers
    frame = frame_of(request, is_answer=status_code == HTTPStatus.OK)
    given = (template, replace(frame, now=""), follows_from)  # the clock in the page goes by itself
    written: OrderedDict[Hashable, str] = request.app.state.written
    shared = follows_from is not None and request.scope["state"].get(GAPS)
    page = written.get(given) if shared else None
    if page is None:
        page = TEMPLATES.get_template(template).render(frame=frame, request=request, **values)
        if shared:
            written[given] = page
            while len(written) > MOST_WRITTEN:
                written.popitem(last=False)
    response = HTMLResponse(page, status_code=status_code, headers={**(headers or {}), "Cache-Control": "no-store"})
    if frame.flash:
        response.delete_cookie(FLASH_COOKIE, path="/")
    return response


def redirect(location: str, *, flash: str = "", level: str = "normal") -> RedirectResponse:
    """Answer a POST: send the browser to a page by GET, with one line to show there."""
    response = RedirectResponse(location, status_code=303)
    if flash:
        value = quote(json.dumps([level, flash]))
        response.set_cookie(FLASH_COOKIE, value, max_age=FLASH_SECONDS, path="/", httponly=True, samesite="lax")
    return response


def redirect_refused(location: str, refusal: Refusal) -> RedirectResponse:
    """Show why a form was refused as a line on the page that it stands on.

    What the server itself lacks is raised again, so that the answer says so by its status, and when to come back.
    """
    if refusal.is_ours:
        raise refusal.error
    return redirect(location, flash=refusal.sentence, level="serious")
