"""Singular values of star combinations: invariant, rightly differentiated, and honest about what they hold."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from boresight.calibration.options import EITHER_FORM
from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import singular_values
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.singular_values import APART, STAR_MODELS, Selection
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.estimation.fields import FREE, GROUND, PITCH, SCALE, TRUTH, rotation, star_field, weighed

SIGMA = 1e-4


def _stars(rng, n):
    return INVERTED_WANG.directions(TRUTH, rng.uniform(0, 1943, n), rng.uniform(0, 2591, n), PITCH)


@given(st.integers(0, 10_000), st.integers(3, 30))
def test_no_attitude_and_no_mirror_changes_a_singular_value(seed, n):
    rng = np.random.default_rng(seed)
    s = _stars(rng, n)
    turned = s @ rotation(rng).T * [1, -1, 1]
    np.testing.assert_allclose(
        singular_values.decomposition(turned)[0], singular_values.decomposition(s)[0], rtol=1e-12, atol=1e-12
    )


@given(st.integers(0, 10_000), st.integers(3, 30))
def test_the_squares_add_up_to_the_number_of_stars_so_the_first_adds_nothing(seed, n):
    s = _stars(np.random.default_rng(seed), n)
    sigma, g = singular_values.decomposition(s)[0], singular_values.gradients(s)
    across = g - np.einsum("knj,nj->kn", g, s)[..., None] * s  # directions stay unit vectors
    assume(sigma[2] > 1e-3)
    assert np.sum(sigma**2) == pytest.approx(n, rel=1e-13)
    np.testing.assert_allclose(np.einsum("k,knj->nj", sigma, across), 0, atol=1e-12)


@settings(deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 20))
def test_slopes_are_right_to_central_differences(seed, n):
    rng = np.random.default_rng(seed)
    s = _stars(rng, n)
    sigma = singular_values.decomposition(s)[0]
    assume(min(sigma[1] - sigma[2], sigma[2]) > 0.02)
    step = 1e-5 * rng.normal(size=s.shape)
    ahead, behind = (singular_values.decomposition(s + sign * step)[0] for sign in (1, -1))
    slope = np.einsum("knj,nj->k", singular_values.gradients(s), step)
    np.testing.assert_allclose(slope, (ahead - behind) / 2, atol=1e-9)


def test_slopes_by_a_complex_step_through_the_camera():
    # sqrt(eigenvalue) of the analytic W(x) W(x)^T, by its characteristic polynomial, which complex numbers can go through
    rng = np.random.default_rng(4)
    row, col = rng.uniform(0, 1943, 6), rng.uniform(0, 2591, 6)
    s, D = INVERTED_WANG.directions_and_jacobian(TRUTH, row, col, PITCH)
    sigma = singular_values.decomposition(s)[0]
    analytic = np.einsum("knj,njp->kp", singular_values.gradients(s), D) * SCALE
    for p in range(8):
        x = TRUTH.astype(complex)
        x[p] += 1e-20j * SCALE[p]
        w = INVERTED_WANG.directions(x, row, col, PITCH)
        A = w.T @ w
        for k in range(3):  # d(lambda) = d(det(A - lambda I)) / (product of the gaps), at the real lambda
            lam = sigma[k] ** 2
            others = np.delete(sigma**2, k)
            moved = _determinant(A - lam * np.eye(3)).imag / 1e-20 / np.prod(others - lam)
            assert moved / (2 * sigma[k]) == pytest.approx(analytic[k, p], rel=1e-6, abs=1e-10)


def _determinant(A):
    return A[0] @ np.array([A[1, 1] * A[2, 2] - A[1, 2] ** 2, A[1, 2] * A[0, 2] - A[0, 1] * A[2, 2],
                            A[0, 1] * A[1, 2] - A[1, 1] * A[0, 2]])  # fmt: skip


def test_the_models_combine_the_stars_as_the_paper_draws_them():
    listed = {
        model: [
            [int(star) + 1 for star in singular_values.members(6, window)]
            for window in singular_values.windows(6, model)
        ]
        for model in STAR_MODELS
    }
    assert listed[1] == [[1, 2, 3], [2, 3, 4], [3, 4, 5], [4, 5, 6], [5, 6, 1], [6, 1, 2]]
    assert listed[2] == listed[1]  # half of six is three
    assert sorted(map(sorted, listed[3])) == [sorted({1, 2, 3, 4, 5, 6} - {left}) for left in range(6, 0, -1)]
    assert listed[4] == [[1, 2, 3], [1, 2, 3, 4], [1, 2, 3, 4, 5], [1, 2, 3, 4, 5, 6]]
    assert len(singular_values.windows(19, 2)[0]) == 2
    assert (singular_values.windows(19, 2)[:, 1] == 9).all()
    assert (singular_values.windows(4, 2)[:, 1] == 3).all()  # two stars span no volume


@pytest.mark.parametrize(
    ("sigma", "values", "rows"),
    [
        ((3.0, 0.4, 0.1), (2, 3), [-1, 0, 1]),
        ((3.0, 0.4, 0.1), (1, 3), [0, -1, 1]),
        ((3.0, 0.400, 0.395), (2, 3), [-1, 0, 0]),  # they meet: only their sum has a derivative
        ((3.0, 0.400, 0.395), (3,), [-1, -1, -1]),
        ((3.0, 0.400, 0.395), (1, 3), [0, -1, -1]),
        ((3.0, 0.4, 0.005), (2, 3), [-1, 0, -1]),  # stars on a great circle
        ((1.005, 1.0, 0.995), (1, 2, 3), [0, 0, 0]),
    ],
)
def test_values_that_meet_are_measured_by_their_sum_or_not_at_all(sigma, values, rows):
    assert singular_values.row_of_value(np.array(sigma), Selection(4, values), 0.01 / APART).tolist() == rows


def test_the_sum_of_two_equal_values_has_a_slope_where_neither_has():
    # three directions at equal angles about the axis: sigma_2 = sigma_3
    azimuth = np.array([0.0, 2 * np.pi / 3, 4 * np.pi / 3])
    s = np.stack([0.1 * np.cos(azimuth), 0.1 * np.sin(azimuth), np.full(3, np.sqrt(0.99))], axis=1)
    step = 1e-6 * np.random.default_rng(5).normal(size=s.shape)
    ahead, behind = (singular_values.decomposition(s + sign * step)[0] for sign in (1, -1))
    slope = np.einsum("knj,nj->k", singular_values.gradients(s), step)
    assert (slope[1] + slope[2]) == pytest.approx((ahead - behind)[1:].sum() / 2, abs=1e-11)
    assert abs((ahead - behind)[1] / 2 - slope[1]) > 1e-8


@pytest.mark.parametrize("model", STAR_MODELS)
def test_the_covariance_of_overlapping_combinations_is_that_of_many_noisy_exposures(model):
    rng = np.random.default_rng(6)
    s, n, draws = _stars(rng, 7), 7, 4000
    taken = singular_values.exposure(s, np.full(n, SIGMA), Selection(model))
    noisy = s + SIGMA * rng.normal(size=(draws, n, 3))
    noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
    z = np.array([singular_values.stacked(each, taken.rows, Selection(model))[0] for each in noisy])
    rows = singular_values.determined_rows(taken.R)
    whitened = np.linalg.solve(np.linalg.cholesky(taken.R[np.ix_(rows, rows)]), (z - taken.z)[:, rows].T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(len(rows)), atol=5.5 / np.sqrt(draws))
    assert np.linalg.matrix_rank(taken.R, 1e-8 * taken.R.max()) == min(len(taken.z), 2 * n - 3)


def _last(field, method, tuning, x=TRUTH):
    pooled = pool_start(field, START_ARCS_PER_PARAMETER * 8)
    return FILTERS[method](pooled, start(x, 8, 10.0), FREE, SCALE, tuning)


@pytest.mark.parametrize("noise", [0.0, 0.02], ids=["no-q", "q"])
@pytest.mark.parametrize("linearisations", [1, 6])
@pytest.mark.parametrize("method", EITHER_FORM)
def test_the_gain_form_equals_the_information_form(method, linearisations, noise):
    field = weighed(star_field(np.random.default_rng(7), frames=8, mean_stars=7), GROUND)
    forms = [
        FILTERS[method](field, start(GROUND, 8, 3.0), FREE, SCALE, Tuning(linearisations, noise, 0.99, gain_form=form))
        for form in ("information", "gain")
    ]
    assert np.abs((forms[0].states - forms[1].states) / SCALE / forms[0].sigmas).max() < 1e-8
    np.testing.assert_allclose(forms[1].sigmas, forms[0].sigmas, rtol=1e-8)
    np.testing.assert_allclose(forms[1].nis, forms[0].nis, rtol=1e-7)
    np.testing.assert_array_equal(forms[1].dof, forms[0].dof)


@pytest.mark.parametrize("model", STAR_MODELS)
def test_every_model_is_consistent_over_many_sets(model):
    errors = []
    nis, dof = 0.0, 0
    for seed in range(25):
        field = weighed(star_field(np.random.default_rng(700 + seed), frames=60), TRUTH)
        history = _last(field, "svd", Tuning(selection=Selection(model)))
        errors.append(nees((history.last.x - TRUTH) / SCALE, history.last.P))
        nis, dof = nis + history.nis.sum(), dof + int(history.dof.sum())
    bounds = chi_square(sum(errors), 8 * len(errors))
    assert bounds.consistent, (np.mean(errors), 8 * bounds.lower, 8 * bounds.upper)
    assert chi_square(nis, dof).consistent


def test_all_three_values_equal_the_two_that_are_independent():
    field = weighed(star_field(np.random.default_rng(8), frames=20), TRUTH)
    two, three = (_last(field, "svd", Tuning(selection=Selection(4, values))) for values in ((2, 3), (1, 2, 3)))
    np.testing.assert_allclose(three.sigmas[-1], two.sigmas[-1], rtol=0.02)
    np.testing.assert_allclose((three.last.x - two.last.x) / SCALE / two.sigmas[-1], 0, atol=0.3)
