"""Documents that are computed when they are read: figures, trends, comparisons, conversions, what held at a time."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from boresight.console.schemas import _Shape


class Health(_Shape):
    """That the process answers."""

    status: Literal["ok"]


class Check(BaseModel):
    """One part of the server."""

    model_config = ConfigDict(extra="allow")
    ready: bool
    detail: str | None = None


class Readiness(_Shape):
    """Whether store, files and workers are there."""

    status: Literal["ready", "not ready"]
    checks: dict[str, Check] | None = Field(None, description="For whoever is known.")
