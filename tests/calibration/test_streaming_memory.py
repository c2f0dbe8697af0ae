"""A set that grows sixfold does not make the process that calibrates it larger."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.stars import write_synthetic

#: Judges few stars, as a set far above the limit would, takes any file in pieces, and says how much was resident at most.
CALIBRATE = """
import resource, sys
from pathlib import Path
from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.calibration.matching import matched
from boresight.calibration import telemetry_pieces
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import load_catalogue

telemetry_pieces.JUDGED_WHOLE = telemetry_pieces.JUDGED_STARS = 20_000
matched.BLOCKS_A_RANGE = 1
file = TelemetryFile(Path(sys.argv[1]), large_rows=0, chunk_frames=1024)
settings = CalibrationSettings(method=sys.argv[2], match="given")
document = calibrate(file, st16_sensor(1), load_catalogue(Path(sys.argv[1]).parent), settings)
print(document["frames"], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
SMALL, LARGE = 5_000, 30_000
#: What the larger set alone would take in memory: 24 stars of 56 bytes a frame, and 42 arcs with R of 48.
WOULD_TAKE_MB = (LARGE - SMALL) * (24 * 56 + 42 * 48) / 1e6


def peak_mb(path, method):
    done = subprocess.run([sys.executable, "-c", CALIBRATE, path, method], capture_output=True, text=True, check=True)
    frames, peak = done.stdout.split()
    assert int(frames) == json.loads(Path(path).stem)
    return float(peak)


@pytest.mark.full
def test_six_times_the_frames_take_no_more_memory(tmp_path):
    peaks = {}
    for frames in (SMALL, LARGE):
        path = tmp_path / f"{frames}.parquet"
        write_synthetic(path, frames)
        peaks[frames] = peak_mb(path, "batch")
    assert peaks[LARGE] - peaks[SMALL] < WOULD_TAKE_MB / 2
