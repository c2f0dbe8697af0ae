"""Files for other programs, one module a program: whatever module of this folder defines an `ExportFormat` is found."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from boresight.calibration.exports.export import Export, ExportFormat, ExposureAttitude, Source, export, export_document
from boresight.errors import RefusedInputError

EXPORT_FORMATS: dict[str, ExportFormat] = {
    value.name: value
    for module in iter_modules(__path__, f"{__name__}.")
    for value in vars(import_module(module.name)).values()
    if isinstance(value, ExportFormat)
}


def find_format(name: str) -> ExportFormat:
    """Return a format by name; refuse one that there is not."""
    if name not in EXPORT_FORMATS:
        raise RefusedInputError(f"There is no format {name!r}: choose {' or '.join(EXPORT_FORMATS)}.")
    return EXPORT_FORMATS[name]


def find_camera_format(name: str) -> ExportFormat:
    """Return a format of the camera alone; refuse one with something for each exposure, which takes telemetry."""
    form = find_format(name)
    if form.needs_attitudes:
        raise RefusedInputError(
            f"{form.name} has a header for each exposure, with the attitude from its stars: write it from the telemetry with "
            f"`boresight convert PARAMETERS --sensor FILE --telemetry FILE --to {form.name} --out FILE`."
        )
    return form


__all__ = [
    "EXPORT_FORMATS",
    "Export",
    "ExportFormat",
    "ExposureAttitude",
    "Source",
    "export",
    "export_document",
    "find_camera_format",
    "find_format",
]
