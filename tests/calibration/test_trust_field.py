"""Residuals over the detector, their distribution, outliers, the worst frames: each against plain NumPy and what was put in."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from boresight.calibration.trust.field import (
    cell_edges,
    residual_distribution,
    residual_field,
    residual_outliers,
    two_sided,
)
from boresight.calibration.trust.innovations import deviates, worst_frames
from boresight.calibration.trust.residuals import compute_star_residuals
from tests.calibration.judged import case, field, simulated


@pytest.fixture(scope="module")
def judged(catalogue):
    ground = simulated(catalogue, 1, 120).ground
    return ground, compute_star_residuals(ground)


@pytest.fixture(scope="module")
def noisy(catalogue):
    clean = simulated(catalogue, 1, 80).telemetry
    rng, row_px = np.random.default_rng(5), clean.row_px.copy()
    of_17 = clean.frame == 17
    row_px[of_17] += 0.6 * rng.normal(size=of_17.sum())
    row_px[np.flatnonzero(clean.frame == 41)[2]] += 4.0
    return case(replace(clean, row_px=row_px), simulated(catalogue, 1, 5).problem.sensor, catalogue).ground


def test_cells_hold_the_plain_means_of_their_stars(judged):
    ground, found = judged
    view = residual_field(ground, found)
    i, j = 2, 3
    rows, cols = view["row_edges_px"], view["col_edges_px"]
    inside = (found.arcs.row_px >= rows[i]) & (found.arcs.row_px < rows[i + 1])
    inside &= (found.arcs.col_px >= cols[j]) & (found.arcs.col_px < cols[j + 1])
    sigma = found.arcs.sigma_px[inside] * np.sqrt(found.M[inside, 1, 1]) * max(found.spread, 1)
    after = view["after"]
    assert after["count"][i][j] == inside.sum() > 4
    assert after["mean_row_px"][i][j] == pytest.approx(found.r[inside, 0].mean(), rel=1e-3)
    assert after["sigma_col_px"][i][j] == pytest.approx(np.sqrt(np.sum(sigma**2)) / inside.sum(), rel=1e-3)
    assert after["rms_px"][i][j] == pytest.approx(np.sqrt(np.mean(found.r[inside] ** 2)), rel=1e-3)
    assert np.sum(after["count"]) == found.known.sum()


def test_a_good_fit_leaves_no_pattern_and_the_old_parameters_do(judged):
    view = residual_field(*judged)
    assert view["even"]
    assert view["before"]["p"] < 1e-6
    assert view["before"]["rms_in_all_px"] > 2 * view["after"]["rms_in_all_px"]


def test_patterns_are_called_so_in_about_one_clean_set_of_a_hundred(sensor, catalogue):
    p = [
        residual_field(ground, compute_star_residuals(ground))["after"]["p"]
        for ground in (case(field(seed, frames=30), sensor, catalogue).ground for seed in range(30))
    ]
    assert np.mean(np.array(p) < 0.01) <= 2 / 30
    assert stats.kstest(p, "uniform").pvalue > 1e-3 or np.mean(p) > 0.5  # the fit takes freedom out: p leans up


def test_a_distortion_that_is_not_fitted_is_a_pattern(catalogue):
    ground = simulated(catalogue, 1, 120, free=("f_m",)).ground
    view = residual_field(ground, compute_star_residuals(ground))
    assert not view["even"]
    assert "pattern over the detector that noise does not explain" in view["sentence"]


@pytest.mark.parametrize(
    ("rows", "columns", "stars"), [(1944, 2592, 3000), (2592, 1944, 3000), (500, 4000, 40), (9, 9, 0)]
)
def test_cells_cover_the_detector_and_are_nearly_square(rows, columns, stars):
    row_edges, col_edges = cell_edges(rows, columns, stars)
    assert (row_edges[0], row_edges[-1], col_edges[0], col_edges[-1]) == (-0.5, rows - 0.5, -0.5, columns - 0.5)
    assert np.diff(row_edges)[0] / np.diff(col_edges)[0] == pytest.approx(1, rel=0.8)


def test_the_distribution_is_that_of_the_residuals_over_their_sigmas(judged):
    view = residual_distribution(*judged)
    z = judged[1].z[judged[1].known].ravel()
    assert view["count"] == len(z) == sum(view["after"]["counts"]) + view["after"]["below"] + view["after"]["above"]
    assert view["after"]["counts"] == np.histogram(z, np.arange(-6, 6.01, 0.25))[0].tolist()
    middle = view["normal"].index(1.0)
    assert view["quantile"][middle] == pytest.approx(np.quantile(z, stats.norm.cdf(1.0)), rel=1e-4)
    assert view["sigma"] == pytest.approx(1, abs=4 / np.sqrt(2 * len(z)))
    apart = np.abs(np.array(view["quantile"]) - view["normal"]) / view["sigma_of_quantile"]
    assert np.mean(apart < 3) > 0.9
    assert view["before"]["below"] + view["before"]["above"] > view["after"]["below"] + view["after"]["above"]


def test_the_tail_probability_is_the_exact_binomial_one():
    for count, n, share in ((0, 1000, 0.0027), (3, 1000, 0.0027), (12, 1000, 0.0027)):
        low, high = stats.binom.cdf(count, n, share), stats.binom.sf(count - 1, n, share)
        assert two_sided(count, n, share) == pytest.approx(min(1, 2 * min(low, high)))


def test_a_star_far_off_is_the_first_outlier_with_its_frame(noisy):
    view = residual_outliers(noisy, compute_star_residuals(noisy))
    assert view["in_all"] >= 1
    assert view["frame"][0] == 41
    assert abs(view["d_row_px"][0]) == pytest.approx(4, abs=1)
    assert view["normalised"] == sorted(view["normalised"], reverse=True)


def test_a_hundredth_of_wrong_centroids_makes_heavy_tails(sensor, catalogue):
    clean, rng = field(3, frames=60), np.random.default_rng(6)
    wrong = clean.row_px + np.where(rng.uniform(size=len(clean)) < 0.01, 3.0, 0.0)
    ground = case(replace(clean, row_px=wrong), sensor, catalogue).ground
    view = residual_distribution(ground, compute_star_residuals(ground))
    assert not view["normal_tails"]
    assert view["sentence"].endswith("some stars are wrong; look at the outliers.")


def test_the_worst_frames_are_the_spoiled_ones(noisy):
    view = worst_frames(noisy)
    assert set(view["frame"][:2]) == {17, 41}
    assert view["deviation"][1] > 3 > view["deviation"][3]
    assert view["beyond"] >= 2
    k = int(np.flatnonzero(noisy.arcs.frame == 17)[0])
    place = view["frame"].index(17)
    chi2 = view["chi2_per_dof"][place] * view["dof"][place]
    assert chi2 == pytest.approx(float(noisy.sums.chi2[k]), rel=1e-3)


def test_deviates_have_the_tail_of_chi_square():
    for dof in (5.0, 20.0, 200.0):
        for p in (0.5, 0.01, 1e-4):
            assert stats.norm.sf(deviates(stats.chi2.isf(p, dof), np.array(dof))) == pytest.approx(p, rel=0.3)


def test_a_set_too_small_for_cells_says_so(sensor, catalogue):
    trust = case(field(2, frames=3, stars=4, exposures=1), sensor, catalogue, free=("f_m",)).trust
    assert trust["residual_distribution"] is None
    assert trust["unavailable"]["residual_distribution"].startswith("A distribution needs 50 residuals")
