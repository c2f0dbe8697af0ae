"""Notes on one thing: the page by itself, and where the form of every notes panel goes."""

from __future__ import annotations

from functools import partial

from fastapi import Depends, Request
from fastapi.concurrency import contextmanager_in_threadpool
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import UploadFile

from boresight.console.access.dependencies import KNOWN, Blobs, Database, Reading, Who, csrf
from boresight.console.notes import attachments
from boresight.console.notes import service as notes
from boresight.console.notes.tables import Note
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, get_texts, make_change, read_again, render
from boresight.errors import BoresightError, NotFoundError
from boresight.platform.actors import Actor
from boresight.platform.blobs import files
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session

router = PageRouter(dependencies=[Depends(csrf)])

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
async def add(request: Request, actor: Who, blobs: Blobs, engine: Database, kind: str, subject_id: int) -> Response:
    """Add a note, with a file where one was chosen."""
    form = await request.form()
    text, chosen = get_texts(form).get("text", ""), form.get("file")
    sent = None
    if isinstance(chosen, UploadFile):
        sent = (chosen.filename, await chosen.read()) if chosen.filename else None
        await chosen.close()
    again = partial(_page, request, kind, subject_id, text)
    try:
        file = None if sent is None else _check(actor, *sent)
        change = partial(_add, actor=actor, blobs=blobs, kind=kind, subject_id=subject_id, text=text, file=file)
        contents = () if file is None else (file.content,)
        async with contextmanager_in_threadpool(files.stored_ahead(engine, blobs, *contents)):
            address = get_notes_address(kind, subject_id)
            return await make_change(request, change, address, "Your note is added.", again=again)
    except BoresightError as error:  # of the file alone: what is refused of the note is answered by then
        if isinstance(error, NotFoundError):
            raise
        return await read_again(request, partial(again, RefusalContext.of(error)))


def _check(actor: Actor, name: str, content: bytes) -> attachments.AttachedFile:
    """Refuse a person who may attach nothing, and a file that cannot be attached."""
    attachments.require_attacher(actor)
    return attachments.check_file(name, content)


def _add(
    session: Session,
    *,
    actor: Actor,
    blobs: BlobStore,
    kind: str,
    subject_id: int,
    text: str,
    file: attachments.AttachedFile | None,
) -> Note:
    note = notes.add_note(session, actor, kind, subject_id, text)
    if file is not None:
        attachments.attach(session, actor, blobs, note.id, file)
    return note
