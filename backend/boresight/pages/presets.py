"""Presets: Boresight's own and the mission's, with every version and who saved it."""

from __future__ import annotations

from functools import partial

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Reading, Who, csrf
from boresight.calibration.options import CalibrationSettings
from boresight.pages.attempts import attempt
from boresight.pages.launch_summary import differences
from boresight.pages.rendering import redirect, redirect_refused, render
from boresight.pages.runs import read_names
from boresight.services import presets

router = APIRouter(dependencies=[Depends(csrf)])

MOST_SHOWN = 500


@router.get("/presets", response_class=HTMLResponse)
def presets_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """List every preset, each with what it changes of the usual settings."""
    saved = presets.list_presets(session, archived=True)
    usual = CalibrationSettings().document()
    changes = {offer.key: differences(usual, offer.settings) for offer in presets.BUILT_IN}
    changes |= {str(row.id): differences(usual, row.document) for row in saved}
    return render(
        request,
        "runs/presets.html",
        own=presets.BUILT_IN,
        saved=saved,
        changes=changes,
        people=read_names(session).people,
        may="analyst" in actor.roles,
    )


@router.post("/presets/{preset_id:int}/archive", response_class=HTMLResponse)
async def archive(request: Request, actor: Who, preset_id: int) -> Response:
    """Take a version out of the choice."""
    outcome = await attempt(request, partial(presets.archive_preset, actor=actor, preset_id=preset_id))
    if outcome.refusal is not None:
        return redirect_refused("/presets", outcome.refusal)
    return redirect("/presets", flash="Archived: it is not offered any more. Runs that used it still name it.")
