"""Shared exposures are found by what was seen in them, whatever their numbers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.telemetry.sampling import exposure_marks, shared_exposures
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.working_table import write_working_table

STARS = 5


def written(path, exposures, first_frame=0):
    """Write a table whose exposures are those of these numbers; frames are counted from `first_frame`."""
    stars = [np.random.default_rng(number).uniform(0, 1000, (STARS, 2)) for number in exposures]
    place = np.concatenate(stars) if stars else np.zeros((0, 2))
    frame = np.repeat(np.arange(first_frame, first_frame + len(exposures)), STARS)
    write_working_table(Telemetry(frame, np.zeros_like(frame), place[:, 0], place[:, 1]), path)
    return path


@settings(max_examples=20)
@given(st.sets(st.integers(0, 30), min_size=1), st.sets(st.integers(0, 30), min_size=1))
def test_the_shares_are_those_of_the_sets(tmp_path_factory, one, other):
    folder = tmp_path_factory.mktemp("tables")
    paths = written(folder / "a", sorted(one)), written(folder / "b", sorted(other), first_frame=500)
    common = len(one & other)
    assert shared_exposures(*paths) == (common / len(one), common / len(other))


def test_a_table_without_rows_shares_nothing(tmp_path):
    assert shared_exposures(written(tmp_path / "a", []), written(tmp_path / "b", [1, 2])) == (0, 0)


def test_a_damaged_table_is_refused(tmp_path):
    (tmp_path / "broken").write_bytes(b"no table")
    with pytest.raises(RefusedInputError, match="damaged"):
        exposure_marks(tmp_path / "broken")
