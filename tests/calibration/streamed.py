"""Calibrating one set in memory and from a file in pieces, for the tests that hold the two against each other."""

import pyarrow.parquet as arrow_parquet

from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.telemetry.read.readers import contract_table, read_telemetry

#: Of the document, what depends on the clock.
TIMED = ("timing_s",)


def written(telemetry, folder, rows_a_group=100):
    path = write_in_groups(telemetry, folder, rows_a_group)
    return path, read_telemetry(path)


def write_in_groups(telemetry, folder, rows_a_group):
    path = folder / "set.parquet"
    arrow_parquet.write_table(contract_table(telemetry), path, row_group_size=rows_a_group)
    return path


def streamed(path, sensor, catalogue, chunk_frames, validation=None, **choices):
    file = TelemetryFile(path, large_rows=0, chunk_frames=chunk_frames)
    choices = {"scratch_folder": path.parent, **choices}
    return calibrate(file, sensor, catalogue, *_settings(choices), validation=validation, **choices)


def in_memory(telemetry, sensor, catalogue, validation=None, **choices):
    return calibrate(telemetry, sensor, catalogue, *_settings(choices), validation=validation, **choices)


def _settings(choices):
    names = set(CalibrationSettings.__dataclass_fields__) & set(choices)
    return [CalibrationSettings(**{name: choices.pop(name) for name in names})]


def differences(one, other, path=""):
    if isinstance(one, dict) and isinstance(other, dict):
        if one.keys() != other.keys():
            return [f"{path}: {sorted(one.keys() ^ other.keys())}"]
        return [
            found for key in one if key not in TIMED for found in differences(one[key], other[key], f"{path}.{key}")
        ]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        return [
            found for k, pair in enumerate(zip(one, other, strict=True)) for found in differences(*pair, f"{path}[{k}]")
        ]
    return [] if one == other else [f"{path}: {str(one)[:60]} != {str(other)[:60]}"]
