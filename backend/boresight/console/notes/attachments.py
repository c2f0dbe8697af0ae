"""Files at notes: added by the note's author, of kinds that no browser runs, kept by the SHA-256 of their bytes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from boresight.console.notes.service import WRITERS
from boresight.console.notes.tables import Note, NoteAttachment
from boresight.errors import ConflictError, ForbiddenError, RefusedInputError
from boresight.platform.actors import Actor, require_person, require_role
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore, register_blob
from boresight.platform.db.sessions import Session, is_dry_run, utc_now
from boresight.platform.web.middleware import ATTACHMENT_LIMIT_BYTES
from boresight.platform.web.text_validation import normal_name

ENDINGS = (
    "csv", "fit", "fits", "gif", "jpeg", "jpg", "json", "jsonl", "log", "md", "ods", "odt", "parquet", "pdf", "png",
    "tif", "tiff", "txt", "xlsx", "yaml", "yml", "zip",
)  # fmt: skip
MOST_ATTACHMENTS = 10  # of a note
LONGEST_NAME = 120


@dataclass(frozen=True)
class AttachedFile:
    """A file that may be attached: its name and its bytes, which are stored before the transaction that attaches it."""

    name: str
    content: bytes


def check_file(sent_name: str, content: bytes) -> AttachedFile:
    """Refuse a file of another kind, or one that is empty or too large; only the last part of its name is kept."""
    name = normal_name("file name", sent_name.replace("\\", "/").rsplit("/", 1)[-1], LONGEST_NAME)
    stem, _, ending = name.rpartition(".")
    if not stem or ending.lower() not in ENDINGS:
        raise RefusedInputError(f"{name[:40]!r} cannot be attached; choose a file that ends in .{', .'.join(ENDINGS)}.")
    if not 0 < len(content) <= ATTACHMENT_LIMIT_BYTES:
        limit = f"{ATTACHMENT_LIMIT_BYTES / 1e6:g} MB"
        raise RefusedInputError(f"{name!r} has {len(content):,} bytes; choose a file of 1 byte to {limit}.")
    return AttachedFile(name, content)


def require_attacher(actor: Actor) -> int:
    """Return the number of a person who may attach files, and refuse everybody else before anything is stored."""
    user_id = require_person(actor, "attach a file")
    require_role(actor, *WRITERS)
    return user_id


def attach(session: Session, actor: Actor, blobs: BlobStore, note_id: int, file: AttachedFile) -> NoteAttachment:
    """Add a stored file to a note of one's own; nobody can change or remove it afterwards."""
    user_id = require_attacher(actor)
    note = session.get_known(Note, note_id)
    if note.user_id != user_id:
        raise ForbiddenError("Only the author of a note can attach files to it; write your own note.")
    if len(note.attachments) >= MOST_ATTACHMENTS:
        raise ConflictError(f"The note has {MOST_ATTACHMENTS} attachments; write another note.")
    size = len(file.content)
    sha256 = hashlib.sha256(file.content).hexdigest()
    blob = register_blob(session, blobs, sha256, "application/octet-stream", size if is_dry_run(session) else None)
    row = NoteAttachment(note_id=note_id, name=file.name, sha256=blob.sha256, size_bytes=size, made_utc=utc_now())
    session.put(row)
    session.expire(note, ["attachments"])
    after = {"name": row.name, "sha256": row.sha256, "size_bytes": row.size_bytes}
    audit.append(session, actor, "attached", f"{note.subject_kind}/{note.subject_id}/notes/{note_id}", None, after)
    return row
