"""Score tests of displaced stars: rows against differences of moved stars, coefficients against refits, p-values under the null."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from boresight.calibration.trust import displacements
from boresight.calibration.trust.departures import find_departures
from boresight.calibration.trust.displacements import Block, Departure, add_up, expect, find_score, find_unseen
from boresight.estimation import batch
from boresight.estimation.arcs import arclength, pairs
from tests.calibration.sets import case, field
from tests.effort import few_of
from tests.estimation.fields import COLUMNS, ROWS, SCALE


def _places(block):
    arcs = block.arcs
    return (arcs.row_px - (ROWS - 1) / 2) / 1000, (arcs.col_px - (COLUMNS - 1) / 2) / 1000


def _tangential(block):
    x, y = _places(block)
    r2 = x**2 + y**2
    return np.stack([[2 * x * y, r2 + 2 * x**2], [r2 + 2 * y**2, 2 * x * y]]).transpose(2, 0, 1)


def _own(block):
    """What the camera has itself, parameter by parameter, and turns, which no arc sees."""
    s, J = block.on_detector
    ds_dx = block.fitted.problem.camera.directions_and_jacobian(
        block.fitted.x, block.arcs.row_px, block.arcs.col_px, block.arcs.pitch
    )[1]
    turns = np.stack([np.cross(axis, s) for axis in np.eye(3)], axis=-1)
    return np.linalg.pinv(J) @ np.concatenate([ds_dx * SCALE, 1e-3 * turns], axis=2)


def _in_sky(block):
    return np.random.default_rng(block.first).normal(size=(block.arcs.n_stars, 2, 3))


def _growing(block):
    """A focal length that grows."""
    return -block.H[:, :1] * (block.frame_of_arc / block.fitted.arcs.n_frames - 0.5)[:, None]


TANGENTIAL = Departure("tangential", "detector", _tangential)
ALL = (
    TANGENTIAL,
    Departure("own", "detector", _own),
    Departure("sky", "sky", _in_sky),
    Departure("f", "rows", _growing),
)


def _arcs(s, star_start):
    found = [s[first:last][pairs(last - first)] for first, last in pairwise(star_start)]
    return np.concatenate([arclength(each[:, 0], each[:, 1]) for each in found])


def _whitened(arcs, values):
    found, a0 = values.copy(), 0
    for n in 2 * np.diff(arcs.star_start) - 3:
        L = np.zeros((n, n))
        for d in range(5):
            L[np.arange(d, n), np.arange(n - d)] = arcs.band[a0 + d : a0 + n, 4 - d]
        found[a0 : a0 + n] = np.linalg.solve(L, values[a0 : a0 + n])
        a0 += n
    return found


def _differences(block, departure, step=1e-3):
    """Whitened change of the arcs by each field, by moving stars to both sides."""
    arcs, x, camera = block.arcs, block.fitted.x, block.fitted.problem.camera
    u, columns = departure.fields(block), []
    for c in range(u.shape[2]):
        sides = []
        for side in (step, -step):
            if departure.kind == "detector":
                place = arcs.row_px + side * u[:, 0, c], arcs.col_px + side * u[:, 1, c]
                s = camera.directions(x, *place, arcs.pitch)
            else:
                s = arcs.s_i + side * 1e-3 * np.einsum("nij,nj->ni", block.in_sky[1], u[:, :, c])
            sides.append(_arcs(s, arcs.star_start))
        scale = 1.0 if departure.kind == "detector" else 1e-3
        columns.append(_whitened(arcs, (sides[0] - sides[1]) / (2 * step * scale)))
    return np.array(columns).T


def test_rows_of_displaced_centroids_and_directions_are_those_of_moved_stars(sensor, catalogue):
    block = Block(case(field(3, frames=6, stars=7), sensor, catalogue).ground, 1, 5)
    for departure in ALL[:3]:
        rows = block.displace(departure.fields(block), departure.kind)
        expected = _differences(block, departure)
        np.testing.assert_allclose(rows, expected, atol=1e-6 * np.abs(expected).max())


def test_sums_over_blocks_are_those_of_the_whole_set(sensor, catalogue, monkeypatch):
    ground = case(field(3, frames=10, stars=7), sensor, catalogue).ground
    whole = add_up(ground, ALL[:2] + ALL[3:])
    monkeypatch.setattr(displacements, "FRAMES", 3)
    pieces = add_up(ground, ALL[:2] + ALL[3:])
    for name in ("G_G", "G_H", "G_e", "squares", "A", "b"):
        np.testing.assert_allclose(getattr(pieces, name), getattr(whole, name), rtol=1e-9, atol=1e-9)
    assert (pieces.n_arcs, pieces.places) == (whole.n_arcs, whole.places)
    assert add_up(ground, ALL[:1], most_frames=5).n_arcs < whole.n_arcs


def _moved(telemetry, u):
    return replace(telemetry, row_px=telemetry.row_px + u[:, 0], col_px=telemetry.col_px + u[:, 1])


def _displaced(telemetry, c):
    x, y = (telemetry.row_px - (ROWS - 1) / 2) / 1000, (telemetry.col_px - (COLUMNS - 1) / 2) / 1000
    r2 = x**2 + y**2
    return _moved(telemetry, np.array([[2 * x * y, r2 + 2 * x**2], [r2 + 2 * y**2, 2 * x * y]]).transpose(2, 0, 1) @ c)


@pytest.mark.parametrize("noise", [1.0, 2.5])
def test_coefficients_shift_and_fall_of_chi_square_are_those_of_a_fit_with_the_terms_free(noise, sensor, catalogue):
    true = np.array([0.4, -0.3])
    telemetry = _displaced(field(5, frames=60, noise_px=noise * sensor.centroid_sigma_px), true)
    ground = case(telemetry, sensor, catalogue).ground
    score = find_score(add_up(ground, [TANGENTIAL]), "tangential")
    # a fit with the terms free: centroids moved back by any c, and chi-square of the camera's fit least over c
    free, scale = ground.parameters.free, ground.parameters.scale
    u = _tangential(Block(ground, 0, ground.arcs.n_frames))

    def fit(c):
        arcs = replace(ground.arcs, row_px=ground.arcs.row_px - u[:, 0] @ c, col_px=ground.arcs.col_px - u[:, 1] @ c)
        return batch.fit(arcs, ground.x, free, scale)

    h = 0.5
    steps = [np.array([a, b]) * h for a, b in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1))]
    f0, a1, a2, b1, b2, both = (fit(c).chi2 for c in steps)
    gradient = np.array([a1 - a2, b1 - b2]) / (2 * h)
    cross = both - a1 - b1 + f0
    hessian = np.array([[a1 + a2 - 2 * f0, cross], [cross, b1 + b2 - 2 * f0]]) / h**2
    c = -np.linalg.solve(hessian, gradient)
    best, variance = fit(c), fit(c).chi2 / (ground.arcs.n_arcs - 10)
    np.testing.assert_allclose(score.c, c, rtol=0.03)
    np.testing.assert_allclose(score.statistic, (f0 - best.chi2) / variance, rtol=0.03)
    np.testing.assert_allclose(score.d, (ground.x - best.x)[free] / scale, rtol=0.05, atol=0.02 * np.abs(score.d).max())
    expected = 2 * np.linalg.inv(hessian) * variance
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(score.covariance / np.outer(size, size), expected / np.outer(size, size), atol=0.02)
    assert (np.abs(score.c - true) < 4 * np.sqrt(np.diag(score.covariance))).all()
    assert score.p < 1e-6
    assert score.misled > 1


def test_what_the_camera_has_itself_and_what_arcs_do_not_see_has_no_degree_of_freedom(sensor, catalogue):
    ground = case(field(3), sensor, catalogue).ground
    score = find_score(add_up(ground, ALL), "own")
    assert (score.dof, score.p, score.misled) == (0, 1.0, 0.0)
    held = case(field(3), sensor, catalogue, free=("f_m", "b2_per_m2")).ground
    assert find_score(add_up(held, ALL), "own").dof >= 4  # a shift is hardly told from a tilt


def _p_values(sensor, catalogue, seeds, noise=1.0, departures=(TANGENTIAL, ALL[3])):
    found = []
    for seed in seeds:
        ground = case(
            field(seed, frames=30, stars=10, noise_px=noise * sensor.centroid_sigma_px), sensor, catalogue
        ).ground
        sums = add_up(ground, departures)
        found.append([find_score(sums, one.name).p for one in departures])
    return np.array(found).T


def test_p_values_of_clean_sets_are_uniform_whatever_the_noise(sensor, catalogue):
    for p in _p_values(sensor, catalogue, range(100, 120), noise=1.5):
        assert stats.kstest(p, "uniform").pvalue > 1e-3


@pytest.mark.full
def test_p_values_of_three_hundred_clean_sets_are_uniform(sensor, catalogue):
    for p in _p_values(sensor, catalogue, range(1000, 1300)):
        assert stats.kstest(p, "uniform").pvalue > 1e-3
        assert stats.binomtest(int((p < 0.05).sum()), len(p), 0.05).pvalue > 1e-3


@pytest.mark.parametrize("name", few_of(["seam", "lens", "tangential", "radial", "affine", "trail"], 2))
def test_what_is_called_unseen_is_missed_once_in_ten_and_moves_its_parameter_as_far_as_said(name, sensor, catalogue):
    ground = case(field(5, frames=60), sensor, catalogue).ground
    departures = [next(one for one in find_departures(ground)[0] if one.name == name)]
    block, sums, level = Block(ground, 0, ground.arcs.n_frames), add_up(ground, departures), 1.6e-4
    H, P = ground.H, np.linalg.inv(sums.A)
    G = np.concatenate([block.displace(one.fields(block), "detector") for one in departures], axis=1)
    found = find_unseen(sums, find_score(sums, name), level, 1e-2)
    noise = np.sqrt(ground.e @ ground.e / (len(H) - len(P)))
    e = noise * np.random.default_rng(11).normal(size=(1000, len(H))) + G[:, sums.places[name]] @ found.c
    drawn = [replace(sums, G_e=G.T @ each, b=H.T @ each, chi2=float(each @ each)) for each in e]
    missed = sum(find_score(one, name).p >= level for one in drawn)
    assert 70 < missed < 132
    shift = np.abs(np.mean(e, axis=0) @ H @ P) / np.sqrt(np.diag(P))
    assert shift[found.parameter] == pytest.approx(found.sigmas, abs=4 / np.sqrt(1000))
    assert shift.max() < found.sigmas + 4 / np.sqrt(1000)


def _drawn(ground, departure, size):
    """Sums of a set that departs by coefficients of so many times its fields' own noise, and how far that moves the parameters."""
    sums, rng = add_up(ground, [departure]), np.random.default_rng(12)
    G = Block(ground, 0, ground.arcs.n_frames).displace(
        departure.fields(Block(ground, 0, ground.arcs.n_frames)), "detector"
    )
    H, P = ground.H, np.linalg.inv(sums.A)
    for _ in range(400):
        c = size * rng.normal(size=len(sums.squares)) / np.sqrt(sums.squares)
        e = rng.normal(size=len(H)) + G @ c
        yield replace(sums, G_e=G.T @ e, b=H.T @ e, chi2=float(e @ e)), -P @ (H.T @ G @ c)


@pytest.mark.parametrize("size", [6.0, 30.0])
def test_what_is_expected_of_a_departure_is_as_far_from_the_truth_as_it_says(size, sensor, catalogue):
    ground = case(field(5, frames=60), sensor, catalogue).ground
    lens = next(one for one in find_departures(ground)[0] if one.name == "lens")
    squared = []
    for sums, moved in _drawn(ground, lens, size):
        if find_score(sums, "lens").p > 1e-3:  # nobody would widen
            continue
        d, P = expect(sums, ["lens"])
        values, vectors = np.linalg.eigh(P / np.outer(*2 * [np.sqrt(np.diag(P))]))
        large = values > 1e-9 * values.max()
        off = vectors[:, large].T @ ((moved - d) / np.sqrt(np.diag(P)))
        squared.append([float(np.sum(off**2 / values[large])), int(large.sum())])
    found, dof = np.array(squared).mean(axis=0)
    assert found == pytest.approx(dof, rel=0.3)


def test_no_tangential_distortion_that_is_missed_as_often_moves_a_parameter_farther(sensor, catalogue):
    sums = add_up(case(field(5, frames=60), sensor, catalogue).ground, [TANGENTIAL])
    P = np.linalg.inv(sums.A)
    found = find_unseen(sums, find_score(sums, "tangential"), 1.6e-4)
    score, towards = find_score(sums, "tangential"), -P @ sums.G_H.T
    F = np.linalg.inv(score.covariance)
    around = np.exp(1j * np.linspace(0, np.pi, 400))
    c = np.stack([around.real, around.imag])
    c *= np.sqrt(found.c @ F @ found.c / np.einsum("ik,ij,jk->k", c, F, c))
    assert np.abs((towards @ c) / np.sqrt(np.diag(P))[:, None]).max() == pytest.approx(found.sigmas, rel=1e-3)
