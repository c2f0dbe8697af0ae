"""Every estimator under the pinhole camera: the sensor of Wu et al., from W's start, half a millimetre off in focal length."""

import numpy as np
import pytest

from boresight import kernels
from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.metrics import arc_errors
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.estimation.pinhole_fields import PINHOLE, WU_TRUTH, wu_field

FREE = np.arange(6)
START = np.array([1.0, 0.0155, 960.0, 540.0, 0.0, 0.0])
SCALE = np.array([1e-3, 1e-4, 10.0, 10.0, 0.1, 0.5])


def _weighed(field, x):
    return arcsets.whiten(field, arcsets.angular_sigma(PINHOLE, x, field))[0]


def test_the_rows_of_the_arcs_are_the_slopes_of_the_arcs():
    field = _weighed(wu_field(np.random.default_rng(1), frames=3), WU_TRUTH)
    band = np.zeros_like(field.band)
    band[:, 4] = 1.0
    e, H = np.empty(field.n_arcs), np.empty((field.n_arcs, 6))

    kernels.whitened_rows(
        field.model,
        WU_TRUTH,
        field.pitch,
        field.star_start,
        field.row_px,
        field.col_px,
        field.phi,
        band,
        FREE,
        SCALE,
        e,
        H,
    )

    np.testing.assert_allclose(e, arc_errors(field, WU_TRUTH), atol=1e-15)
    for p in FREE:
        step = np.zeros(6)
        step[p] = 1e-3 * SCALE[p]
        slope = (arc_errors(field, WU_TRUTH + step) - arc_errors(field, WU_TRUTH - step)) / 2e-3
        np.testing.assert_allclose(H[:, p], slope, atol=1e-6 * np.abs(slope).max())


def test_errors_of_the_batch_are_spread_as_its_covariance_says_and_residuals_as_R_says():
    sets, total_nees, total_chi2, dof = 40, 0.0, 0.0, 0
    for seed in range(sets):
        field = wu_field(np.random.default_rng(500 + seed), frames=40)
        first = batch.fit(_weighed(field, START), START, FREE, SCALE)
        field = _weighed(field, first.x)
        fitted = batch.fit(field, first.x, FREE, SCALE)
        assert fitted.status == "converged"
        total_nees += nees((fitted.x - WU_TRUTH) / SCALE, np.linalg.inv(fitted.A))
        total_chi2 += fitted.chi2
        dof += field.n_arcs - 6
    assert chi_square(total_nees, 6 * sets).consistent
    assert chi_square(total_chi2, dof).consistent


@pytest.mark.parametrize("method", ["ekf", "sqrf", "ukf"])
def test_a_filter_ends_where_the_batch_does(method):
    field = _weighed(wu_field(np.random.default_rng(2), frames=60), WU_TRUTH)
    history = FILTERS[method](field, start(WU_TRUTH, 6, 10.0), FREE, SCALE, Tuning())
    fitted = batch.fit(field, WU_TRUTH, FREE, SCALE)
    sigma = batch.sigma_in_scale(fitted.A)
    np.testing.assert_allclose((history.last.x - fitted.x) / SCALE / sigma, 0, atol=0.15)
    np.testing.assert_allclose(history.sigmas[-1], sigma, rtol=0.05)


@pytest.mark.parametrize("method", ["sqrf", "ukf"])
def test_a_filter_from_the_papers_start_is_as_uncertain_as_it_says(method):
    sets, total = 20, 0.0
    for seed in range(sets):
        field = wu_field(np.random.default_rng(700 + seed), frames=40)
        pooled = pool_start(_weighed(field, WU_TRUTH), START_ARCS_PER_PARAMETER * 6)
        last = FILTERS[method](pooled, start(START, 6, 10.0), FREE, SCALE, Tuning()).last
        total += nees((last.x - WU_TRUTH) / SCALE, last.P)
    assert chi_square(total, 6 * sets).consistent


def test_a_start_under_which_the_stars_have_no_direction_is_called_diverged():
    field = _weighed(wu_field(np.random.default_rng(3), frames=5), WU_TRUTH)
    blind = WU_TRUTH.copy()
    blind[4] = -50.0
    assert batch.fit(field, blind, FREE, SCALE).status == "diverged"
