"""The files of the pages: style, modules, Plotly and Swagger UI as their Python packages ship them; and the documentation.

Both are for everybody: they tell nothing of the installation, and who cannot log in reads there why.

A page names each static file by an address that contains the version of them all, a digest of their contents. What is
there never changes, so a browser asks for it once and not again with every page; a module finds those that it imports
beside itself, under the same version. Without a version, or with another server's, the browser asks each time.
"""

from __future__ import annotations

import gzip
import hashlib
import mimetypes
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import fastapi_swagger
import plotly
from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from boresight.errors import NotFoundError
from boresight.platform.web.middleware import takes_gzip
from boresight.resources import folder

SWAGGER = Path(str(fastapi_swagger.__file__)).parent / "resources"
SHIPPED = {
    "plotly.min.js": Path(str(plotly.__file__)).parent / "package_data" / "plotly.min.js",
    "swagger-ui-bundle.js": SWAGGER / "swagger-ui-bundle.js",
    "swagger-ui.css": SWAGGER / "swagger-ui.css",
}
NO_DOCUMENTATION = (
    "The documentation is not available yet: try again in a minute, or run `make docs` in the source folder."
)
COMPRESS_FROM_BYTES = 1024
CACHED = "public, no-cache"  # the browser caches it, but revalidates
CACHED_FOR_A_YEAR = "public, max-age=31536000, immutable"
TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".woff2": "font/woff2"}
COMPRESSED_TYPES = ("text/javascript", "text/css", "image/svg+xml")

router = APIRouter(include_in_schema=False)


@dataclass(frozen=True)
class Content:
    """A static file's content."""

    plain: bytes
    compressed: bytes | None
    media_type: str
    sha256: str


@lru_cache(maxsize=256)
def _content(path: Path, changed_ns: int) -> Content:  # noqa: ARG001 - the time of change is part of the key
    """Read, hash and compress a file, again only after it changed."""
    plain = path.read_bytes()
    media_type = TYPES.get(path.suffix) or mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    worth = media_type in COMPRESSED_TYPES and len(plain) >= COMPRESS_FROM_BYTES
    compressed = gzip.compress(plain, 6, mtime=0) if worth else None
    return Content(plain, compressed, media_type, _digest(plain))


def _file_path(name: str) -> Path:
    """Return the file of a name inside the static folder; refuse names outside it."""
    if name in SHIPPED:
        return SHIPPED[name]
    return _inside(folder("frontend") / "static", name, "There is no such file here; reload the page that needs it.")


@cache
def _digests() -> dict[str, str]:
    """Return the digest of each static file by its name, as they were when first asked for."""
    top = folder("frontend") / "static"
    files = {path.relative_to(top).as_posix(): path for path in top.rglob("*") if path.is_file()} | SHIPPED
    return {name: _digest(path.read_bytes()) for name, path in files.items()}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


@cache
def static_version() -> str:
    """Return the version of the static files, as they were when it was first asked for."""
    return _digest(repr(sorted(_digests().items())).encode())[:16]


def has_documentation() -> bool:
    """Tell whether the documentation was built, so that a page may lead there."""
    try:
        return (folder("documentation") / "index.html").is_file()
    except FileNotFoundError:
        return False


def _page(name: str) -> Path:
    """Return the file of a page of the documentation, or of what belongs to it."""
    try:
        top = folder("documentation")
    except FileNotFoundError:
        raise NotFoundError(NO_DOCUMENTATION) from None
    name = f"{name}index.html" if name.endswith("/") or not name else name
    return _inside(top, name, "The documentation has no such page; search in it, or start at /docs/.")


def _inside(top: Path, name: str, otherwise: str) -> Path:
    """Return the file of a name inside a folder; refuse names outside it."""
    top = top.resolve()
    try:
        place = (top / name).resolve()
        is_ours = place.is_relative_to(top) and place.is_file()
    except (OSError, ValueError):  # an impossible file name
        is_ours = False
    if not is_ours:
        raise NotFoundError(otherwise)
    return place


@router.get("/static/version-{version}/{name:path}", name="versioned static")
def versioned_static_file(version: str, name: str, request: Request) -> Response:
    """Send a static file that the browser need not ask for again, unless an update has replaced it under this server."""
    return _send(_file_path(name), request, _digests().get(name) if version == static_version() else None)


@router.get("/static/{name:path}", name="static")
def static_file(name: str, request: Request) -> Response:
    """Send a static file, or 304 if the browser's copy is current."""
    return _send(_file_path(name), request)


@router.get("/docs", name="documentation")
def documentation() -> RedirectResponse:
    """Lead to the first page of the documentation."""
    return RedirectResponse("/docs/")


@router.get("/docs/{name:path}", name="documentation page")
def documentation_page(name: str, request: Request) -> Response:
    """Send a page of the documentation, or what belongs to it."""
    return _send(_page(name), request)


def _send(place: Path, request: Request, lasting_sha256: str | None = None) -> Response:
    content = _content(place, place.stat().st_mtime_ns)
    cached = CACHED_FOR_A_YEAR if content.sha256 == lasting_sha256 else CACHED
    zipped = content.compressed is not None and takes_gzip(request.headers.get("accept-encoding", "").encode())
    tag = f'"{content.sha256}{"-gz" if zipped else ""}"'
    headers = {"ETag": tag, "Cache-Control": cached}
    if zipped:  # to a plain one the compressing middleware adds it
        headers["Vary"] = "Accept-Encoding"
    if tag in [known.strip() for known in request.headers.get("if-none-match", "").split(",")]:
        return Response(status_code=304, headers=headers)
    if zipped:
        headers["Content-Encoding"] = "gzip"
    body = content.compressed if zipped and content.compressed is not None else content.plain
    return Response(body, headers=headers, media_type=content.media_type)
