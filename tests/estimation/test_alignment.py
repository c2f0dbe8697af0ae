"""The rotation between two frames: its derivative, the dense problem it stands for, and whether its covariance is right."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest, chi2

from boresight.estimation.alignment import (
    AttitudeSeries,
    PairingRule,
    Term,
    carry,
    estimate,
    find_start,
    fit,
    inverse_left_jacobian,
    left_jacobian,
    make_pairs,
    make_variation,
    residuals,
    skew,
)
from tests.effort import effort, few_of

ARCSEC = np.radians(1 / 3600)
#: One sigma about x, y and z of a tracker, and of its camera's parameters.
OWN, SHARED = np.array([4.0, 4.0, 25.0]) * ARCSEC, np.array([3.0, 2.0, 6.0]) * ARCSEC
TURN = np.radians([35.0, -70.0, 110.0])
TEMPERATURE, TIME = Term("temperature", 1), Term("time", 1)


def covariances(rng, n, sigma):
    """Covariances that differ from exposure to exposure, their axes too."""
    Q = Rotation.from_rotvec(0.2 * rng.normal(size=(n, 3))).as_matrix()
    scale = sigma * rng.uniform(0.6, 1.8, (n, 3))
    return Q @ (scale[:, :, None] ** 2 * np.swapaxes(Q, 1, 2))


class Body:
    """A body that turns, and two frames on it that measure their attitudes."""

    def __init__(self, rng, n=60, offset_s=0.0, step_s=2.0, slope=None, drift=None, rate=0.001, per_pass=1e-5,
                 wobble=0.0, late_s=0.0):  # fmt: skip
        self.rng, self.rate, self.wobble = rng, rate, wobble
        t = step_s * np.arange(n)
        self.axis = Rotation.random(rng=rng).as_matrix()[0]
        self.first = Rotation.random(rng=rng)
        self.warmth = 10.0 * np.sin(2 * np.pi * t / t[-1])
        phi = np.zeros((n, 3))
        if slope is not None:
            phi = phi + self.warmth[:, None] * slope
        if drift is not None:
            phi = phi + ((t - (t[0] + t[-1]) / 2) / 86_400)[:, None] * drift
        self.M = Rotation.from_rotvec(TURN)
        self.a = self.series(t, OWN, SHARED, per_pass, Rotation.identity())
        self.b = self.series(t + offset_s, 1.5 * OWN, 0.7 * SHARED, per_pass, Rotation.from_rotvec(phi) * self.M)
        self.b = replace(self.b, time_s=self.b.time_s + late_s)

    def series(self, t, own, shared, spread, mounting):
        rng, n = self.rng, len(t)
        P, u = covariances(rng, n, own), rng.normal(size=3)
        self.common = [*getattr(self, "common", []), shared * u]
        G = np.diag(shared) + spread * 0.2 * rng.normal(size=(n, 3, 3))
        turned = self.rate * t + self.wobble * np.sin(2 * np.pi * t / 40.0)
        true = mounting * Rotation.from_rotvec(turned[:, None] * self.axis) * self.first
        error = np.einsum("nij,nj->ni", np.linalg.cholesky(P), rng.normal(size=(n, 3))) + G @ u
        C = (Rotation.from_rotvec(error) * true).as_matrix()
        return AttitudeSeries(t, C, P, G, 20.0 + self.warmth if len(t) == len(self.warmth) else np.full(n, np.nan))

    def pairs(self, rule=None):
        return make_pairs(self.a, self.b, rule or PairingRule())

    def estimate(self, **choices):
        pairs = self.pairs()
        return pairs, estimate(pairs, make_variation(pairs, pairs.temperature_c[:, 0], 20.0), **choices)

    def error(self, found):
        return Rotation.from_matrix(found.fit.M @ self.M.as_matrix().T).as_rotvec()


def complex_log(C):
    """Rotation vector of a complex matrix near a rotation by less than half a turn, analytically."""
    v = np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]]) / 2
    sine, cosine = np.sqrt(v @ v), (np.trace(C) - 1) / 2
    return v * 2 * np.arctan(sine / (1 + cosine)) / sine


def test_the_derivative_of_the_residuals_is_the_complex_step():
    rng = np.random.default_rng(1)
    pairs = Body(rng, n=5).pairs()
    M_0 = Rotation.from_rotvec([0.3, 0.2, -0.4]).as_matrix() @ pairs.M[0]
    basis, beta = np.column_stack([np.ones(5), rng.normal(size=5)]), 0.2 * rng.normal(size=(2, 3))
    _, E = residuals(pairs, basis, M_0, beta)
    h = 1e-30
    for column in range(6):
        moved = beta.astype(complex)
        moved.ravel()[column] += 1j * h
        for k in range(5):
            D = expm(skew(basis[k] @ moved)) @ M_0
            slope = complex_log(pairs.M[k] @ D.T).imag / h
            np.testing.assert_allclose(-E[k, :, column], slope, atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.3, 3.0])
def test_jacobians_of_rotations_are_inverse_to_each_other_and_the_complex_step(size):
    v = size * np.array([0.6, -0.64, 0.48])
    np.testing.assert_allclose(left_jacobian(v) @ inverse_left_jacobian(v), np.eye(3), atol=1e-12)
    for column, direction in enumerate(np.eye(3)):
        dC = expm(skew(v + 1e-30j * direction)).imag / 1e-30
        np.testing.assert_allclose(dC @ expm(skew(v)).T, skew(left_jacobian(v)[:, column]), atol=1e-12)


def test_an_interpolated_attitude_errs_as_its_neighbours_do():
    rng = np.random.default_rng(2)
    series = Body(rng, n=2, step_s=3.0, rate=0.4).a
    h = 1e-7
    for at in (1.2, 3.3, -0.4):
        now = carry(series, np.array([at]), PairingRule())
        assert now.known[0]
        for which in range(2):
            for axis in range(3):
                C = series.C.copy()
                C[which] = Rotation.from_rotvec(h * np.eye(3)[axis]).as_matrix() @ C[which]
                moved = carry(replace(series, C=C), np.array([at]), PairingRule())
                slope = Rotation.from_matrix(moved.C[0] @ now.C[0].T).as_rotvec() / h
                np.testing.assert_allclose(slope, now.W[0, which, :, axis], atol=1e-6)


@pytest.mark.parametrize("offset_s", [0.0, 0.7])
def test_it_is_the_dense_least_squares_over_all_attitudes_rotation_and_cameras(offset_s):
    """At the solution the stacked problem takes no step, and has the same covariance."""
    rng = np.random.default_rng(3)
    body = Body(rng, n=25, offset_s=offset_s, slope=2 * ARCSEC * np.ones(3))
    pairs = body.pairs()
    terms = (TEMPERATURE,)
    variation = make_variation(pairs, pairs.temperature_c[:, 0], 20.0)
    found = fit(pairs, np.ones(len(pairs), np.bool_), variation, terms, find_start(pairs))
    # unknowns: an error of every measured attitude in its sigmas, the six angles in arcsec, the two cameras
    n_a, n_b, p = len(body.a), len(body.b), 6
    own = 3 * (n_a + n_b)
    C, right = np.zeros((3 * len(pairs), own + 6 + p)), np.zeros(3 * len(pairs))
    basis = variation.basis(terms)
    r, _ = residuals(pairs, basis, found.M, found.beta)
    for first, one, turns in ((0, body.a, -pairs.M), (n_a, body.b, np.broadcast_to(np.eye(3), pairs.M.shape))):
        L, carried = np.linalg.cholesky(one.covariance), carry(one, pairs.time_s, PairingRule())
        for k in range(len(pairs)):
            for place, W in zip(carried.place[k], carried.W[k], strict=True):
                C[3 * k : 3 * k + 3, 3 * (first + place) : 3 * (first + place) + 3] += turns[k] @ W @ L[place]
    for k in range(len(pairs)):
        rows = slice(3 * k, 3 * k + 3)
        slope = inverse_left_jacobian(-r[k]) @ left_jacobian(basis[k] @ found.beta)
        C[rows, own : own + 6] = ARCSEC * np.hstack([slope, basis[k, 1] * slope])
        C[rows, own + 6 :] = pairs.G[k]
    right[:] = r.ravel()
    # least errors and least parameters under the constraint that every pair holds: by the null space of the constraint
    scaled = 1 / np.sqrt(np.mean(right**2))
    Q, upper = np.linalg.qr(scaled * C.T, mode="complete")
    held = len(right)
    known = Q[:, :held] @ np.linalg.solve(upper[:held].T, scaled * right)
    N, weight = Q[:, held:], np.diag(np.r_[np.ones(own), np.zeros(6), np.ones(p)])
    J = weight @ N
    y = np.linalg.lstsq(J, -weight @ known, rcond=None)[0]
    half = N @ np.linalg.pinv(J)
    P = (half @ half.T)[own : own + 6, own : own + 6] * ARCSEC**2
    step = (known + N @ y)[own : own + 6] * ARCSEC
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.abs(step / sigma).max() < 1e-9
    np.testing.assert_allclose(P / np.outer(sigma, sigma), found.covariance / np.outer(sigma, sigma), atol=1e-9)
    least = known + N @ y
    assert found.chi2 == pytest.approx(np.sum((weight @ least) ** 2), rel=1e-9)


@pytest.mark.full
def test_outliers_are_named_and_a_sound_set_loses_next_to_none():
    """30 of 100 pairs wrong by a degree or by twenty sigmas are left out, and no other."""
    rng = np.random.default_rng(4)
    body = Body(rng, n=100)
    wrong = np.sort(rng.permutation(100)[:30])
    away = (
        np.where(np.arange(30)[:, None] % 2, np.radians(1.0), 20 * 25 * ARCSEC)
        * Rotation.random(30, rng=rng).as_matrix()[:, 0]
    )
    C = body.b.C.copy()
    C[wrong] = Rotation.from_rotvec(away).as_matrix() @ C[wrong]
    body.b = replace(body.b, C=C)
    _, found = body.estimate()
    np.testing.assert_array_equal(np.flatnonzero(~found.keep), wrong)
    assert found.probability[wrong].max() < 1e-4
    error = body.error(found)
    assert chi2.sf(error @ np.linalg.solve(found.fit.covariance[:3, :3], error), 3) > 0.001
    lost = sum(int((~Body(np.random.default_rng(seed), n=40).estimate()[1].keep).sum()) for seed in range(40))
    assert lost <= 3  # of 1,600, at one set in a hundred


def run(seed, **choices):
    body = Body(np.random.default_rng(seed), **choices)
    pairs, found = body.estimate()
    return body, pairs, found


def assert_chi_square(values, dof):
    """The sum of so many values of chi-square lies within its 99.9 % interval."""
    low, high = chi2.ppf([0.0005, 0.9995], dof * len(values))
    assert low < sum(values) < high, (
        sum(values) / dof / len(values),
        low / dof / len(values),
        high / dof / len(values),
    )


@pytest.mark.full
@pytest.mark.parametrize(
    "choices",
    few_of(
        [{}, {"offset_s": 0.7}, {"offset_s": 0.7, "per_pass": 3e-4}, {"slope": np.array([3.0, -2.0, 1.0]) * ARCSEC}], 1
    ),
    ids=["same times", "interpolated", "cameras that err otherwise in every frame", "temperature"],
)
def test_its_covariance_is_right_on_two_hundred_sets(choices):
    """NEES of the angles and chi-square of the pairs; one and two sigma hold as often as they should."""
    rounds = effort(60, 200)
    nees, nis, dof, inside = [], [], [], np.zeros((2, 3), int)
    for seed in range(rounds):
        body, _, found = run(seed, n=40, **choices)
        error, P = body.error(found), found.fit.covariance[:3, :3]
        nees.append(error @ np.linalg.solve(P, error))
        nis.append(found.fit.chi2)
        dof.append(found.fit.dof)
        inside += np.abs(error) < np.outer([1, 2], np.sqrt(np.diag(P)))
    assert_chi_square(nees, 3)
    low, high = chi2.ppf([0.0005, 0.9995], sum(dof))
    assert low < sum(nis) < high
    for hits, share in zip(inside, (0.6827, 0.9545), strict=True):
        for count in hits:
            assert binomtest(int(count), rounds, share).pvalue > 0.001


def test_the_rotation_to_load_is_that_between_the_reported_attitudes():
    """Its errors are chi-square with the cameras' error on board, where each exposure feels that error a little otherwise."""
    nees, of_frames = [], []
    for seed in range(effort(50, 150)):
        body, _, found = run(seed, n=40, per_pass=3e-5)
        M = body.M.as_matrix()
        reported = Rotation.from_rotvec(body.common[1] - M @ body.common[0]).as_matrix() @ M
        loaded = Rotation.from_rotvec(found.fit.load[0]).as_matrix() @ found.fit.M
        error = Rotation.from_matrix(loaded @ reported.T).as_rotvec()
        nees.append(error @ np.linalg.solve(found.fit.covariance_to_load[:3, :3], error))
        wrong = Rotation.from_matrix(found.fit.M @ reported.T).as_rotvec()
        of_frames.append(wrong @ np.linalg.solve(found.fit.covariance_to_load[:3, :3], wrong))
    assert_chi_square(nees, 3)
    assert np.mean(of_frames) > np.mean(nees)


@pytest.mark.full
def test_what_the_cameras_share_does_not_average_down():
    """With four hundred pairs the sigma stays that of the cameras; without it the errors are several sigmas."""
    naive = []
    for seed in range(effort(8, 25)):
        body, _, found = run(seed, n=400)
        floor = np.sqrt(np.diag(found.fit.covariance - found.fit.covariance_of_noise))[:3]
        assert (np.sqrt(np.diag(found.fit.covariance))[:3] < 1.1 * floor).all()
        error = body.error(found)
        naive.append(error @ np.linalg.solve(found.fit.covariance_of_noise[:3, :3], error))
    assert np.mean(naive) > 30  # of 3


def test_taking_neighbouring_pairs_for_independent_claims_too_little():
    """Halfway between attitudes of one quality the variance is twice what pairs without their links say."""
    body = Body(np.random.default_rng(8), n=60, offset_s=1.0)
    alike = np.broadcast_to(np.diag(OWN**2), body.b.covariance.shape)
    body.a = replace(body.a, covariance=1e-3 * alike, shared=0 * body.a.shared)
    body.b = replace(body.b, covariance=alike, shared=0 * body.b.shared)
    pairs = body.pairs()
    assert len(pairs.links) >= len(pairs) - 2
    variation, all_of_them = make_variation(pairs, pairs.temperature_c[:, 0]), np.ones(len(pairs), np.bool_)
    linked, alone = (
        fit(one, all_of_them, variation, (), pairs.M[0]).covariance for one in (pairs, replace(pairs, links={}))
    )
    np.testing.assert_allclose(np.diag(linked) / np.diag(alone), 2.0, rtol=0.1)


@pytest.mark.full
@pytest.mark.full
@pytest.mark.parametrize("late_s", [0.0, 0.3])
def test_clocks_that_differ_are_told_with_their_sigma_where_the_rate_changes(late_s):
    """The body nods by a degree every 40 s; standard scores of the offset are normal, with a delay and without."""
    found = [run(seed, n=60, offset_s=0.2, wobble=0.02, late_s=late_s)[2].clock for seed in range(effort(20, 100))]
    scores = np.array([(one.offset_s - late_s) / one.sigma_s for one in found])
    assert_chi_square((scores**2).tolist(), 1)
    assert all(one.sigma_s < 0.05 for one in found)
    assert np.mean([one.needed for one in found]) == (1.0 if late_s else pytest.approx(0.0, abs=0.1))


def test_a_steady_turn_tells_no_clock_and_says_how_fast_it_was():
    """0.3 s of 206 arcsec/s are 62 arcsec of the rotation, and no pair is off by any of it."""
    body, _, found = run(3, n=100, late_s=0.3)
    assert np.abs(body.error(found)).max() > 8 * np.sqrt(np.diag(found.fit.covariance)[:3]).min()
    assert found.clock.needed is False
    assert found.clock.sigma_s > 0.1
    assert found.clock.steady_rad_s == pytest.approx(0.001, rel=0.05)


def test_a_slope_over_temperature_is_found_and_recovered_and_none_is_invented():
    """On as many sets as are tried: bias below 0.2 sigma, intervals of 68 and 95 %, false alarms at their rate."""
    slope, rounds = np.array([1.0, -0.6, 2.0]) * ARCSEC, effort(40, 100)
    z, invented = [], 0
    for seed in range(rounds):
        _, _, found = run(seed, n=50, slope=slope)
        assert TEMPERATURE in found.fit.terms
        at = found.fit.terms.index(TEMPERATURE) + 1
        sigma = np.sqrt(np.diag(found.fit.covariance))[3 * at : 3 * at + 3]
        z.append((found.fit.beta[at] - slope) / sigma)
        invented += bool(run(1000 + seed, n=50)[2].fit.terms)
    assert np.abs(np.mean(z, axis=0)).max() < 3.3 / np.sqrt(
        rounds
    )  # three means of so many, each with its chance of error of one in a thousand
    for limit, share in ((1, 0.6827), (1.96, 0.95)):
        assert binomtest(int((np.abs(z) < limit).sum()), 3 * rounds, share).pvalue > 0.001
    assert binomtest(invented, rounds, 0.01).pvalue > 0.001


@pytest.mark.full
def test_a_drift_a_day_is_found_where_temperature_does_not_explain_it():
    drift = np.array([3000.0, 0.0, -9000.0]) * ARCSEC
    for seed in range(10):
        _, _, found = run(seed, n=80, step_s=100.0, drift=drift)
        assert found.fit.terms == (TIME,)
        error = found.fit.beta[1] - drift
        assert chi2.sf(error @ np.linalg.solve(found.fit.covariance[3:6, 3:6], error), 3) > 1e-4


def test_pairs_that_scatter_more_than_they_say_widen_the_covariance():
    rng = np.random.default_rng(6)
    body = Body(rng, n=200)
    body.a, body.b = (replace(one, covariance=one.covariance / 9) for one in (body.a, body.b))
    _, found = body.estimate()
    assert 7 < found.fit.ratio < 11
    assert found.keep.mean() > 0.97
    extra = found.fit.covariance_with_misfit - found.fit.covariance
    np.testing.assert_allclose(extra, (found.fit.ratio - 1) * found.fit.covariance_of_noise)


def test_an_attitude_with_no_neighbour_counts_as_little_as_its_rate_is_known():
    rng = np.random.default_rng(7)
    body = Body(rng, n=20, step_s=40.0, offset_s=0.25, rate=0.0)
    pairs = body.pairs()
    assert len(pairs) == 20
    np.testing.assert_allclose(pairs.offset_s, 0.25)
    expected = (np.radians(0.1) * 0.25) ** 2
    bare = body.pairs(PairingRule(rate_sigma=0.0))
    np.testing.assert_allclose(pairs.R - bare.R, np.broadcast_to(expected * np.eye(3), bare.R.shape), atol=1e-18)
    assert len(body.pairs(PairingRule(tolerance_s=0.1))) == 0
