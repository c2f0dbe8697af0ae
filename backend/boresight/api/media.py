"""Answers that are files, by their media type: what the OpenAPI document says of them, and how they are sent."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from starlette.responses import FileResponse, Response


class CsvFile(Response):
    """A table; the first line names its columns."""

    media_type = "text/csv"


class ZipFile(Response):
    """An archive."""

    media_type = "application/zip"


class StoredFile(FileResponse):
    """Bytes as somebody uploaded them: never guessed to be a page, whatever their name says."""

    media_type = "application/octet-stream"

    def __init__(self, path: Path, status_code: int = 200, *, filename: str, headers: Mapping[str, str]) -> None:
        super().__init__(path, status_code, filename=filename, headers=headers, media_type=self.media_type)


class PythonFile(Response):
    """A program."""

    media_type = "text/x-python"


class PrometheusText(Response):
    """Series in the exposition format."""

    media_type = "text/plain; version=0.0.4"
