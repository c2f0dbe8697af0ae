"""Uplink packages: build one of an approved set or the baseline, list them, read the ZIP."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from boresight.api import schemas
from boresight.api.dependencies import Blobs, Held, Reading, Who, Writing
from boresight.api.media import ZipFile
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.operation import operations
from boresight.api.paging import Listing, Page, Paged
from boresight.services import packages
from boresight.store.tables import Package

router = operations(tags=["uplinks"])


class Export(BaseModel):
    """What the spacecraft has; said, the package is refused for anything else."""

    model_config = ConfigDict(extra="forbid")
    flight_software_version: str | None = Field(None, examples=["4.2.1"])
    table_id: str | None = Field(None, examples=["STR_CAM"])


@router.post(
    "/parameter-sets/{parameter_set_id}:export",
    summary="Build the uplink package",
    status_code=201,
    response_model=schemas.Package,
    responses=refusals(412),
)
def export_parameter_set(
    parameter_set_id: Id, actor: Who, policy: Held, session: Writing, blobs: Blobs, export: Export | None = None
) -> Package:
    """Build the package of an approved set or the baseline; built again of the same, it is the one that exists."""
    said = {} if export is None else export.model_dump()
    return packages.build(session, actor, blobs, parameter_set_id, policy=policy, **said)


@router.get("/packages", summary="List packages", response_model=Page[schemas.Package])
def list_packages(
    session: Reading, page: Paged, parameter_set_id: Id | None = None, sensor_id: Id | None = None
) -> Listing[Package]:
    """List the packages that were built, newest first."""
    found = packages.list_packages(
        session, parameter_set_id=parameter_set_id, sensor_id=sensor_id, before_id=page.last_id, limit=page.limit + 1
    )
    return page.cut(found)


@router.get("/packages/{package_id}", summary="Read a package's entry", response_model=schemas.Package)
def get_package(package_id: Id, session: Reading) -> Package:
    """Read whose package it is and what it is for; `/content` is the file."""
    return packages.get_package(session, package_id)


@router.get("/packages/{package_id}/content", summary="Read a package", response_class=ZipFile)
def get_package_content(package_id: Id, session: Reading, blobs: Blobs) -> ZipFile:
    """Read the ZIP, its bytes checked against their hash."""
    row = packages.get_package(session, package_id)
    headers = {
        "Content-Disposition": f'attachment; filename="{packages.file_name(session, row)}"',
        "ETag": f'"{row.sha256}"',
    }
    return ZipFile(packages.read(session, blobs, package_id), headers=headers)
