"""Residuals in pixels and the stars behind them: sizes by leverage, displaced stars by name."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from boresight.calibration.trust.residuals import compute_star_residuals
from boresight.calibration.trust.stars import StarTable, _merged, star_table, stars
from boresight.estimation.statistics.consistency import chi_square
from boresight.sky.guide_stars import phrases, star_flags
from tests.calibration.judged import case, field, simulated

PIXEL_RAD = 2.2e-6 / 0.016


def _displaced(catalogue, star, east_rad):
    ra = catalogue.ra_rad.copy()
    place = catalogue.find_index(np.array([star]))[0]
    ra[place] += east_rad / np.cos(catalogue.dec_rad[place])
    return replace(catalogue, ra_rad=ra)


def _often_seen(telemetry, rank=0):
    star, counts = np.unique(telemetry.star_id[telemetry.star_id > 0], return_counts=True)
    return int(star[np.argsort(-counts)[rank]])


@pytest.mark.parametrize("parity", [1, -1])
def test_residuals_are_those_of_a_plain_search_for_the_best_attitude(parity, sensor, catalogue):
    telemetry = field(1, frames=10, stars=7, parity=parity)
    ground = case(telemetry, replace(sensor, parity=parity), catalogue).ground
    found = compute_star_residuals(ground)
    stars_of = slice(*found.arcs.star_start[3:5])
    s_i, row, col = found.arcs.s_i[stars_of], found.arcs.row_px[stars_of], found.arcs.col_px[stars_of]
    mirror = np.array([1.0, parity, 1.0])
    s_d = ground.problem.camera.directions(ground.x, row, col, ground.arcs.pitch) * mirror
    start = Rotation.align_vectors(s_d, s_i)[0]

    def misfit(turn):
        seen = (Rotation.from_rotvec(turn) * start).apply(s_i) * mirror
        p_row, p_col = ground.problem.camera.project(ground.x, seen, ground.arcs.pitch)
        return np.concatenate([row - p_row, col - p_col])

    best = least_squares(misfit, np.zeros(3), x_scale=1e-4, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose(found.r[stars_of].T.ravel(), best.fun, atol=1e-4)


def test_residuals_over_their_own_sigmas_have_unit_variance_however_few_stars(sensor, catalogue):
    for stars_in, seed in ((4, 1), (5, 2), (30, 3)):
        found = compute_star_residuals(case(field(seed, frames=100, stars=stars_in), sensor, catalogue).ground)
        n = found.z.size
        test = chi_square(float(np.sum(found.z**2)), n)
        spread = (test.upper - 1) * (2.0 if stars_in < 6 else 1.2)  # residuals of one exposure are correlated
        assert abs(test.mean - 1) < 1.5 * spread
        assert found.spread == pytest.approx(1, abs=0.06)


def test_no_star_of_twenty_clean_sets_is_suspect(catalogue):
    named = [
        star_table(ground, compute_star_residuals(ground)).suspect.sum()
        for ground in (simulated(catalogue, 1 + seed % 6, 60, seed).ground for seed in range(20))
    ]
    assert sum(named) == 0


@pytest.mark.parametrize("number", [1, 4, 6])
def test_a_star_displaced_by_a_pixel_is_found_alone_with_its_displacement(number, catalogue):
    star = _often_seen(simulated(catalogue, number, 100).telemetry)
    ground = simulated(catalogue, number, 100, sky=_displaced(catalogue, star, -PIXEL_RAD)).ground
    table = star_table(ground, compute_star_residuals(ground))
    worst = stars(ground, table)[0]
    assert table.star_id[table.suspect].tolist() == [star]
    assert worst["star_id"] == star
    assert worst["suspect"]
    assert worst["mean_residual_px"] == pytest.approx(1, abs=0.3)
    east, north = worst["east_north_arcsec"]  # from the catalogue's place to the true one
    sigma_east, sigma_north = worst["sigma_arcsec"]
    assert east == pytest.approx(np.degrees(PIXEL_RAD) * 3600, abs=4 * sigma_east + 1)
    assert north == pytest.approx(0, abs=4 * sigma_north + 1)


def test_three_displaced_stars_are_named_without_their_neighbours(catalogue):
    telemetry = simulated(catalogue, 2, 100).telemetry
    wrong = [_often_seen(telemetry, rank) for rank in (0, 3, 9)]
    sky = catalogue
    for star in wrong:
        sky = _displaced(sky, star, 1.5 * PIXEL_RAD)
    trust = simulated(catalogue, 2, 100, sky=sky).trust
    assert set(trust["suspects"]) == set(wrong)
    assert all(entry["suspect"] for entry in trust["stars"][:3])
    assert not any(entry["suspect"] for entry in trust["stars"][3:])
    assert f"3 of {trust['stars_in_all']} stars are off the catalogue place" in trust["stars_sentence"]


def test_understated_noise_alone_makes_no_suspect(sensor, catalogue):
    trust = case(field(7), replace(sensor, centroid_sigma_px=0.2), catalogue).trust
    assert trust["suspects"] == []
    assert trust["residuals"]["spread"] == pytest.approx(0.437 / 0.2, rel=0.06)


def test_what_the_catalogue_says_against_a_star_stands_beside_it(catalogue):
    judged = simulated(catalogue, 1, 60)
    flagged = {entry["star_id"]: entry["flags"] for entry in judged.trust["stars"]}
    every = star_flags(catalogue, 5 * PIXEL_RAD)
    expected = {star: phrases(int(every[catalogue.find_index(np.array([star]))[0]])) for star in flagged}
    assert {star: flags for star, flags in flagged.items() if flags} == {
        star: said for star, said in expected.items() if said
    }
    assert {"unreliable astrometry", "double"} <= {flag for flags in flagged.values() for flag in flags}


def test_telemetry_without_star_numbers_has_residuals_but_no_table_of_stars(sensor, catalogue):
    trust = case(replace(field(8), star_id=None), sensor, catalogue).trust
    assert trust["stars"] is None
    assert trust["unavailable"]["stars"].endswith("give star_id.")
    assert trust["residuals"]["star_id"] is None


def _table(star_id, z):
    n = len(star_id)
    pairs, ones = np.zeros((n, 2)), np.ones(n)
    star_id, counts = np.array(star_id), np.ones(n, np.int64)
    return StarTable(star_id, counts, pairs, pairs, np.array(z, float), ones, ones, ones, np.zeros(n, np.bool_))


def test_stars_that_have_a_residual_only_before_or_only_after_keep_what_is_known_of_them():
    before, after = _table([1, 2, 5], [1, 20, 3]), _table([1, 4], [0.5, 7])
    merged = _merged(before, after, np.array([False, True, False]))
    assert merged.star_id.tolist() == [1, 2, 4, 5]
    assert merged.z.tolist() == [0.5, 20, 7, 3]
    assert merged.suspect.tolist() == [False, True, False, False]
    assert merged.displacement_rad.shape == (4, 2)
