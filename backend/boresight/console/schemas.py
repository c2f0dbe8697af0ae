"""What all response schemas share: a row's columns as JSON, its ETag and its address."""

from __future__ import annotations

import hashlib
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, WithJsonSchema

from boresight.calibration import options

Document = dict[str, Any]
#: Choices of a calibration; `calibration.options` refuses what is none.
Settings = Annotated[Document, WithJsonSchema(options.schema())]


def multipart(required: tuple[str, ...], **fields: Document) -> Document:
    """Describe the form that an operation takes, as OpenAPI has it: which fields must be there, and a schema of each."""
    schema = {"type": "object", "required": list(required), "properties": fields}
    return {"requestBody": {"required": True, "content": {"multipart/form-data": {"schema": schema}}}}


def file_field(description: str) -> Document:
    """Describe a field that is a file."""
    return {"type": "string", "format": "binary", "description": description}


class Row(BaseModel):
    """A row of the store, read by its columns."""

    model_config = ConfigDict(from_attributes=True)

    versioned_by: ClassVar[
        tuple[str, ...]
    ] = ()  # the attributes that its transitions change; without any it has no ETag
    moves_beneath: ClassVar[bool] = False  # whether more may change than the tag tells of (RFC 9110, 8.8.1)
    location: ClassVar[str] = ""  # its address, with attributes in braces

    @classmethod
    def etag(cls, row: Any) -> str:
        """Return the entity tag of a row: its version, or the hash of what its transitions change."""
        values = tuple(getattr(row, name) for name in cls.versioned_by)
        if cls.versioned_by in {("version",), ("number",)}:
            return f'"v{values[0]}"'
        return f'"{hashlib.sha256(repr(values).encode()).hexdigest()[:16]}"'

    @classmethod
    def headers(cls, row: Any, status: int) -> dict[str, str]:
        """Return the headers of an answer that shows a row: its tag, and where it was made its address."""
        headers = {}
        if cls.versioned_by:
            headers["ETag"] = f"W/{cls.etag(row)}" if cls.moves_beneath else cls.etag(row)
        if cls.location and status in {201, 202}:
            headers["Location"] = f"/api/v1{cls.location.format(row=row)}"
        return headers


Values = dict[str, float | None]
Numbers = list[float | None]


class Shape(BaseModel):
    """A document of which every member is listed."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)
