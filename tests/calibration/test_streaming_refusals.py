"""A set that is refused in memory is refused in the same words when it is taken from a file in pieces; nothing stays behind."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.errors import RefusedInputError
from boresight.telemetry.read.readers import read_telemetry
from tests.calibration.conftest import telemetry
from tests.calibration.streamed import in_memory, streamed, write_in_groups, written


def refusals():
    base = telemetry(8, frames=30)
    return {
        "stars off the detector": replace(base, row_px=np.where(base.frame % 7 == 3, -90.0, base.row_px)),
        "no time": replace(base, ra_rad=None, dec_rad=None, time_utc=np.full(len(base), np.datetime64("NaT", "us"))),
        "no stars": replace(base, ra_rad=None, dec_rad=None, star_id=None),
    }


@pytest.mark.parametrize("rows_a_group", [100, 10_000], ids=["read apart", "read from its start"])
@pytest.mark.parametrize("name", refusals())
def test_what_is_refused_in_memory_is_refused_in_the_same_words(name, rows_a_group, sensor, catalogue, tmp_path):
    said = []
    path, refused = written(refusals()[name], tmp_path, rows_a_group)
    for run in (
        lambda: in_memory(refused, sensor, catalogue, match="given"),
        lambda: streamed(path, sensor, catalogue, 4, match="given"),
    ):
        with pytest.raises(RefusedInputError) as refusal:
            run()
        said.append((str(refusal.value), refusal.value.faults))
    assert said[0] == said[1]
    assert [entry.name for entry in tmp_path.iterdir()] == ["set.parquet"]


def test_a_file_with_a_fault_is_refused_as_it_is_when_read_at_once(sensor, catalogue, tmp_path):
    whole = telemetry(8, frames=60)
    noise = np.where(whole.frame % 20 == 7, -1.0, 0.4)
    path = write_in_groups(replace(whole, sigma_px=noise), tmp_path, rows_a_group=100)
    with pytest.raises(RefusedInputError) as at_once:
        read_telemetry(path)
    with pytest.raises(RefusedInputError) as in_pieces:
        streamed(path, sensor, catalogue, 4, match="given")
    assert (str(in_pieces.value), in_pieces.value.faults) == (str(at_once.value), at_once.value.faults)
    assert "more faults" in str(at_once.value)
