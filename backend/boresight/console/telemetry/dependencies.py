"""Receiving a telemetry file: streamed to a folder of its own, never whole in memory, and removed with the request."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import AsyncIterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from fastapi import Depends
from python_multipart.multipart import parse_options_header
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import Request

from boresight.console.access.dependencies import ServerSettings
from boresight.console.operation import FORM_CONTENT
from boresight.console.telemetry import profiles
from boresight.console.telemetry import service as telemetry_sets
from boresight.disks import storage_error
from boresight.errors import RefusedInputError
from boresight.platform.db.sessions import Session
from boresight.platform.web.paging import parse_row_id
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.read.limits import Limits

HOW = "Send multipart/form-data with the fields sensor_id, purpose and file."
LONGEST_FIELD_BYTES = 4096
MOST_FIELDS = 20


@dataclass(frozen=True)
class Upload:
    """An upload: the form's fields, and its one file with the sender's name for it."""

    fields: Mapping[str, str]
    path: Path | None
    file_name: str

    def file(self) -> Path:
        """Return where the file is."""
        if self.path is None:
            raise RefusedInputError(f"There is no file in the request. {HOW}")
        return self.path

    def content(self) -> bytes:
        """Return fields and file as bytes, for the digest of the request."""
        with self.file().open("rb") as file:
            return repr(sorted(self.fields.items())).encode() + hashlib.file_digest(file, "sha256").digest()

    def number(self, name: str) -> int:
        """Return a field that is a number."""
        text = self.fields.get(name, "")
        number = parse_row_id(text)
        if number is None:
            raise RefusedInputError(f"The field {name} must be a number, not {text[:40]!r}. {HOW}")
        return number


class _Form(MultiPartParser):
    """The framework's parser, with the file of a form streamed to a place instead of to the system's temporary folder."""

    def __init__(self, request: Request, place: Path) -> None:
        super().__init__(
            request.headers, request.stream(), max_files=2, max_fields=MOST_FIELDS, max_part_size=LONGEST_FIELD_BYTES
        )
        self.has_file = self.is_whole = False
        self._file = place.open("wb")

    def on_headers_finished(self) -> None:
        """Open the part."""
        super().on_headers_finished()
        if (spooled := self._current_part.file) is not None:
            spooled.file.close()
            if self.has_file:
                raise RefusedInputError("One file at a time: send each telemetry file by itself.")
            self.has_file = True
            self._current_part.file = _OnDisk(self._file, filename=spooled.filename)

    def on_end(self) -> None:
        """Note that the end came."""
        self.is_whole = True

    async def parse(self) -> FormData:
        """Parse the request; the part of the file that arrived is written in any case."""
        with self._file:
            return await super().parse()


class _OnDisk(UploadFile):
    """A file that is written in place and without a thread, which would take longer than writing a piece."""

    async def write(self, data: bytes) -> None:
        """Write a piece."""
        self.file.write(data)


async def uploaded(
    request: Request,
    settings: ServerSettings,
) -> AsyncIterator[Upload]:
    """Stream the request's file to the disk and remove it before the answer is sent."""
    folder = settings.data_folder / "uploads"
    try:
        folder.mkdir(exist_ok=True)  # in the data folder, which is made when the server starts and never again
    except OSError as error:
        raise storage_error(error, folder) or error from error
    with tempfile.TemporaryDirectory(dir=folder) as place:
        upload = await _receive(request, Path(place) / "upload")
        setattr(request.state, FORM_CONTENT, upload.content)
        yield upload


async def _receive(request: Request, place: Path) -> Upload:
    content_type, options = parse_options_header(request.headers.get("content-type"))
    if content_type != b"multipart/form-data" or not options.get(b"boundary"):
        sent = content_type.decode(errors="replace") or "nothing"
        raise RefusedInputError(f"A telemetry file cannot be sent as {sent}. {HOW}")
    parser = _Form(request, place)
    try:
        form = await parser.parse()
    except MultiPartException as error:
        raise RefusedInputError(f"The upload is not a form that can be read ({error.message}). {HOW}") from error
    if not parser.is_whole:
        raise RefusedInputError("The upload broke off before its end; send it again.")
    fields = {name: value for name, value in form.items() if isinstance(value, str)}
    names = [value.filename or "" for _, value in form.multi_items() if isinstance(value, UploadFile)]
    return Upload(fields, place if names else None, "".join(names))


def import_request(session: Session, upload: Upload) -> telemetry_sets.ImportRequest | None:
    """Return by which profile a form wants its file imported; None where it names none."""
    key = upload.fields.get("profile", "").strip()
    if not key:
        return None
    fields = {name: upload.fields.get(name, "").strip() or None for name in ("time", "elements")}
    return telemetry_sets.ImportRequest(profiles.find_profile(session, key), **fields)


def prepare(
    sensor_document: Mapping[str, Any],
    catalogue: Catalogue | None,
    upload: Upload,
    wanted: telemetry_sets.ImportRequest | None,
    limits: Limits,
) -> AbstractContextManager[telemetry_sets.PreparedUpload]:
    """Check a form's file as telemetry, or import and check it."""
    if wanted is None:
        return telemetry_sets.hold_prepared(sensor_document, catalogue, upload.file(), upload.file_name, limits)
    return telemetry_sets.hold_imported(sensor_document, catalogue, upload.file(), upload.file_name, wanted, limits)


Uploaded = Annotated[Upload, Depends(uploaded, scope="function")]
