"""What every shape has in common: the columns of a row of the store, written as JSON."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict

Document = dict[str, Any]


class Row(BaseModel):
    """A row of the store, read by its columns."""

    model_config = ConfigDict(from_attributes=True)


def written(shape: type[Row], row: Any) -> Document:
    """Write a row in one of the shapes."""
    return shape.model_validate(row).model_dump(mode="json")
