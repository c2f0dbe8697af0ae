"""The gates of matching against the dense Gaussian they stand for: growth, pruning, arcs, attitude covariance by many draws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from boresight.estimation.attitude import attitudes, rotation_vector
from boresight.kernels import matching as loops
from tests.exposures import GATE, SIGMA, Exposure

#: Space for exposures of forty detections, eight parameters and fifty guide stars.
WORK = loops.scratch(40, 11, 50)


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
