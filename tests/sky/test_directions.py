"""Each row takes the direction that the table in `sky.directions` says."""

import numpy as np
import pytest

from boresight.errors import RefusedInputError
from boresight.sky.apparent import apparent_directions
from boresight.sky.directions import star_directions

TIME = np.full(4, np.datetime64("2024-01-01", "us"))
IDS = np.array([32349, 0, 55203, 71683])  # Sirius, unmatched, not in the catalogue, alpha Centauri
RA = np.radians([10.0, 20.0, 30.0, np.nan])
DEC = np.radians([-5.0, 0.0, 5.0, np.nan])
GIVEN = np.column_stack([np.cos(DEC) * np.cos(RA), np.cos(DEC) * np.sin(RA), np.sin(DEC)])


def test_the_files_direction_replaces_the_catalogues_and_unmatched_rows_have_none(catalogue):
    directions = star_directions(IDS, RA, DEC, TIME, None, catalogue)
    np.testing.assert_array_equal(directions[[0, 2]], GIVEN[[0, 2]])
    assert np.isnan(directions[1]).all()
    np.testing.assert_array_equal(
        directions[3:], apparent_directions(catalogue, catalogue.find_index(IDS[3:]), TIME[3:], None)
    )


def test_without_directions_in_the_file_unknown_stars_have_none(catalogue):
    directions = star_directions(IDS, None, None, TIME, None, catalogue)
    assert np.isnan(directions).all(axis=1).tolist() == [False, True, True, False]


def test_without_numbers_every_given_direction_counts(catalogue):
    np.testing.assert_array_equal(star_directions(None, RA, DEC, None, None, catalogue), GIVEN)


def test_the_satellites_velocity_is_that_of_the_row(catalogue):
    velocity = np.zeros((4, 3))
    velocity[3] = 7500.0, 0.0, 0.0
    still, moving = (star_directions(IDS, None, None, TIME, v, catalogue) for v in (None, velocity))
    np.testing.assert_array_equal(still[0], moving[0])
    assert np.linalg.norm(moving[3] - still[3]) > 1e-6


def test_a_row_without_time_has_no_direction_but_the_others_do(catalogue):
    times = TIME.copy()
    times[0] = np.datetime64("NaT")
    assert np.isnan(star_directions(IDS, None, None, times, None, catalogue)[:, 0]).tolist() == [
        True,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize("times", [None, np.full(4, np.datetime64("NaT", "us"))], ids=["no column", "no cell"])
def test_catalogue_directions_without_any_time_are_refused(catalogue, times):
    with pytest.raises(RefusedInputError, match=r"2 matched stars .* add a time_utc column"):
        star_directions(IDS, None, None, times, None, catalogue)


def test_times_are_not_asked_for_where_no_row_needs_them(catalogue):
    directions = star_directions(IDS[:3], RA[:3], DEC[:3], None, None, catalogue)
    assert np.isfinite(directions[:, 0]).tolist() == [True, False, True]


def test_telemetry_that_names_no_star_at_all_is_refused(catalogue):
    with pytest.raises(RefusedInputError, match="give a star_id column"):
        star_directions(None, None, None, TIME, None, catalogue)
