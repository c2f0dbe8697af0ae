"""Answers that are files, by their media type, and tables as CSV files to download."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from fastapi import Query
from starlette.responses import FileResponse, Response

Table = Mapping[str, Sequence[Any]]  # columns by name


class CsvFile(Response):
    """A table; the first line names its columns."""

    media_type = "text/csv"


class ZipFile(Response):
    """An archive."""

    media_type = "application/zip"


class StoredFile(FileResponse):
    """Uploaded bytes, always sent as a download and never as a page."""

    media_type = "application/octet-stream"

    # the framework reads the status of an operation from this signature
    def __init__(self, path: Path, status_code: int = 200, *, filename: str, headers: Mapping[str, str]) -> None:
        super().__init__(path, status_code, filename=filename, headers=headers, media_type=self.media_type)


class CameraFile(Response):
    """A camera as a file of another program, which is downloaded under its name."""

    media_type = "application/octet-stream"

    def __init__(self, content: bytes | str, name: str, status_code: int = 200) -> None:
        super().__init__(content, status_code, headers={"Content-Disposition": f'attachment; filename="{name}"'})


#: What is asked of a camera that leaves: in which format, how well, and with the residual or without.
CameraFormat = Annotated[
    str, Query(examples=["opencv"], description="The format, one that `boresight convert` writes.")
]
CameraMisfit = Annotated[
    float | None,
    Query(
        ge=0,
        allow_inf_nan=False,
        description="Maximum misfit in pixels; the format's share of centroid_sigma_px if omitted.",
    ),
]
WithResidual = Annotated[
    bool, Query(description="Also follow the residual spline of its calibration, where it is beyond the noise.")
]


class PythonFile(Response):
    """A program."""

    media_type = "text/x-python"


class PemFile(Response):
    """Keys."""

    media_type = "application/x-pem-file"


class PrometheusText(Response):
    """Series in the exposition format."""

    media_type = "text/plain; version=0.0.4"


def csv_text(table: Table) -> str:
    """Write columns as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    length = max((len(column) for column in table.values()), default=0)
    for k in range(length):
        writer.writerow([column[k] if k < len(column) and column[k] is not None else "" for column in table.values()])
    return text.getvalue()


def csv_response(table: Table, file_name: str) -> Response:
    """Answer with a table as a file."""
    headers = {"Content-Disposition": f'attachment; filename="{file_name}"'}
    return CsvFile(csv_text(table), headers=headers)
