"""What all response schemas share: a row's columns as JSON, its ETag and its address."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Annotated, Any, ClassVar, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema, create_model

from boresight.calibration import calibration, options

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


def make_shape(document: type, **replaced: Any) -> type[Shape]:
    """Make the shape of one of our own documents from its dataclass: every member is listed and always there.

    A description and examples come from a field's metadata; `replaced` are members that REST describes otherwise.
    """
    types = get_type_hints(document) | replaced
    members: dict[str, Any] = {}
    for one in fields(document):
        name = {"schema": "document_schema"}.get(one.name, one.name)  # pydantic has a method of that name
        alias = None if name == one.name else one.name
        members[name] = (_convert(types[one.name]), Field(alias=alias, **one.metadata))
    return create_model(document.__name__, __base__=Shape, __doc__=document.__doc__, **members)


def _convert(kind: Any) -> Any:
    """Return a member's type as pydantic takes it: documents inside as shapes, and values by name as an object."""
    if isinstance(kind, type) and is_dataclass(kind):
        return make_shape(kind)
    if get_origin(kind) is calibration.Values:
        return Values
    if get_origin(kind) is list:
        return list[_convert(get_args(kind)[0])]  # type: ignore[misc]
    if get_origin(kind) is UnionType:
        return Union[tuple(map(_convert, get_args(kind)))]  # noqa: UP007 - made at run time, of as many kinds as there are
    return kind
