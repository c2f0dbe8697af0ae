"""Huber's loss: as Huber wrote it, honest under Gaussian noise, and near the truth where false stars are about."""

from dataclasses import replace

import numpy as np
import pytest

from boresight import kernels
from boresight.estimation import batch
from boresight.estimation.robust import measure_huber_effect
from boresight.estimation.statistics.consistency import chi_square, nees
from tests.estimation.fields import FREE, GROUND, SCALE, TRUTH, star_field, weighed

HUBER = 1.345
SETS = 40


def _whitened(arcs, x):
    e, H = np.empty(arcs.n_arcs), np.empty((arcs.n_arcs, 8))
    kernels.whitened_rows(
        arcs.model, x, arcs.pitch, arcs.star_start, arcs.row_px, arcs.col_px, arcs.phi, arcs.band, FREE, SCALE, e, H
    )
    return e, H


def _soiled(field, rng, share=0.02):
    wrong = rng.uniform(size=field.n_stars) < share
    off = 20.0 * rng.normal(size=(2, field.n_stars)) * wrong
    return replace(field, row_px=field.row_px + off[0], col_px=field.col_px + off[1])


def _fitted_twice(field, threshold):
    first = batch.fit(weighed(field, GROUND), GROUND, FREE, SCALE, threshold=threshold)
    return batch.fit(weighed(field, first.x), first.x, FREE, SCALE, threshold=threshold)


def _nees(fitted):
    return nees((fitted.x - TRUTH) / SCALE, np.linalg.inv(fitted.A))


def test_the_fused_equations_are_hubers():
    arcs = weighed(star_field(np.random.default_rng(1), frames=5), TRUTH)
    x = TRUTH + 0.1 * SCALE
    fused = batch.normal_equations(arcs, x, FREE, SCALE, HUBER)
    e, H = _whitened(arcs, x)
    beyond = np.abs(e) > HUBER
    assert 0 < beyond.sum() < len(e)
    w = np.where(beyond, HUBER / np.abs(e), 1.0)
    np.testing.assert_allclose(fused.A, H.T @ (w[:, None] * H), rtol=1e-9, atol=1e-9 * np.abs(fused.A).max())
    np.testing.assert_allclose(fused.b, H.T @ np.clip(e, -HUBER, HUBER), rtol=1e-9, atol=1e-9 * np.abs(fused.b).max())
    assert fused.chi2 == pytest.approx(np.where(beyond, 2 * HUBER * np.abs(e) - HUBER**2, e**2).sum())


def test_the_cost_falls_along_the_gradient_that_the_equations_give():
    arcs = weighed(star_field(np.random.default_rng(2), frames=5), TRUTH)
    x, step = TRUTH + 0.1 * SCALE, 1e-5
    slope = 2 * batch.normal_equations(arcs, x, FREE, SCALE, HUBER).b
    for p in range(8):
        ahead, behind = (x + side * step * SCALE * (np.arange(8) == p) for side in (1, -1))
        costs = [batch.normal_equations(arcs, at, FREE, SCALE, HUBER).chi2 for at in (ahead, behind)]
        assert (costs[0] - costs[1]) / (2 * step) == pytest.approx(slope[p], rel=1e-4, abs=1e-3 * np.abs(slope).max())


def test_an_infinite_threshold_is_least_squares():
    field = weighed(star_field(np.random.default_rng(3), frames=20), GROUND)
    plain, wide = batch.fit(field, GROUND, FREE, SCALE), batch.fit(field, GROUND, FREE, SCALE, threshold=1e9)
    np.testing.assert_allclose(wide.x, plain.x, rtol=1e-12)
    assert wide.beyond == 0
    # the noise's size is measured, not taken from the file, so information differs by what chi-square differs from 1
    n = field.n_arcs
    np.testing.assert_allclose(wide.A, plain.A * (n - 8) / plain.chi2, rtol=1e-9)


def test_under_gaussian_noise_sigmas_stay_honest_and_cost_a_fortieth():
    total, beyond, widened = 0.0, 0.0, []
    for seed in range(SETS):
        field = star_field(np.random.default_rng(1000 + seed), frames=50)
        robust, plain = _fitted_twice(field, HUBER), _fitted_twice(field, np.inf)
        total += _nees(robust)
        beyond += robust.beyond / weighed(field, GROUND).n_arcs / SETS
        widened.append(batch.sigma_in_scale(robust.A) / batch.sigma_in_scale(plain.A))
    assert chi_square(total, 8 * SETS).consistent
    assert beyond == pytest.approx(0.1786, abs=0.005)  # 2 (1 - Phi(1.345))
    assert np.mean(widened) == pytest.approx(1.026, abs=0.01)


def test_with_two_stars_in_a_hundred_wrong_it_stays_near_the_truth_and_least_squares_does_not():
    robust, plain = 0.0, []
    for seed in range(SETS):
        rng = np.random.default_rng(1000 + seed)
        field = _soiled(star_field(rng, frames=50), rng)
        robust += _nees(_fitted_twice(field, HUBER))
        plain.append(_nees(_fitted_twice(field, np.inf)))
    assert chi_square(robust, 8 * SETS).consistent
    assert np.median(plain) > 100


def test_where_every_arc_is_beyond_the_threshold_there_is_no_information():
    arcs = weighed(star_field(np.random.default_rng(4), frames=2), GROUND)
    far = GROUND.copy()
    far[0] *= 10
    paid = measure_huber_effect(arcs, far, 8, 1e-6)
    assert paid.beyond == arcs.n_arcs
    assert paid.information_share == 0
