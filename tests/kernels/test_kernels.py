"""Every compiled loop of estimation and matching against plain NumPy: the clever form is proven by the naive one."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.peers import plain_directions
from boresight import kernels
from boresight.calibration.evaluation.pixel_residuals import FreeCovariance, pixel_residuals
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import angular, singular_values
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import angular_sigma
from boresight.estimation.attitude import attitudes, rotation_vector, wahba
from boresight.estimation.batch import compute_chi2, normal_equations
from boresight.estimation.filters.angular import AllPairs
from boresight.estimation.filters.singular import SingularValues
from boresight.estimation.metrics import arc_errors, tail_rms
from boresight.estimation.singular_values import STAR_MODELS, Selection
from boresight.estimation.statistics.cramer_rao import centroid_rows
from boresight.kernels import arclengths, matching
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import load_catalogue
from boresight.sky.guide_stars import guide_stars, observer_motion
from tests.compiled import CompiledParts
from tests.effort import effort
from tests.estimation.fields import FREE, GROUND, PITCH, SCALE, TRUTH, star_field, whitened
from tests.exposures import GATE, SIGMA, Exposure

parts, loops = CompiledParts(arclengths), CompiledParts(matching)


def _plain_exposure(field, k, x, sigma):
    stars = slice(field.star_start[k], field.star_start[k + 1])
    s, ds = plain_directions(x, field.row_px[stars], field.col_px[stars], PITCH)
    pair = arcsets.pairs(stars.stop - stars.start)
    i, j = pair.T
    measured = arcsets.arclength(s[i], s[j])
    e = measured - arcsets.arclength(field.s_i[stars][i], field.s_i[stars][j])
    H = -(np.einsum("ai,aip->ap", s[j], ds[i]) + np.einsum("ai,aip->ap", s[i], ds[j])) / np.sin(measured)[:, None]
    return e, H, arcsets.covariance(field.s_i[stars], sigma[stars])


@pytest.mark.parametrize("x", [GROUND, TRUTH], ids=["ground", "truth"])
def test_the_fused_normal_equations_equal_the_plain_weighted_sums(x):
    field = star_field(np.random.default_rng(5), frames=3)
    sigma = arcsets.angular_sigma(INVERTED_WANG, x, field)
    field, _ = arcsets.whiten(field, sigma)
    fused = normal_equations(field, x, FREE, SCALE)
    A, b, chi2, total = np.zeros((8, 8)), np.zeros(8), 0.0, 0.0
    for k in range(field.n_exposures):
        e, H, R = _plain_exposure(field, k, x, sigma)
        H = H * SCALE
        A += H.T @ np.linalg.solve(R, H)
        b += H.T @ np.linalg.solve(R, e)
        chi2 += e @ np.linalg.solve(R, e)
        total += e @ e
    np.testing.assert_allclose(fused.A, A, rtol=1e-8, atol=1e-10 * np.abs(A).max())
    np.testing.assert_allclose(fused.b, b, rtol=1e-7, atol=1e-9 * np.abs(b).max())
    np.testing.assert_allclose([fused.chi2, fused.sum_of_squares], [chi2, total], rtol=1e-8)


def test_a_pass_without_derivatives_finds_the_same_chi_square():
    field = whitened(star_field(np.random.default_rng(5), frames=3), GROUND)
    whole = normal_equations(field, TRUTH, FREE, SCALE)
    assert compute_chi2(field, TRUTH) == pytest.approx(whole.chi2, rel=1e-12)


@given(st.floats(0.0, np.pi), st.floats(1e-3, 1e3))
def test_the_angle_that_needs_no_branch_is_the_arctangents(phi, size):
    sine, cosine = size * np.sin(phi), size * np.cos(phi)
    assert parts.angle(sine, cosine) == pytest.approx(np.arctan2(sine, cosine), rel=4e-16, abs=1e-300)


def _plain_centroids(field, x, free, scale, kept):
    """The rows of the bound and the residuals in pixels, exposure by exposure, by NumPy's own means."""
    s, ds = INVERTED_WANG.directions_and_jacobian(x, field.row_px, field.col_px, PITCH)
    at = lambda down, right: INVERTED_WANG.directions(x, field.row_px + down, field.col_px + right, PITCH)  # noqa: E731 - short
    D = np.stack([at(0.5, 0) - at(-0.5, 0), at(0, 0.5) - at(0, -0.5)], axis=-1)
    inverse = np.linalg.pinv(D)
    J = inverse @ (ds[:, :, free] * scale) / field.sigma_px[:, None, None]
    K = -inverse @ np.stack([np.cross(axis, s) for axis in np.eye(3)], axis=-1) / field.sigma_px[:, None, None]
    N = []
    for first, last in pairwise(field.star_start):
        of = slice(first, last)
        rests_on = K[of][kept[of]].reshape(-1, 3), J[of][kept[of]].reshape(-1, len(free))
        N.append(np.linalg.inv(rests_on[0].T @ rests_on[0]))
        J[of] = J[of] - K[of] @ (N[-1] @ rests_on[0].T @ rests_on[1])
    return inverse, J, K, np.array(N)


@pytest.mark.parametrize("left_out", [0.0, 0.2])
@pytest.mark.parametrize("parity", [1, -1])
def test_centroids_and_their_residuals_are_those_of_plain_sums(left_out, parity):
    rng = np.random.default_rng(3)
    field = whitened(star_field(rng, frames=4, mean_stars=9.0), GROUND)
    field = replace(field, s_i=field.s_i * [1, parity, 1], sigma_px=rng.uniform(0.1, 0.5, field.n_stars))
    free, kept = FREE[[0, 3, 4, 7]], rng.uniform(size=field.n_stars) >= left_out
    inverse, J, K, N = _plain_centroids(field, TRUTH, free, SCALE[free], kept)
    rows = centroid_rows(INVERTED_WANG, TRUTH, field, free, SCALE[free], kept)
    for found, plain in ((rows.inverse, inverse), (rows.J, J), (rows.K, K), (rows.N, N)):
        np.testing.assert_allclose(found, plain, rtol=1e-8, atol=1e-9 * np.abs(plain).max())
    root = rng.normal(size=(4, 4))
    seen = pixel_residuals(INVERTED_WANG, TRUTH, field, parity, FreeCovariance(free, SCALE[free], root @ root.T), kept)
    of = np.repeat(np.arange(field.n_exposures), np.diff(field.star_start))
    M = K @ N[of] @ K.transpose(0, 2, 1) + J @ root @ root.T @ J.transpose(0, 2, 1)
    np.testing.assert_allclose(seen.M, np.eye(2) + np.where(kept, -1, 1)[:, None, None] * M, rtol=1e-7, atol=1e-9)
    whitened_r = np.where(kept[:, None], seen.r / field.sigma_px[:, None], 0.0)
    left = np.add.reduceat(np.einsum("nki,nk->ni", K, whitened_r), field.star_start[:-1])
    size = np.add.reduceat(np.einsum("nki,nk->ni", np.abs(K), np.abs(whitened_r)), field.star_start[:-1])
    assert (np.abs(left) < 1e-8 * size).all()  # no turn of an exposure makes its residuals smaller
    _stars_move_with_their_places(seen, field, parity)


def _stars_move_with_their_places(seen, field, parity):
    """`from_sky` against the projection of places moved to the east and to the north."""
    ra, dec, step = np.arctan2(field.s_i[:, 1], field.s_i[:, 0]), np.arcsin(field.s_i[:, 2]), 1e-6
    of = np.repeat(np.arange(field.n_exposures), np.diff(field.star_start))
    for k, (east, north) in enumerate([(step, 0.0), (0.0, step)]):
        moved = []
        for sign in (1, -1):
            a, d = ra + sign * east / np.cos(dec), dec + sign * north
            s_i = np.stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)], axis=-1)
            s = np.einsum("nij,nj->ni", seen.C[of], s_i) * [1, parity, 1]
            moved.append(np.stack(INVERTED_WANG.project(TRUTH, s, PITCH), axis=-1))
        slope = (moved[0] - moved[1]) / (2 * step)
        np.testing.assert_allclose(seen.from_sky[:, :, k], slope, rtol=3e-3, atol=3e-3 * np.abs(slope).max())


def test_a_subset_of_parameters_gives_the_subset_of_the_equations_finite_on_the_principal_point():
    field = whitened(star_field(np.random.default_rng(6), frames=2), GROUND)
    some = np.array([0, 4, 7])
    whole, part = normal_equations(field, TRUTH, FREE, SCALE), normal_equations(field, TRUTH, some, SCALE[some])
    np.testing.assert_allclose(part.A, whole.A[np.ix_(some, some)], rtol=1e-12)
    np.testing.assert_allclose(part.b, whole.b[some], rtol=1e-12)
    field = star_field(np.random.default_rng(7), frames=1)
    field.row_px[0], field.col_px[0] = GROUND[1], GROUND[2]
    equations = normal_equations(whitened(field, GROUND), GROUND, FREE, SCALE)
    assert equations.finite()


def test_arc_errors_and_their_sums_equal_the_plain_form():
    field = whitened(star_field(np.random.default_rng(9), frames=2), GROUND)
    sigma = arcsets.angular_sigma(INVERTED_WANG, GROUND, field)
    errors = arc_errors(field, TRUTH)
    plain = np.concatenate([_plain_exposure(field, k, TRUTH, sigma)[0] for k in range(field.n_exposures)])
    np.testing.assert_allclose(errors, plain, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(tail_rms(field, np.stack([TRUTH])), np.sqrt(np.mean(plain**2)), rtol=1e-9)


def _padded(values):
    padded = np.zeros((8,) * values.ndim, order="F")
    padded[tuple(slice(0, n) for n in values.shape)] = values
    return padded


def _random_upper(rng, n, spread):
    S = np.triu(rng.normal(size=(n, n)))
    S[np.diag_indices(n)] = 10.0 ** rng.uniform(-spread, spread, n)
    return S


@given(n=st.integers(1, 8), seed=st.integers(0, 2**32 - 1), spread=st.floats(0, 3))
@settings(deadline=None)
def test_carlsons_update_equals_the_covariance_update(n, seed, spread):
    rng = np.random.default_rng(seed)
    S, h, z, innovation = _random_upper(rng, n, spread), rng.normal(size=n), rng.normal(size=n), rng.normal()
    P = S @ S.T
    alpha = 1 + h @ P @ h
    K = P @ h / alpha
    expected_z, expected_P = z - K * innovation, P - np.outer(K, K) * alpha
    z, S, h = _padded(z), _padded(S), _padded(h)
    nis = parts.carlson_update(INVERTED_WANG.kind, z, S, h, innovation, np.empty(8), np.empty(8))
    assert not z[n:].any()
    assert not S[n:].any()
    z, S = z[:n], S[:n, :n]
    np.testing.assert_allclose(z, expected_z, rtol=1e-9, atol=1e-9 * np.abs(K * innovation).max())
    np.testing.assert_allclose(S @ S.T, expected_P, atol=1e-9 * np.abs(P).max())
    assert nis == pytest.approx(innovation**2 / alpha, rel=1e-12)
    assert not np.tril(S, -1).any()


def test_carlsons_update_leaves_a_zero_covariance_alone():
    S, z = np.zeros((8, 8), order="F"), np.ones(8)
    parts.carlson_update(INVERTED_WANG.kind, z, S, np.ones(8), 5.0, np.empty(8), np.empty(8))
    np.testing.assert_array_equal(z, np.ones(8))
    np.testing.assert_array_equal(S, np.zeros((8, 8)))


@given(n=st.integers(1, 8), seed=st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_inflation_refactors_P_plus_Q_and_stays_triangular(n, seed):
    rng = np.random.default_rng(seed)
    S, q = _random_upper(rng, n, 1), np.abs(rng.normal(size=n))
    P = S @ S.T
    parts.inflate(S, q, np.empty((n, n)))
    np.testing.assert_allclose(S @ S.T, P + np.diag(q**2), rtol=1e-10, atol=1e-12 * np.abs(P).max())
    assert not np.tril(S, -1).any()


@pytest.mark.parametrize("x", [GROUND, TRUTH], ids=["ground", "truth"])
def test_the_compiled_rays_and_their_derivatives_equal_the_plain_ones(x):
    row, col = np.random.default_rng(10).uniform(0, 1900, (2, 50))
    s, D = np.empty((50, 3)), np.empty((50, 3, 8))
    kernels.rays_and_jacobians(INVERTED_WANG.kind, x, PITCH, row, col, s, D)
    expected_s, expected_D = plain_directions(x, row, col, PITCH)
    np.testing.assert_allclose(s, expected_s, rtol=1e-13, atol=1e-15)
    size = np.abs(expected_D).max(axis=(0, 1))
    np.testing.assert_allclose(D / size, expected_D / size, atol=1e-13)


SUBSETS = [(1,), (2,), (3,), (1, 2), (1, 3), (2, 3), (1, 2, 3)]


def _frame(seed=1, mean_stars=9.0):
    field = star_field(np.random.default_rng(seed), frames=1, mean_stars=mean_stars)
    s, D = plain_directions(GROUND, field.row_px, field.col_px, field.pitch)
    return field.star_start, field.s_i, angular_sigma(INVERTED_WANG, TRUTH, field), s, D


def _plain_values(frame, selection):
    star_start, s_i, sigma, s, D = frame
    for first, last in pairwise(star_start):
        stars = slice(first, last)
        taken = singular_values.exposure(s_i[stars], sigma[stars], selection)
        z, g = singular_values.stacked(s[stars], taken.rows, selection)
        yield z - taken.z, np.einsum("rnj,njp->rp", g, D[stars]) * SCALE, taken.R


def _plain_pairs(frame):
    star_start, s_i, sigma, s, D = frame
    for first, last in pairwise(star_start):
        stars = slice(first, last)
        phi, g = angular.angles(s[stars])
        e = phi - angular.angles(s_i[stars])[0]
        yield e, np.einsum("rnj,njp->rp", g, D[stars]) * SCALE, angular.covariance(s_i[stars], sigma[stars])


def _normal(e, H, inverse):
    return H.T @ inverse @ H, H.T @ inverse @ e, e @ inverse @ e


def _same(found, expected):
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9 * np.abs(b).max())


@pytest.mark.parametrize("values", SUBSETS, ids=str)
@pytest.mark.parametrize("model", STAR_MODELS)
def test_compiled_values_slopes_and_weights_equal_the_plain_ones(model, values):
    frame, selection = _frame(), Selection(model, values)
    reference = SingularValues(selection, FREE, SCALE)
    dof = reference.whiten(*frame[:3])
    e, H = reference.rows(*frame[3:])
    expected = [np.zeros((8, 8)), np.zeros(8), 0.0]
    kept = 0
    for plain_e, plain_H, R in _plain_values(frame, selection):
        rows = singular_values.determined_rows(R)
        kept += len(rows)
        parts = _normal(plain_e[rows], plain_H[rows], np.linalg.inv(R[np.ix_(rows, rows)]))
        expected = [total + part for total, part in zip(expected, parts, strict=True)]
    assert dof == kept == len(e)
    _same(_normal(e, H, np.eye(len(e))), expected)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(STAR_MODELS), st.floats(3.0, 20.0))
def test_unwhitened_rows_equal_the_plain_ones_on_any_stars(seed, model, mean_stars):
    frame, selection = _frame(seed, mean_stars), Selection(model)
    reference = SingularValues(selection, FREE, SCALE)
    reference.whiten(*frame[:3])
    for e, H, (plain_e, plain_H, _) in zip(
        *reference.unwhitened(*frame[3:]), _plain_values(frame, selection), strict=True
    ):
        m = len(plain_e)
        np.testing.assert_allclose(e[:m], plain_e, atol=1e-12)
        np.testing.assert_allclose(H[:m], plain_H, rtol=1e-8, atol=1e-9 * np.abs(plain_H).max())


def test_an_exposure_hands_over_the_covariance_of_its_rows():
    frame = _frame(2)
    reference = SingularValues(Selection(), FREE, SCALE)
    reference.whiten(*frame[:3])
    for (e, H, R), (plain_e, plain_H, plain_R) in zip(
        reference.exposures(*frame[3:]), _plain_values(frame, Selection()), strict=True
    ):
        rows = singular_values.determined_rows(plain_R)
        np.testing.assert_allclose(e, plain_e[rows], atol=1e-12)
        np.testing.assert_allclose(H, plain_H[rows], rtol=1e-8, atol=1e-9 * np.abs(plain_H).max())
        np.testing.assert_allclose(R, plain_R[np.ix_(rows, rows)], atol=1e-9 * plain_R.max())


def test_the_determined_part_of_the_covariance_is_what_an_eigen_decomposition_keeps():
    frame = _frame(3, 7.0)
    for model in STAR_MODELS:
        for e, H, R in _plain_values(frame, Selection(model)):
            rows = singular_values.determined_rows(R)
            values = np.linalg.eigvalsh(R)
            if values[-len(rows)] < 1e-3 * values[-1]:
                continue  # a row dropped for its curvature: the two cut at different places
            by_rows = _normal(e[rows], H[rows], np.linalg.inv(R[np.ix_(rows, rows)]))
            by_values = _normal(e, H, np.linalg.pinv(R, rcond=1e-8, hermitian=True))
            # the rows beyond repeat the others to first order only: here the camera is ten sigmas off
            np.testing.assert_allclose(by_rows[0], by_values[0], atol=0.05 * np.abs(by_values[0]).max())


def test_compiled_pairs_equal_the_plain_ones():
    frame = _frame(4)
    reference = AllPairs(FREE, SCALE)
    dof = reference.whiten(*frame[:3])
    found = _normal(*reference.rows(*frame[3:]), np.eye(2 * frame[0][-1]))
    expected = [np.zeros((8, 8)), np.zeros(8), 0.0]
    for e, H, R in _plain_pairs(frame):
        parts = _normal(e, H, np.linalg.pinv(R, rcond=1e-10, hermitian=True))
        expected = [total + part for total, part in zip(expected, parts, strict=True)]
    assert dof == 2 * frame[0][-1] - 6
    _same(found, expected)


def test_a_filled_covariance_can_be_inverted_and_says_the_same():
    frame = _frame(5)
    reference = AllPairs(FREE, SCALE)
    reference.whiten(*frame[:3])
    for (e, H, R), (plain_e, plain_H, plain_R) in zip(
        reference.exposures(*frame[3:]), _plain_pairs(frame), strict=True
    ):
        assert np.linalg.cond(R) < 1e6
        assert np.linalg.matrix_rank(plain_R, 1e-10 * plain_R.max()) < len(plain_R)
        _same(
            _normal(e, H, np.linalg.inv(R)),
            _normal(plain_e, plain_H, np.linalg.pinv(plain_R, rcond=1e-10, hermitian=True)),
        )


def test_the_information_update_equals_the_covariance_form():
    rng = np.random.default_rng(6)
    e, H, z_prior, z_at = rng.normal(size=20), rng.normal(size=(20, 5)), rng.normal(size=5), rng.normal(size=5)
    root = rng.normal(size=(5, 9))
    P_prior = root @ root.T
    z, posterior, P = np.empty(5), np.empty((5, 5)), np.empty((5, 5))
    nis = kernels.information_update(np.linalg.inv(P_prior), z_prior, z_at, e, H, z, posterior, P)
    innovation, W = e + H @ (z_prior - z_at), H @ P_prior @ H.T + np.eye(20)
    K = P_prior @ H.T @ np.linalg.inv(W)
    np.testing.assert_allclose(z, z_prior - K @ innovation, rtol=1e-9)
    np.testing.assert_allclose(P, P_prior - K @ H @ P_prior, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(posterior @ P, np.eye(5), atol=1e-9)
    assert nis == pytest.approx(innovation @ np.linalg.solve(W, innovation), rel=1e-9)


def test_a_missing_centroid_makes_every_row_of_its_exposure_missing():
    frame = _frame(7)
    frame[3][0] = np.nan
    for reference in (SingularValues(Selection(), FREE, SCALE), AllPairs(FREE, SCALE)):
        reference.whiten(*frame[:3])
        assert np.isnan(reference.rows(*frame[3:])[0]).any()


#: Space for exposures of forty detections, eight parameters and fifty guide stars.
WORK = loops.scratch(40, 11, 50)

# Wahba.


@pytest.mark.full
@settings(max_examples=effort(12, 60))
@given(seed=st.integers(0, 2**32), n=st.integers(2, 14), noise=st.sampled_from([0.0, 1e-5, 1e-3]))
def test_newton_steps_from_a_triad_reach_the_rotation_of_the_singular_values(seed, n, noise):
    rng = np.random.default_rng(seed)
    field = Exposure(rng, n)
    s = field.s + noise * rng.normal(size=(n, 3))
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    sigma = SIGMA * rng.uniform(0.5, 2, n)
    c, C = field.stars(), np.empty((3, 3))
    assert loops._wahba(s, c, 1 / sigma**2, np.ones(n, np.bool_), C, WORK)
    # what a nearly flat cost leaves open is bounded by the weakest axis; the rest is rounding
    plain = wahba(s, c, sigma)
    weakest = np.sqrt(np.linalg.eigvalsh(plain.covariance)[-1]) / SIGMA
    np.testing.assert_allclose(C, plain.C, atol=1e-12 * max(1.0, weakest))
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-14)


def test_stars_that_are_not_used_do_not_pull_and_one_star_gives_no_attitude():
    field, C = Exposure(np.random.default_rng(1), 8), np.empty((3, 3))
    c = field.stars()
    c[3] = -c[3]
    loops._wahba(field.s, c, 1 / field.sigma**2, np.arange(8) != 3, C, WORK)
    np.testing.assert_allclose(C, field.C, atol=1e-12)
    s = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, np.sqrt(0.99)]])
    assert not loops._wahba(s, s.copy(), np.full(2, 1e8), np.array([True, False]), np.empty((3, 3)), WORK)


@pytest.mark.parametrize("apart", [0.0, 1e-4])
def test_stars_in_one_direction_give_no_attitude(apart):
    s = np.array([[0.0, 0.0, 1.0], [apart, 0.0, np.sqrt(1 - apart**2)]])
    assert not loops._wahba(s, s.copy(), np.full(2, 1e8), np.ones(2, np.bool_), np.empty((3, 3)), WORK)


# Apparent places.

NO_AIR = np.zeros(5)


@pytest.mark.few(2)
@pytest.mark.parametrize("date", ["1991-04-02T13:30", "2018-07-20", "2026-11-21T06:00", "2049-02-01"])
def test_the_short_form_of_apparent_place_agrees_with_the_standard_one(date):
    catalogue = load_catalogue(None)
    stars = guide_stars(catalogue, 15.0, 0.0)
    time, velocity = np.array([np.datetime64(date, "us")]), np.array([[3100.0, -6500.0, 2300.0]])
    motion, c = observer_motion(time, velocity), np.empty((len(stars.hip), 3))
    for j in range(len(stars.hip)):
        loops._apparent(
            stars.place, stars.motion, stars.parallax_rad, j,
            motion.years[0], motion.earth_au[0], motion.beta[0], NO_AIR, c[j],
        )  # fmt: skip
    n = len(stars.hip)
    standard = apparent_directions(
        catalogue, catalogue.find_index(stars.hip), np.repeat(time, n), np.repeat(velocity, n, 0)
    )
    assert np.linalg.norm(c - standard, axis=1).max() < 1e-9


def test_the_stars_of_a_cone_are_found_at_the_poles_too():
    stars = guide_stars(load_catalogue(None), 6.0, 0.0)
    motion = observer_motion(np.array([np.datetime64("2026-01-01", "us")]), None)
    for axis in ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.0, 0.999, -np.sqrt(1 - 0.999**2)]):
        star, c = np.empty(len(stars.hip), np.int64), np.empty((len(stars.hip), 3))
        m = loops._candidates(
            np.array(axis), 0.3, stars.place, stars.motion, stars.parallax_rad,
            motion.years[0], motion.earth_au[0], motion.beta[0], NO_AIR, star, c,
        )  # fmt: skip
        assert set(star[:m]) == set(np.flatnonzero(stars.place @ axis > np.cos(0.3)))


# Rows and eliminations.


def test_the_rows_are_the_derivatives_of_the_true_residual():
    field = Exposure(np.random.default_rng(2), 6)
    r = np.empty(2)

    def residuals(y):
        c = field.stars(y)
        rows = np.empty((6, 2))
        for i in range(6):
            loops._residual(field.s[i], field.T[i], field.C, c[i], r)
            rows[i] = r
        return rows

    for place, step in enumerate([1e-6] * 3 + [1e-3] * 8):
        y = step * np.eye(11)[place]
        slope = (residuals(y) - residuals(-y)) / (2 * step)
        np.testing.assert_allclose(field.A[:, :, place], slope, atol=2e-5 * np.abs(field.A[:, :, place]).max())


def test_tangent_vectors_are_a_right_handed_triad_with_their_star():
    field = Exposure(np.random.default_rng(3))
    np.testing.assert_allclose(np.cross(field.T[:, 0], field.T[:, 1]), field.s, atol=1e-14)
    np.testing.assert_allclose(field.T @ field.T.transpose(0, 2, 1), np.broadcast_to(np.eye(2), (12, 2, 2)), atol=1e-14)


@given(seed=st.integers(0, 2**32))
@settings(max_examples=20)
def test_what_stars_say_of_the_parameters_is_the_schur_complement(seed):
    rng = np.random.default_rng(seed)
    field = Exposure(rng, 7)
    Lambda, eta = field.information(np.ones(7, np.bool_), rng.normal(size=11) * ([1e-3] * 3 + [1] * 8))
    M, m, L = np.empty((8, 8)), np.empty(8), np.empty((11, 11))
    loops._marginal(np.tril(Lambda), eta, 11, L, M, m, WORK)
    a, b, c = Lambda[:3, :3], Lambda[3:, :3], Lambda[3:, 3:]
    np.testing.assert_allclose(M, c - b @ np.linalg.solve(a, b.T), rtol=1e-7, atol=1e-10 * np.abs(c).max())
    np.testing.assert_allclose(m, eta[3:] - b @ np.linalg.solve(a, eta[:3]), rtol=1e-6, atol=1e-10 * np.abs(eta).max())


def test_a_star_taken_into_the_information_and_out_again_leaves_it_as_it_was():
    field = Exposure(np.random.default_rng(4))
    Lambda, eta = field.information(np.arange(12) < 6)
    again, eta_again = np.tril(Lambda), eta.copy()
    loops._add(again, eta_again, field.A[7], 1e-4, -2e-4, 3e8, 11)
    with_it = again.copy()
    loops._add(again, eta_again, field.A[7], 1e-4, -2e-4, -3e8, 11)
    np.testing.assert_allclose(with_it, np.tril(Lambda + 3e8 * field.A[7].T @ field.A[7]), atol=1e-12 * with_it.max())
    np.testing.assert_allclose(again, np.tril(Lambda), atol=1e-12 * with_it.max())
    np.testing.assert_allclose(eta_again, eta, atol=1e-10)


# Directions that the file gives itself.


def sky_patch(rng, n=24):
    s = np.column_stack([rng.uniform(-0.09, 0.09, (n, 2)), np.ones(n)]) @ Rotation.random(rng=rng).as_matrix()
    return s / np.linalg.norm(s, axis=1, keepdims=True)


def refracted(s, zenith, strength=3e-4):
    up = zenith - (s @ zenith)[:, None] * s
    lifted = s + strength * up / (s @ zenith)[:, None]
    return lifted / np.linalg.norm(lifted, axis=1, keepdims=True)


@pytest.mark.parametrize("named", [6, 12])
def test_refraction_is_carried_from_named_stars_to_the_others(named):
    rng = np.random.default_rng(named)
    c = sky_patch(rng)
    aside = np.cross(c[0], c[5])
    shifted = refracted(c, (c[0] + aside / np.linalg.norm(aside)) / np.sqrt(2))
    twin = np.where(np.arange(24) < named, np.arange(24), -1)
    moved = c.copy()
    assert loops._affine(24, moved, shifted, twin, twin >= 0, SIGMA, WORK)
    assert np.linalg.norm(c - shifted, axis=1).min() > 1e-4
    assert np.linalg.norm(moved - shifted, axis=1).max() < 0.2 * SIGMA


def test_shifts_that_no_affine_map_explains_are_refused():
    rng = np.random.default_rng(5)
    c = sky_patch(rng)
    scattered = c + 5 * SIGMA * rng.normal(size=c.shape)
    assert not loops._affine(24, c.copy(), scattered, np.arange(24), np.ones(24, np.bool_), SIGMA, WORK)


def off_by(field, i, V, sigmas, turn):
    delta = sigmas * np.linalg.cholesky(V) @ [np.cos(turn), np.sin(turn)]
    c = (field.s[i] - delta @ field.T[i]) @ field.C
    return c / np.linalg.norm(c)


@pytest.mark.parametrize("y", [np.zeros(11), np.r_[2e-4, -1e-4, 3e-4, np.full(8, 0.5)]], ids=["as believed", "off"])
@pytest.mark.parametrize("i", [3, 9])
def test_a_star_is_taken_inside_the_gate_of_the_conditioned_gaussian_and_not_outside(i, y):
    field = Exposure(np.random.default_rng(i))
    use = np.arange(12) != i
    Lambda, eta = field.information(use, y)
    predicted = field.A[i] @ np.linalg.solve(Lambda, eta)
    V = field.A[i] @ np.linalg.solve(Lambda, field.A[i].T)
    V += (SIGMA**2 + loops._CURVATURE**2 * predicted @ predicted) * np.eye(2)
    for turn in np.linspace(0, 2 * np.pi, 7):
        for sigmas, expected in ((0.99 * GATE, loops.MATCHED), (1.01 * GATE, loops.NO_STAR)):
            c = off_by(field, i, V, sigmas, turn) - predicted @ field.T[i] @ field.C
            used, chosen, reason = use.copy(), np.zeros(12, np.int64), np.zeros(12, np.int64)
            loops._grow(
                field.s, field.T, field.A, field.sigma, field.C, 1, c[None], np.empty((1, 3)), np.zeros(1, np.bool_),
                0.0, GATE, np.tril(Lambda), eta.copy(), used, chosen, reason, np.zeros((11, 11)), np.empty(11), WORK,
            )  # fmt: skip
            assert reason[i] == expected
            assert used[i] == (expected == loops.MATCHED)


def pruned(field, c, named, use):
    r, Lambda, eta = np.empty(2), np.diag([loops._DIFFUSE] * 3 + [1.0] * 8), np.zeros(11)
    for i in np.flatnonzero(use):
        loops._residual(field.s[i], field.T[i], field.C, c[i], r)
        loops._add(Lambda, eta, field.A[i], *r, 1 / loops._variance(SIGMA, *r), 11)
    kept, reason, tolerance = use.copy(), np.zeros(12, np.int64), np.full(12, np.nan)
    loops._prune(
        field.s, field.T, field.A, field.sigma, field.C, c, named, GATE, Lambda, eta, kept, reason, tolerance,
        np.zeros((11, 11)), np.empty(11), WORK,
    )  # fmt: skip
    return kept, tolerance


@pytest.mark.parametrize("named", [False, True])
def test_a_star_is_dropped_where_the_others_predict_it_elsewhere_and_believed_with_more_noise_where_named(named):
    field = Exposure(np.random.default_rng(8))
    i, others = 4, np.arange(12) != 4
    own = (SIGMA * loops._GIVEN_NOISE if named else SIGMA) ** 2
    Lambda, _ = field.information(others)
    spread = field.A[i] @ np.linalg.solve(Lambda, field.A[i].T)
    for turn in np.linspace(0, 2 * np.pi, 5):
        for share, stays in ((0.98, True), (1.02, False)):
            c, V = field.stars(), spread + own * np.eye(2)
            for _ in range(20):  # the curvature's part grows with the distance itself
                c[i] = off_by(field, i, V, share * GATE, turn)
                r = field.T[i] @ (field.s[i] - field.C @ c[i])
                V = spread + (own + loops._CURVATURE**2 * r @ r) * np.eye(2)
            kept, _ = pruned(field, c, np.full(12, named), np.ones(12, np.bool_))
            assert kept[i] == stays
            assert kept[others].all()
    axes = GATE * np.sqrt(np.linalg.eigvalsh(spread + SIGMA**2 * np.eye(2)))
    kept, tolerance = pruned(field, field.stars(), np.full(12, named), np.ones(12, np.bool_))
    assert axes[0] <= tolerance[i] <= axes[1]


@given(seed=st.integers(0, 2**32), parameters=st.booleans(), share=st.sampled_from([-1.02, -0.98, 0.98, 1.02]))
def test_arcs_agree_within_the_gate_of_their_own_variance(seed, parameters, share):
    rng = np.random.default_rng(seed)
    field = Exposure(rng, 2, spread=rng.choice([0.1, 1.0]))
    s, G = field.s, field.G if parameters else np.zeros((2, 3, 0))
    phi = np.arctan2(np.linalg.norm(np.cross(*s)), s[0] @ s[1])
    slope = -(s[1] @ G[0] + s[0] @ G[1]) / np.sin(phi)
    allowed = GATE * np.sqrt(2 * SIGMA**2 + slope @ slope)
    if allowed > 0.1 * phi:
        return  # the arc is too short for a first-order answer
    axis = np.cross(*s) / np.linalg.norm(np.cross(*s))
    c = np.array([s[0], Rotation.from_rotvec(share * allowed * axis).apply(s[1])]) @ field.C
    answers = [loops._arcs_agree(s, G, field.sigma, 0, 1, c, 0, 1, GATE, widest) for widest in (np.inf, 1e-9)]
    assert answers == [abs(share) < 1, False]


def test_two_detections_in_one_place_have_no_arc():
    s = np.array([[0.0, 0.0, 1.0]] * 2)
    assert not loops._arcs_agree(s, np.zeros((2, 3, 0)), np.ones(2), 0, 1, s, 0, 1, GATE, np.inf)


# Attitude covariance.


@pytest.mark.full
@pytest.mark.parametrize("n", [4, 12])
def test_the_attitude_covariance_is_that_of_many_draws_of_noise_and_parameters(n):
    rng = np.random.default_rng(n)
    field, covariance, draws = Exposure(rng, n), np.empty((3, 3)), 3000
    loops._attitude_covariance(field.A, field.sigma, np.ones(n, np.bool_), covariance, WORK)
    true = np.stack([field.stars(np.r_[np.zeros(3), w]) for w in 0.2 * rng.normal(size=(draws, 8))])
    noise = 0.2 * SIGMA * rng.normal(size=(draws, n, 2))
    seen = field.s + np.einsum("dnr,nra->dna", noise, field.T)
    found = attitudes(np.arange(draws + 1) * n, seen.reshape(-1, 3), true.reshape(-1, 3), np.full(draws * n, SIGMA))
    theta = rotation_vector(Rotation.from_matrix(found.C @ field.C.T).as_quat())
    root = np.linalg.inv(np.linalg.cholesky(0.04 * covariance))
    np.testing.assert_allclose(root @ np.cov(theta.T) @ root.T, np.eye(3), atol=0.12)
