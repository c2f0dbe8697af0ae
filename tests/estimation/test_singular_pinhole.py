"""Model 4 with the second and third singular value finds the six parameters of W's camera, and knows how well."""

import numpy as np
import pytest

from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.estimation import arcs
from boresight.estimation.arcs import arclength
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.estimation.pinhole_fields import PINHOLE, WU_COLUMNS, WU_PITCH, WU_ROWS, WU_TRUTH, wu_field

SIX = np.arange(6)
#: W starts at 15.5 mm, (960, 540) and no distortion; what it thinks of that start is not printed.
WU_START = np.array([1.0, 0.0155, 960.0, 540.0, 0.0, 0.0])
START_SIGMA = np.array([1e-3, 5e-4, 10.0, 10.0, 0.5, 1.0])


def _in_chunks(field, method):
    field = pool_start(field, START_ARCS_PER_PARAMETER * 6)
    first = FILTERS[method](field.frames(0, 1), start(WU_START, 6, 1.0), SIX, START_SIGMA, Tuning())
    return FILTERS[method](field.frames(1, field.n_frames), first.last, SIX, START_SIGMA, Tuning()).last


@pytest.fixture(scope="module")
def ends():
    fields = [wu_field(np.random.default_rng(seed)) for seed in range(40)]
    weighed = [arcs.whiten(field, arcs.angular_sigma(PINHOLE, WU_TRUTH, field))[0] for field in fields]
    return [_in_chunks(field, "svd") for field in weighed]


def test_the_six_parameters_are_found_and_the_mean_nees_lies_inside_its_bounds(ends):
    errors = [nees((last.x - WU_TRUTH) / START_SIGMA, last.P) for last in ends]
    bounds = chi_square(sum(errors), 6 * len(errors))
    assert bounds.consistent, (6 * bounds.mean, 6 * bounds.lower, 6 * bounds.upper)


def test_every_parameter_is_within_four_of_its_sigmas(ends):
    whitened = [(last.x - WU_TRUTH) / START_SIGMA / np.sqrt(np.diag(last.P)) for last in ends]
    assert np.abs(whitened).max() < 4.2  # of 240


def test_arcs_without_noise_come_out_to_half_an_arc_second_after_a_hundred_frames(ends):
    # criterion A of the paper, 0.465" there after 2,400 frames
    rng = np.random.default_rng(99)
    row, col = rng.uniform(0, WU_ROWS, 40), rng.uniform(0, WU_COLUMNS, 40)
    i, j = np.triu_indices(40, 1)
    true = PINHOLE.directions(WU_TRUTH, row, col, WU_PITCH)
    errors = []
    for last in ends:
        found = PINHOLE.directions(last.x, row, col, WU_PITCH)
        errors.append(np.mean((arclength(found[i], found[j]) - arclength(true[i], true[j])) ** 2))
    assert np.degrees(np.sqrt(np.mean(errors))) * 3600 < 0.7
