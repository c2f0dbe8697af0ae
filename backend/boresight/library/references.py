"""What the library takes for mapping profiles, and for the attitudes of a reference: files, tables and telemetry."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.alignment.sides import BESIDE, COLUMNS, Side, reference_side
from boresight.errors import RefusedInputError
from boresight.library.inputs import TelemetrySource, find_telemetry, open_table, read_in_memory
from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.imports.ephemerides import Attitudes
from boresight.telemetry.imports.mapping import SourceFile, attitudes_of_table, read_attitudes
from boresight.telemetry.imports.profile import Profile, parse_profile, read_profile
from boresight.telemetry.imports.tables import SourceTable
from boresight.telemetry.read.limits import Limits
from boresight.telemetry.schema import Telemetry

#: Attitudes over time: a file, a table, or telemetry with quaternions.
ReferenceSource = TelemetrySource
#: The name of a built-in mapping profile, a file, what such a file says, or a profile of this library.
ProfileSource = str | os.PathLike[str] | Mapping[str, Any] | Profile


def read_any_profile(source: ProfileSource) -> Profile:
    """Read a mapping profile; a text is the name of a built-in one, unless a file is called so."""
    if isinstance(source, Profile):
        return source
    if isinstance(source, Mapping):
        return parse_profile(source)
    if isinstance(source, str) and source in BUILT_IN and not Path(source).is_file():
        return BUILT_IN[source]
    if not Path(source).exists():
        raise RefusedInputError(
            f"{source} is neither a file nor a built-in profile: choose from {', '.join(BUILT_IN)}."
        )
    return read_profile(Path(source))


def read_any_reference(
    source: ReferenceSource,
    profile: ProfileSource | None,
    sigma_arcsec: float | None,
    bias_arcsec: float,
    limits: Limits,
) -> Side:
    """Read the attitudes of a reference; of telemetry its own quaternions."""
    if find_telemetry(source) is not None:
        found, beside = _read_attitudes(read_in_memory(source, limits)), dict[str, FloatArray]()
    else:
        named = COLUMNS if profile is None else read_any_profile(profile)
        if isinstance(source, str | os.PathLike):
            file = SourceFile(Path(source), Path(source).name)
            if not file.path.is_file():
                raise RefusedInputError(f"There is no file {file.name}: check the name of the reference.")
            found, beside = read_attitudes(file, named, limits, BESIDE)
        else:
            name, table = open_table(source)
            rows = np.arange(table.num_rows)
            columns = {column: table[column].combine_chunks() for column in table.column_names}
            found, beside = attitudes_of_table(SourceTable(name, columns, rows, rows), named, BESIDE)
    return reference_side(found.name, found, beside, sigma_arcsec=sigma_arcsec, bias_arcsec=bias_arcsec)


def _read_attitudes(telemetry: Telemetry) -> Attitudes:
    """Take the quaternions that telemetry has, one a time."""
    if telemetry.quaternion is None or telemetry.time_utc is None:
        raise RefusedInputError("This telemetry has no quaternions with times: give a table that has both.")
    usable = np.flatnonzero(~np.isnat(telemetry.time_utc) & np.isfinite(telemetry.quaternion).all(axis=1))
    first = usable[np.unique(telemetry.time_utc[usable], return_index=True)[1]]
    none = np.zeros(len(first), np.int64)
    return Attitudes("the reference", telemetry.time_utc[first], telemetry.quaternion[first], none)
