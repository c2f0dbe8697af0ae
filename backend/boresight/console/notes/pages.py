"""Notes on one thing: the page by itself, and where the form of every notes panel goes."""

from __future__ import annotations

from functools import partial

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import UploadFile

from boresight.console.access.dependencies import KNOWN, Blobs, Reading, Who, csrf
from boresight.console.notes import attachments
from boresight.console.notes import service as notes
from boresight.console.notes.tables import Note
from boresight.console.pages.rendering import RefusalContext, get_texts, make_change, render
from boresight.platform.actors import Actor
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session

router = APIRouter(dependencies=[Depends(csrf)])

WORDS = {"runs": "run", "sensors": "sensor", "parameter-sets": "parameter set"}


def get_notes_address(kind: str, subject_id: int) -> str:
    """Return where the notes of a thing are shown."""
    part = "?part=record" if kind == "runs" else ""
    return f"/{kind}/{subject_id}{part}#notes"


@router.get("/notes/{kind}/{subject_id:int}", response_class=HTMLResponse, dependencies=[KNOWN])
def notes_page(request: Request, session: Reading, kind: str, subject_id: int) -> HTMLResponse:
    """Show the notes on a thing."""
    return _page(request, kind, subject_id, "", None, session)


def _page(
    request: Request,
    kind: str,
    subject_id: int,
    typed: str,
    refusal: RefusalContext | None,
    session: Session,
) -> HTMLResponse:
    return render(
        request,
        "notes/notes.html",
        refused=refusal,
        notes=notes.list_notes(session, kind, subject_id),
        kind=kind,
        subject_id=subject_id,
        subject=f"{WORDS.get(kind, kind)} {subject_id}",
        address=get_notes_address(kind, subject_id),
        typed=typed,
        refusal=refusal.sentence if refusal else "",
    )


@router.post("/notes/{kind}/{subject_id:int}", response_class=HTMLResponse)
async def add(request: Request, actor: Who, blobs: Blobs, kind: str, subject_id: int) -> Response:
    """Add a note, with a file where one was chosen."""
    form = await request.form()
    text, file = get_texts(form).get("text", ""), form.get("file")
    sent = None
    if isinstance(file, UploadFile):
        sent = (file.filename, await file.read()) if file.filename else None
        await file.close()
    change = partial(_add, actor=actor, blobs=blobs, kind=kind, subject_id=subject_id, text=text, sent=sent)
    again = partial(_page, request, kind, subject_id, text)
    return await make_change(request, change, get_notes_address(kind, subject_id), "Your note is added.", again=again)


def _add(
    session: Session,
    *,
    actor: Actor,
    blobs: BlobStore,
    kind: str,
    subject_id: int,
    text: str,
    sent: tuple[str, bytes] | None,
) -> Note:
    file = None if sent is None else attachments.check_file(*sent)
    note = notes.add_note(session, actor, kind, subject_id, text)
    if file is not None:
        attachments.attach(session, actor, blobs, note.id, file)
    return note
