"""Receiving a telemetry file: streamed to a folder of its own, never whole in memory, and removed with the request."""

from __future__ import annotations

import hashlib
import hmac
import io
import tempfile
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from fastapi import Depends
from python_multipart.multipart import parse_options_header
from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import Request

from boresight.console.access.dependencies import CSRF_FIELD, ServerSettings
from boresight.console.fleet.tables import Sensor
from boresight.console.operation import FORM_CONTENT
from boresight.console.telemetry import profiles
from boresight.console.telemetry import service as telemetry_sets
from boresight.disks import storage_error
from boresight.errors import ForbiddenError, RefusedInputError
from boresight.images.limits import ImageSource, is_image
from boresight.platform.db.sessions import Engine, Session, open_reading
from boresight.platform.db.times import read_time
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.web.paging import parse_row_id
from boresight.platform.web.text_validation import normal_name
from boresight.settings import Settings

HOW = "Send multipart/form-data with the fields sensor_id, purpose and file; images may be several files."
LONGEST_FIELD_BYTES = 4096
MOST_FIELDS = 20


@dataclass(frozen=True)
class Upload:
    """An upload: the form's fields, and its one file with the sender's name for it, or several images."""

    fields: Mapping[str, str]
    path: Path | None
    file_name: str
    images: tuple[ImageSource, ...] = ()

    def file(self) -> Path:
        """Return where the file is."""
        if self.path is None:
            raise RefusedInputError(f"There is no file in the request. {HOW}")
        return self.path

    def content(self) -> bytes:
        """Return fields and files as bytes, for the digest of the request."""
        parts = [repr(sorted(self.fields.items())).encode()]
        for path in [one.path for one in self.images] or [self.file()]:
            with path.open("rb") as file:
                parts.append(hashlib.file_digest(file, "sha256").digest())
        return b"".join(parts)

    def number(self, name: str) -> int:
        """Return a field that is a number."""
        text = self.fields.get(name, "")
        number = parse_row_id(text)
        if number is None:
            raise RefusedInputError(f"The field {name} must be a number, not {text[:40]!r}. {HOW}")
        return number


class _Form(MultiPartParser):
    """The framework's parser, with the files of a form streamed to a folder instead of to the system's temporary one."""

    def __init__(self, request: Request, folder: Path, most_images: int) -> None:
        super().__init__(
            request.headers,
            request.stream(),
            max_files=most_images + 1,
            max_fields=MOST_FIELDS,
            max_part_size=LONGEST_FIELD_BYTES,
        )
        self.is_whole = False
        self.files: list[tuple[Path, str]] = []
        self._folder = folder

    def on_headers_finished(self) -> None:
        """Open the part."""
        super().on_headers_finished()
        if (spooled := self._current_part.file) is not None:
            spooled.file.close()
            path, name = self._folder / f"upload-{len(self.files)}", spooled.filename or ""
            self.files.append((path, name))
            if len(self.files) > 1 and not all(is_image(Path(one)) for _, one in self.files):
                raise RefusedInputError(
                    "Send one telemetry file at a time; only images may be several.", code="one-file-at-a-time"
                )
            self._current_part.file = _OnDisk(path, spooled.filename)

    def on_end(self) -> None:
        """Note that the end came."""
        self.is_whole = True


class _OnDisk(UploadFile):
    """A file that is written in place and without a thread, which would take longer than writing a piece.

    It is opened for each piece: of a thousand images no more than one needs a handle, whenever the parser writes to which.
    """

    def __init__(self, path: Path, name: str | None) -> None:
        super().__init__(io.BytesIO(), filename=name)
        self._path = path
        path.touch()

    async def write(self, data: bytes) -> None:
        """Write a piece."""
        with self._path.open("ab") as file:
            file.write(data)


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
        upload = await _receive(request, Path(place), settings.images)
        setattr(request.state, FORM_CONTENT, upload.content)
        yield upload


async def _receive(request: Request, folder: Path, most_images: int) -> Upload:
    content_type, options = parse_options_header(request.headers.get("content-type"))
    if content_type != b"multipart/form-data" or not options.get(b"boundary"):
        sent = content_type.decode(errors="replace") or "nothing"
        raise RefusedInputError(f"A telemetry file cannot be sent as {sent}. {HOW}")
    parser = _Form(request, folder, most_images)
    try:
        form = await parser.parse()
    except MultiPartException as error:
        raise RefusedInputError(f"The upload is not a form that can be read ({error.message}). {HOW}") from error
    if not parser.is_whole:
        raise RefusedInputError("The upload was interrupted; send it again.")
    fields = {name: value for name, value in form.items() if isinstance(value, str)}
    if not parser.files:
        return Upload(fields, None, "")
    path, name = parser.files[0]
    if not is_image(Path(name)):
        return Upload(fields, path, name)
    images = tuple(ImageSource(place, _base_name(sent)) for place, sent in parser.files)
    others = f" and {len(images) - 1} more" if len(images) > 1 else ""
    return Upload(fields, path, f"{images[0].name}{others}.zip", images)


def _base_name(sent: str) -> str:
    return normal_name("file name", sent.replace("\\", "/").rsplit("/", 1)[-1]) or "image"


def import_request(session: Session, upload: Upload) -> telemetry_sets.ImportRequest | None:
    """Return by which profile a form wants its file imported; None where it names none and asks for no preview of the likeliest."""
    key, preview = (upload.fields.get(name, "").strip() for name in ("profile", "preview"))
    if not key and not preview:
        return None
    time, elements = (upload.fields.get(name, "").strip() or None for name in ("time", "elements"))
    profile = profiles.find_profile(session, key) if key else None
    offers = () if key else tuple(offer.profile for offer in profiles.list_offers(session))
    return telemetry_sets.ImportRequest(profile, time and read_time(time), elements, offers)


def _is_kept(upload: Upload) -> bool:
    """Whether a form keeps its set although it is of another sensor's camera: 1, or nothing."""
    said = upload.fields.get("keep_here", "")
    if said not in {"", "1"}:
        raise RefusedInputError(f"keep_here is {said[:20]!r}; send 1 to keep the set here, or omit it.")
    return said == "1"


@contextmanager
def hold_upload(
    upload: Upload, settings: Settings, forecast_sources: ForecastSources, engine: Engine
) -> Iterator[telemetry_sets.PreparedUpload]:
    """Check a form's file before the writing transaction: telemetry, what a mapping profile imports, or images."""
    with open_reading(engine) as session:
        sensor_id = upload.number("sensor_id")
        document = session.get_known(Sensor, sensor_id).document
        cameras = telemetry_sets.read_cameras(session, sensor_id, kept=_is_kept(upload))
        wanted = import_request(session, upload)
    images = telemetry_sets.ImageUpload(upload.images, settings.image_limits, settings.image_seconds)
    with telemetry_sets.hold_prepared(
        document,
        forecast_sources.catalogue(),
        upload.file(),
        upload.file_name,
        settings.telemetry_limits,
        forecast_sources.catalogue_folder,
        images,
        wanted,
        cameras=cameras,
    ) as prepared:
        forecast_sources.blobs.send_ahead(prepared.original, prepared.table)
        yield prepared


def require_meant(request: Request, upload: Upload) -> None:
    """Refuse a form without this log-in's CSRF token, which is checked here because the streamed body is read only once."""
    given, expected = upload.fields.get(CSRF_FIELD, ""), getattr(request.state, CSRF_FIELD, None)
    if expected is not None and not hmac.compare_digest(given.encode(), expected.encode()):
        raise ForbiddenError("This form belongs to another log-in; reload the page and choose the file again.")


Uploaded = Annotated[Upload, Depends(uploaded, scope="function")]
