"""Taking in a telemetry file: streamed to the disk as it comes, never whole in memory.

The border (`middleware`) counts the bytes and ends the request with 413 at the limit, wherever the reading stands. The
file lives in a folder of its own inside the data folder for the time of the request, then it is gone: what is kept is
kept by the service, in the blob folder.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from fastapi import Depends
from fastapi.concurrency import run_in_threadpool
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import create_form_parser
from starlette.requests import Request

from boresight.api.answers import IdempotencyKey, Once, digest
from boresight.api.dependencies import current_actor
from boresight.errors import RefusedInputError
from boresight.services.actors import Actor

HOW = "Send multipart/form-data with the fields sensor_id, purpose and file."
LIMITS: dict[str, Any] = {
    "MAX_MEMORY_FILE_SIZE": 0,
    "UPLOAD_DELETE_TMP": False,
    "MAX_FIELDS": 20,
    "MAX_FIELD_SIZE": 4096,
}


@dataclass
class Upload:
    """What came: the fields, and the one file with the name that the sender gave it."""

    fields: dict[str, str] = field(default_factory=dict)
    path: Path | None = None
    file_name: str = ""

    def take_field(self, given: Any) -> None:
        """Keep a field."""
        self.fields[_text(given.field_name)] = _text(given.value)

    def take_file(self, given: Any) -> None:
        """Keep the file, which is on the disk already; an empty one is put there."""
        if self.path is not None:
            raise RefusedInputError("One file at a time: send each telemetry file by itself.")
        if given.in_memory:
            given.flush_to_disk()
        given.close()
        self.path, self.file_name = Path(_text(given.actual_file_name)), _text(given.file_name)

    def file(self) -> Path:
        """Return where the file is.

        Raises
        ------
        RefusedInputError
            When none was sent.
        """
        if self.path is None:
            raise RefusedInputError(f"There is no file in the request. {HOW}")
        return self.path

    def number(self, name: str) -> int:
        """Return a field that is a number.

        Raises
        ------
        RefusedInputError
            When it is missing or none.
        """
        text = self.fields.get(name, "")
        if not text.isdecimal():
            raise RefusedInputError(f"The field {name} must be a number, not {text!r}. {HOW}")
        return int(text)


def _text(value: bytes | None) -> str:
    """Decode what a browser sent as a name or a field."""
    return (value or b"").decode("utf-8", errors="replace")


async def uploaded(
    request: Request,
    actor: Annotated[Actor, Depends(current_actor)],  # noqa: ARG001 - nothing is read for nobody
) -> AsyncIterator[Upload]:
    """Stream the request's file to the disk and remove it when the request is over."""
    folder = request.app.state.settings.data_folder / "uploads"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as place:
        upload = Upload()
        await _receive(request, upload, place)
        yield upload


async def _receive(request: Request, upload: Upload, place: str) -> None:
    """Feed the body to the parser piece by piece."""
    content_type = request.headers.get("content-type", "")
    if not content_type.startswith("multipart/form-data"):
        raise RefusedInputError(f"A telemetry file cannot be sent as {content_type or 'nothing'}. {HOW}")
    config = {**LIMITS, "UPLOAD_DIR": place}
    headers = {"Content-Type": content_type.encode("latin-1")}
    try:
        parser = create_form_parser(headers, upload.take_field, upload.take_file, config)
        async for chunk in request.stream():
            parser.write(chunk)
        parser.finalize()
    except FormParserError as error:
        raise RefusedInputError(f"The upload broke off or is not a form ({error}). {HOW}") from error


async def once_uploaded(
    request: Request, upload: Annotated[Upload, Depends(uploaded)], idempotency_key: IdempotencyKey = None
) -> Once:
    """Read the key, and digest fields and file if there is one."""
    if not idempotency_key:
        return Once(None, "")
    content = repr(sorted(upload.fields.items())).encode() + await run_in_threadpool(_digest, upload.file())
    return Once(idempotency_key, digest(request, content))


def _digest(path: Path) -> bytes:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


Uploaded = Annotated[Upload, Depends(uploaded)]
UploadedOnce = Annotated[Once, Depends(once_uploaded)]
