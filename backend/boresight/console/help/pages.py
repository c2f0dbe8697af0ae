"""The pages of help: the glossary, and the settings of the server and of a calibration."""

from __future__ import annotations

from itertools import groupby

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse

from boresight.calibration.options import OPTIONS, format_value
from boresight.console.access.dependencies import same_for_roles
from boresight.console.help.glossary import list_terms
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import render
from boresight.settings import SETTINGS

router = PageRouter(dependencies=[Depends(same_for_roles)])


@router.get("/help/glossary", response_class=HTMLResponse)
def glossary_page(request: Request) -> HTMLResponse:
    """Show every term with its meaning."""
    groups = [(heading, list(terms)) for heading, terms in groupby(list_terms(), key=lambda term: term.heading)]
    return render(request, "help/glossary.html", groups=groups)


@router.get("/help/settings", response_class=HTMLResponse)
def settings_page(request: Request) -> HTMLResponse:
    """Show what can be set, of a calibration and of the server, with its default and meaning."""
    options = [(option, format_value(option.default)) for option in OPTIONS.values()]
    return render(request, "help/settings.html", options=options, settings=SETTINGS)
