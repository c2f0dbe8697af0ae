"""Uplink packages: build one of an approved set or the baseline, list them, read the ZIP."""

from __future__ import annotations

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Held, Reading, Who, Writing
from boresight.api.media import ZipFile
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import packages

router = APIRouter(tags=["uplinks"])


class Export(BaseModel):
    """What the spacecraft has; said, the package is refused for anything else."""

    model_config = ConfigDict(extra="forbid")
    flight_software_version: str | None = Field(None, examples=["4.2.1"])
    table_id: str | None = Field(None, examples=["STR_CAM"])


@router.post(
    "/parameter-sets/{parameter_set_id}:export",
    name="export_parameter_set",
    summary="Build the uplink package",
    status_code=201,
    response_model=schemas.Package,
    responses=refusals(404, 409, 412),
)
def export_parameter_set(
    parameter_set_id: Id,
    actor: Who,
    once: Idempotent,
    policy: Held,
    session: Writing,
    request: Request,
    export: Export | None = None,
) -> Response:
    """Build the package of an approved set or the baseline; built again of the same, it is the one that exists."""
    said = {} if export is None else export.model_dump()

    def act() -> Answer:
        row = packages.build(session, actor, request.app.state.blobs, parameter_set_id, policy=policy, **said)
        return Answer(schemas.written(schemas.Package, row), 201, {"Location": f"/api/v1/packages/{row.id}"})

    return once.answer(session, actor, act)


@router.get("/packages", name="list_packages", summary="List packages", response_model=Page[schemas.Package])
def list_packages(
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
    parameter_set_id: Id | None = None,
    sensor_id: Id | None = None,
) -> Response:
    """List the packages that were built, newest first."""
    found = packages.list_packages(
        session, parameter_set_id=parameter_set_id, sensor_id=sensor_id, before_id=page.last_id, limit=page.limit + 1
    )
    return json_response(page.cut(found, lambda row: schemas.written(schemas.Package, row)))


@router.get(
    "/packages/{package_id}",
    name="get_package",
    summary="Read a package's entry",
    response_model=schemas.Package,
    responses=refusals(404),
)
def get_package(package_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read whose package it is and what it is for; `/content` is the file."""
    return json_response(schemas.written(schemas.Package, packages.get_package(session, package_id)))


@router.get(
    "/packages/{package_id}/content",
    name="get_package_content",
    summary="Read a package",
    response_class=ZipFile,
    responses=refusals(404, 409),
)
def get_package_content(
    package_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    request: Request,
) -> Response:
    """Read the ZIP, its bytes checked against their hash."""
    row = packages.get_package(session, package_id)
    content = packages.read(session, request.app.state.blobs, package_id)
    headers = {
        "Content-Disposition": f'attachment; filename="{packages.file_name(session, row)}"',
        "ETag": f'"{row.sha256}"',
    }
    return ZipFile(content, headers=headers)
