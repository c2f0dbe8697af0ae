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
from typing import TYPE_CHECKING, Annotated, BinaryIO

from fastapi import Depends
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import Request

from boresight.console.access.credentials import who_acts
from boresight.console.operation import FORM_CONTENT
from boresight.disks import storage_error
from boresight.errors import RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.web.paging import row_number

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks  # there for type checkers only

HOW = "Send multipart/form-data with the fields sensor_id, purpose and file."
LONGEST_FIELD_BYTES = 4096
MOST_PARTS = 20


@dataclass
class Upload:
    """What came: the fields, and the one file with the name that the sender gave it."""

    place: Path
    fields: dict[str, str] = field(default_factory=dict)
    path: Path | None = None
    file_name: str = ""

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

    def content(self) -> bytes:
        """Return fields and file, to be digested."""
        with self.file().open("rb") as file:
            return repr(sorted(self.fields.items())).encode() + hashlib.file_digest(file, "sha256").digest()

    def number(self, name: str) -> int:
        """Return a field that is a number.

        Raises
        ------
        RefusedInputError
            When it is missing or none.
        """
        text = self.fields.get(name, "")
        number = row_number(text)
        if number is None:
            raise RefusedInputError(f"The field {name} must be a number, not {text[:40]!r}. {HOW}")
        return number


class _Form:
    """Takes the parts of a form as the parser meets them."""

    def __init__(self, upload: Upload) -> None:
        self._upload = upload
        self._header = [b"", b""]
        self._disposition: dict[bytes, bytes] = {}
        self._value = bytearray()
        self._file: BinaryIO | None = None
        self._parts = 0
        self.complete = False

    def callbacks(self) -> MultipartCallbacks:
        """Return what the parser calls."""
        return {
            "on_part_begin": self._begin,
            "on_header_field": lambda data, start, end: self._add_to_header(0, data[start:end]),
            "on_header_value": lambda data, start, end: self._add_to_header(1, data[start:end]),
            "on_header_end": self._end_header,
            "on_headers_finished": self._open,
            "on_part_data": lambda data, start, end: self._add(data[start:end]),
            "on_part_end": self._end,
            "on_end": self._finish,
        }

    def close(self) -> None:
        """Let go of a file whose end did not come."""
        if self._file is not None:
            self._file.close()

    def _begin(self) -> None:
        self._parts += 1
        if self._parts > MOST_PARTS:
            raise RefusedInputError(f"The form has over {MOST_PARTS} parts. {HOW}")
        self._disposition = {}
        self._value.clear()

    def _add_to_header(self, which: int, piece: bytes) -> None:
        self._header[which] += piece

    def _end_header(self) -> None:
        name, value = self._header
        if name.lower() == b"content-disposition":
            self._disposition = parse_options_header(value)[1]
        self._header = [b"", b""]

    def _open(self) -> None:
        """Open the file when the part is one."""
        if b"filename" not in self._disposition:
            return
        if self._upload.path is not None:
            raise RefusedInputError("One file at a time: send each telemetry file by itself.")
        self._upload.path = self._upload.place / "upload"
        self._upload.file_name = _text(self._disposition[b"filename"])
        self._file = self._upload.path.open("wb")

    def _add(self, piece: bytes) -> None:
        """Take a piece of a file or of a field."""
        if self._file is not None:
            self._file.write(piece)
            return
        self._value += piece
        if len(self._value) > LONGEST_FIELD_BYTES:
            raise RefusedInputError(f"A field of the form is over {LONGEST_FIELD_BYTES} bytes. {HOW}")

    def _end(self) -> None:
        """Close the file, or keep the field."""
        if self._file is not None:
            self._file.close()
            self._file = None
        else:
            self._upload.fields[_text(self._disposition.get(b"name"))] = _text(bytes(self._value))

    def _finish(self) -> None:
        self.complete = True


def _text(value: bytes | None) -> str:
    """Decode what a browser sent as a name or a field."""
    return (value or b"").decode("utf-8", errors="replace")


async def uploaded(
    request: Request,
    actor: Annotated[Actor, Depends(who_acts)],  # noqa: ARG001 - nothing is read for nobody
) -> AsyncIterator[Upload]:
    """Stream the request's file to the disk and remove it before the answer is sent."""
    folder = request.app.state.settings.data_folder / "uploads"
    try:
        folder.mkdir(exist_ok=True)  # in the data folder, which is made when the server starts and never again
    except OSError as error:
        raise storage_error(error, folder) or error from error
    with tempfile.TemporaryDirectory(dir=folder) as place:
        upload = Upload(Path(place))
        await _receive(request, upload)
        setattr(request.state, FORM_CONTENT, upload.content)
        yield upload


async def _receive(request: Request, upload: Upload) -> None:
    """Feed the body to the parser piece by piece."""
    content_type, options = parse_options_header(request.headers.get("content-type"))
    if content_type != b"multipart/form-data" or not options.get(b"boundary"):
        raise RefusedInputError(f"A telemetry file cannot be sent as {_text(content_type) or 'nothing'}. {HOW}")
    form = _Form(upload)
    try:
        parser = MultipartParser(options[b"boundary"], form.callbacks())
        async for chunk in request.stream():
            parser.write(chunk)
    except FormParserError as error:
        raise RefusedInputError(f"The upload is not a form that can be read ({error}). {HOW}") from error
    finally:
        form.close()
    if not form.complete:
        raise RefusedInputError("The upload broke off before its end; send it again.")


Uploaded = Annotated[Upload, Depends(uploaded, scope="function")]
