"""The angular distances of all pairs: with their covariance in full they say what 2 N - 3 arcs say."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import angular
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from tests.estimation.fields import FREE, GROUND, PITCH, SCALE, TRUTH, star_field, weighed


def _stars(rng, n):
    return INVERTED_WANG.directions(TRUTH, rng.uniform(0, 1943, n), rng.uniform(0, 2591, n), PITCH)


@given(st.integers(0, 10_000), st.integers(2, 12))
def test_slopes_are_right_to_central_differences(seed, n):
    rng = np.random.default_rng(seed)
    s = _stars(rng, n)
    step = 1e-6 * rng.normal(size=s.shape)
    step -= np.sum(step * s, axis=1, keepdims=True) * s
    phi, g = angular.angles(s)
    ahead, behind = (angular.angles(s + sign * step)[0] for sign in (1, -1))
    np.testing.assert_allclose(np.einsum("rnj,nj->r", g, step), (ahead - behind) / 2, atol=1e-10 / phi.min())


@given(st.integers(0, 10_000), st.integers(4, 12))
def test_all_pairs_hold_two_numbers_a_star_less_three(seed, n):
    R = angular.covariance(_stars(np.random.default_rng(seed), n), np.full(n, 1e-4))
    values = np.linalg.eigvalsh(R / R.max())
    assert len(R) == n * (n - 1) // 2
    assert (np.abs(values[: len(R) - 2 * n + 3]) < 1e-12).all()


def test_the_filter_on_all_pairs_ends_where_the_filter_on_arcs_does():
    field = weighed(star_field(np.random.default_rng(3), frames=40), TRUTH)
    field = pool_start(field, START_ARCS_PER_PARAMETER * 8)
    pairs, arcs = (
        FILTERS[method](field, start(TRUTH, 8, 10.0), FREE, SCALE, Tuning()) for method in ("angular", "sqrf")
    )
    np.testing.assert_allclose((pairs.last.x - arcs.last.x) / SCALE / arcs.sigmas[-1], 0, atol=0.02)
    np.testing.assert_allclose(pairs.sigmas[-1], arcs.sigmas[-1], rtol=1e-3)
    np.testing.assert_array_equal(pairs.dof, arcs.dof)
    np.testing.assert_allclose(pairs.nis.sum(), arcs.nis.sum(), rtol=1e-3)


def _gain(field, x, form="gain"):
    return FILTERS["angular"](field, start(x, 8, 3.0), FREE, SCALE, Tuning(gain_form=form))


def test_the_gain_of_turned_rows_is_that_of_all_pairs(monkeypatch):
    field = weighed(star_field(np.random.default_rng(5), frames=6, mean_stars=12), GROUND)
    printed = _gain(field, GROUND)
    monkeypatch.setattr("boresight.estimation.filters.angular.MOST_PAIRS", 0)
    turned = _gain(field, GROUND)
    assert np.abs((turned.states - printed.states) / SCALE / printed.sigmas).max() < 1e-8
    np.testing.assert_allclose(turned.sigmas, printed.sigmas, rtol=1e-8)
    np.testing.assert_allclose(turned.nis, printed.nis, rtol=1e-7)


def test_the_gain_form_runs_on_hundreds_of_stars_an_exposure():
    field = weighed(star_field(np.random.default_rng(4), frames=2, mean_stars=200), TRUTH)
    gain, information = (_gain(field, TRUTH, form) for form in ("gain", "information"))
    assert np.diff(field.star_start).max() > 200  # 20,000 pairs
    assert np.abs((gain.states - information.states) / SCALE / information.sigmas).max() < 1e-8
    np.testing.assert_allclose(gain.sigmas, information.sigmas, rtol=1e-8)
