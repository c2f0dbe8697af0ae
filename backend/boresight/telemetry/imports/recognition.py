"""Which mapping profile fits a file: each is tried, and those that read it stand in order of what they leave unused.

A profile that names more of a file's columns says more of what they mean; of two that name as many, the one that finds more of what
telemetry has is better, then the one that is offered first. A guess is shown to a person, who may choose another one.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from boresight.errors import RefusedInputError
from boresight.telemetry.imports.mapping import Imported, SourceFile, import_files
from boresight.telemetry.imports.profile import Profile
from boresight.telemetry.read.limits import LIMITS, Limits
from boresight.telemetry.sensors import Sensor

#: A larger file is not read once for every profile.
MOST_BYTES_RECOGNISED = 16_000_000


def recognise(
    file: SourceFile,
    profiles: Sequence[Profile],
    *,
    sensor: Sensor | None = None,
    orbit: SourceFile | None = None,
    time: str | None = None,
    limits: Limits = LIMITS,
) -> list[Imported]:
    """Import a file by every profile that reads it, the likeliest first.

    Raises
    ------
    RefusedInputError
        When no profile reads it, or it is too large to be tried by each.
    """
    if file.path.stat().st_size > MOST_BYTES_RECOGNISED:
        raise RefusedInputError(
            f"{file.name} has more than {MOST_BYTES_RECOGNISED / 1e6:.0f} MB, too many to try every mapping profile on: choose its "
            "profile yourself."
        )
    found = []
    for profile in profiles:
        with suppress(RefusedInputError):
            found.append(import_files([file], profile, sensor=sensor, orbit=orbit, time=time, limits=limits))
    if not found:
        raise RefusedInputError(
            f"No mapping profile reads {file.name}: save one that names its columns, or upload it without a preview if it has "
            "Boresight's own columns or is an image."
        )
    return sorted(found, key=lambda one: (len(one.unused), -len(one.meanings)))
