"""The parameters themselves: `parameters.json` for programs, `parameters.csv` for eyes, `c_sd.json` for the attitude."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from boresight.calibration.calibration import Values, to_plain
from boresight.calibration.parameter_set import ParameterSetDocument, parse_parameter_set
from boresight.cameras import CAMERA_MODELS
from boresight.telemetry.sensors import Sensor
from boresight.uplink.archive import csv_bytes, json_bytes
from boresight.uplink.camera_files import conventions
from boresight.uplink.table_definition import DecodedField

SCHEMA = "boresight.uplink-parameters/1"
COLUMNS = (
    "name",
    "unit",
    "old",
    "new",
    "delta",
    "sigma",
    "sigma_with_misfit",
    "three_sigma",
    "delta_over_sigma",
    "type",
    "raw_hex",
    "on_board",
)

Set = Mapping[str, Any]  # one set of the package's inputs


def read_document(subject: Set) -> ParameterSetDocument:
    """Read what a set says."""
    return parse_parameter_set(subject["document"])


def changes(subject: Set, before: Set | None) -> list[dict[str, Any]]:
    """Return each parameter's row, SI: the first nine of `COLUMNS`, and its symbol.

    `three_sigma` and `delta_over_sigma` are of the sigma with misfit; where a set has none, that is the one of noise alone.
    """
    found, replaced = read_document(subject), None if before is None else read_document(before)
    model = CAMERA_MODELS[found.camera_model]
    rows = []
    for name, symbol, unit in zip(model.parameter_names, model.symbols, model.units, strict=True):
        new, of_noise, sigma = (
            found.parameters[name],
            (found.sigma or Values()).get(name),
            found.reliable_sigma.get(name),
        )
        old = None if replaced is None else replaced.parameters[name]
        delta = None if old is None else new - old
        row = {"name": name, "symbol": symbol, "unit": unit, "old": old, "new": new, "delta": delta}
        row |= {"sigma": of_noise, "sigma_with_misfit": sigma}
        row["three_sigma"] = None if sigma is None else 3 * sigma
        row["delta_over_sigma"] = delta / sigma if delta is not None and sigma else None
        rows.append(row)
    return rows


def parameters_csv(subject: Set, before: Set | None, held: Mapping[str, DecodedField]) -> bytes:
    """Write the table of old and new values."""
    rows = []
    for row in changes(subject, before):
        field = held.get(row["name"])
        bits = struct.pack(">d", row["new"]).hex().upper() if field is None else field.hexadecimal
        kind = "float64" if field is None else field.field.kind
        rows.append([*(row[key] for key in COLUMNS[:9]), kind, bits, row["new"] if field is None else field.value])
    return csv_bytes(COLUMNS, rows)


def parameters_json(sensor: Sensor, subject: Set, held: Mapping[str, DecodedField]) -> bytes:
    """Write the normative document."""
    found = read_document(subject)
    model, free = CAMERA_MODELS[found.camera_model], found.free or ()
    return json_bytes(
        {
            "schema": SCHEMA,
            "parameter_set": {"name": subject["name"], "sha256": subject["sha256"]},
            "sensor": {
                "name": sensor.name,
                "rows": sensor.rows,
                "columns": sensor.columns,
                "pixel_pitch_m": sensor.pixel_pitch_m,
            },
            "camera_model": model.name,
            "equation": model.equations._asdict(),
            "conventions": conventions(sensor),
            "parameters": [
                {
                    "name": row["name"],
                    "symbol": row["symbol"],
                    "unit": row["unit"],
                    "value": row["new"],
                    "sigma": row["sigma"],
                    "sigma_with_misfit": row["sigma_with_misfit"],
                    "estimated": row["name"] in free,
                    "on_board": held[row["name"]].value if row["name"] in held else None,
                }
                for row in changes(subject, None)
            ],
            "covariance": found.covariance,
            "covariance_with_misfit": found.covariance if found.misfit is None else to_plain(found.misfit.covariance),
            "validity": _validity(sensor, subject),
            "provenance": _provenance(subject),
        }
    )


def _validity(sensor: Sensor, subject: Set) -> dict[str, Any]:
    """Say for what these numbers hold: the detector, the stretch of time, the temperatures that were seen."""
    model = CAMERA_MODELS[sensor.camera_model]
    x = np.array([read_document(subject).parameters[name] for name in model.parameter_names])
    cone = model.cone_rad(x, sensor.rows, sensor.columns, sensor.pixel_pitch_m)
    telemetry = subject["run"]["telemetry"] if subject["run"] else {"epoch_utc": None, "temperature_c": None}
    return {
        "field": {"rows": [-0.5, sensor.rows - 0.5], "columns": [-0.5, sensor.columns - 0.5], "radius_rad": cone},
        "epoch_utc": telemetry["epoch_utc"],
        "temperature_c": telemetry["temperature_c"],
    }


def _provenance(subject: Set) -> dict[str, Any]:
    found = read_document(subject)
    kept = ("method", "variant", "status", "frames", "stars", "rms_arc_rad", "chi2_per_dof", "advice", "inputs")
    said = {key: getattr(found, key) for key in kept}
    return said | {"run": subject["run"], "created_utc": subject["created_utc"]}


def alignment_json(subject: Set, before: Set | None) -> bytes:
    """Write how far loading the set turns the attitude, and what keeps C_SD.

    The turn was found against the parameters that the run started from; where the set that is replaced has others, it is no
    answer, and the document says so instead of giving an update.
    """
    found = read_document(subject).alignment
    started = subject["run"]["started_from"] if subject["run"] else None
    replaced = None if before is None else read_document(before).parameters.to_dict()
    answer: dict[str, Any] = {"schema": "boresight.c-sd/1", "parameter_set": subject["name"], "alignment": None}
    answer["replaces"] = None if before is None else before["name"]
    if found is None:
        answer["sentence"] = "No attitude was compared for this set: check C_SD after loading it."
    elif started != replaced:
        answer["sentence"] = (
            f"The rotation was found against the parameters that the run started from, which are not those of "
            f"{answer['replaces']}: start the calibration from the set that is being replaced, or check C_SD after loading."
        )
    else:
        answer["alignment"] = found
        answer["sentence"] = found["sentence"]
        answer["use"] = (
            "C_SD_new = C_SD_old c_sd_update; C_SD turns vectors of the detector triad into the sensor's frame"
        )
    return json_bytes(answer)


def approved_alignment(subject: Set) -> dict[str, bytes]:
    """Write the approved alignment that was made with the set, with its signature; nothing where there is none."""
    found = subject.get("alignment")
    if found is None:
        return {}
    use = (
        f"q rotates the attitude reported by {found['from']} with {subject['name']} into that reported by {found['to']} with the "
        f"parameters of run {found['run_b']}. Load it only together with these two parameter sets."
    )
    answer = {"schema": "boresight.approved-alignment/1", "parameter_set": subject["name"], **found, "use": use}
    return {"approved_alignment.json": json_bytes(answer)}
