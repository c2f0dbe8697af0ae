"""What the passes show of change: false terms as often as the level says, dates inside their intervals, bounds of a maximum."""

import numpy as np
import pytest
from scipy import stats

from boresight.estimation.batch import NormalEquations
from boresight.estimation.block_bordered import Regressed
from boresight.estimation.change import LEVEL, Equations, _both_beyond, drop_powers, step_falls
from tests.effort import effort

N, OWN, ROWS = 4, np.array([0, 2]), 12


def drawn(rng, z):
    """Passes at z (n_passes, N): their normal equations, taken at zero, and the rows."""
    H = rng.normal(size=(len(z), ROWS, N))
    e = rng.normal(size=(len(z), ROWS)) - np.einsum("kri,ki->kr", H, z)
    return [NormalEquations(h.T @ h, h.T @ r, float(r @ r), 0.0) for h, r in zip(H, e, strict=True)], H, e


def polynomials(t, highest=3):
    power = np.tile(np.arange(1, highest + 1), len(OWN))
    return Regressed(np.repeat(OWN, highest), t[:, None] ** power), power


def degrees(sums, t):
    link, power = polynomials(t)
    found = link.solve(sums, np.zeros((len(t), N)))
    kept = drop_powers(found.slope, found.slope_covariance, link.of, power, 1.0)
    return [int(kept[link.of == place].sum()) for place in OWN]


@pytest.mark.full
@pytest.mark.parametrize("truth", [(0, 0), (1, 0), (2, 1), (3, 0)], ids=str)
def test_a_degree_is_too_high_as_rarely_as_the_level_says(truth):
    sets, wrong, right = effort(400, 4000), 0, 0
    for seed in range(sets):
        rng = np.random.default_rng([1, seed])
        t = rng.uniform(-1.0, 1.0, 25)
        z = np.tile(rng.normal(size=N), (25, 1))
        for place, degree in zip(OWN, truth, strict=True):
            z[:, place] += sum(2.0 * t**power for power in range(1, degree + 1))
        found = degrees(drawn(rng, z)[0], t)
        wrong += any(one > wanted for one, wanted in zip(found, truth, strict=True))
        right += tuple(found) == truth
    assert wrong / sets < LEVEL + 3.0 * np.sqrt(LEVEL / sets)
    assert right / sets > 0.8  # a cubic of this size is hard to see


def test_coefficients_have_no_bias_and_lie_in_their_intervals_as_often_as_they_say():
    sets, errors = effort(100, 400), []
    truth = np.array([0.8, -0.5, 0.3])
    for seed in range(sets):
        rng = np.random.default_rng([2, seed])
        t = rng.uniform(-1.0, 1.0, 20)
        z = np.zeros((20, N))
        z[:, 0] = np.column_stack([t, t**2, t**3]) @ truth
        link = Regressed(np.zeros(3, np.int64), t[:, None] ** np.arange(1, 4))
        found = link.solve(drawn(rng, z)[0], np.zeros((20, N)))
        errors.append((found.slope - truth) / np.sqrt(np.diag(found.slope_covariance)))
    errors = np.array(errors)
    assert np.abs(errors.mean(axis=0)).max() < 3.0 / np.sqrt(sets)
    for width, share in ((1.0, 0.683), (1.96, 0.95)):
        inside = np.mean(np.abs(errors) < width)
        assert inside == pytest.approx(share, abs=3.0 * np.sqrt(share * (1 - share) / sets))


def test_a_fall_is_that_of_dense_least_squares_with_the_step_and_without():
    rng, K = np.random.default_rng(3), 7
    z = rng.normal(size=(K, N))
    sums, H, e = drawn(rng, z)
    taken = rng.normal(size=(K, N))  # the sums may be taken anywhere
    moved = e + np.einsum("kri,ki->kr", H, taken)
    there = [NormalEquations(h.T @ h, h.T @ r, float(r @ r), 0.0) for h, r in zip(H, moved, strict=True)]
    link = Regressed(np.array([2]), (np.arange(K) > 1).astype(float)[:, None])
    falls = step_falls(Equations.of(there, taken), link.design(N), 0)

    def chi2(design):
        J = np.concatenate([h @ b for h, b in zip(H, design, strict=True)])
        return float(np.linalg.lstsq(J, -e.ravel(), rcond=None)[1][0])

    for gap in range(K - 1):
        more = Regressed(np.array([2, 0]), np.column_stack([link.values, np.arange(K) > gap]))
        assert falls.fall[gap] == pytest.approx(chi2(link.design(N)) - chi2(more.design(N)), rel=1e-8, abs=1e-9)
        assert falls.step[gap] == pytest.approx(more.solve(sums, np.zeros((K, N))).slope[1], rel=1e-8)


@pytest.mark.parametrize("rho", [0.0, 0.5, -0.7, 0.99])
@pytest.mark.parametrize("x", [0.5, 2.0, 3.5])
def test_two_correlated_numbers_are_beyond_together_as_scipy_has_it(x, rho):
    normal = stats.multivariate_normal(cov=[[1.0, rho], [rho, 1.0]])
    inside = normal.cdf([x, x]) - normal.cdf([x, -x]) - normal.cdf([-x, x]) + normal.cdf([-x, -x])
    either = 2 * 2 * stats.norm.sf(x) - (1 - inside)
    assert _both_beyond(x, rho) == pytest.approx(either, rel=2e-3, abs=1e-7)


def searched(rng, K, step=0.0, gap=None):
    z = np.tile(rng.normal(size=N), (K, 1))
    if gap is not None:
        z[gap + 1 :, 0] += step
    sums, _, _ = drawn(rng, z)
    return step_falls(
        Equations.of(sums, np.zeros((K, N))), Regressed(np.zeros(0, np.int64), np.zeros((K, 0))).design(N), 0
    )


@pytest.mark.full
def test_a_step_is_proposed_where_there_is_none_as_rarely_as_the_level_says_and_not_much_more_rarely():
    sets, level = effort(1000, 5000), 0.1
    p_values = np.array([searched(np.random.default_rng([4, seed]), 30).p_value(1.0) for seed in range(sets)])
    spread = 3.0 * np.sqrt(level / sets)
    assert 0.5 * level - spread < np.mean(p_values < level) < level + spread
    # Bonferroni's bound over 29 gaps would be passed far more rarely
    assert np.mean(p_values < LEVEL) < LEVEL + 3.0 * np.sqrt(LEVEL / sets)


@pytest.mark.parametrize("size", [0.4, 0.8, 2.0])
def test_a_date_lies_in_its_interval_at_least_as_often_as_it_says(size):
    sets, inside, widths = effort(300, 1500), [], []
    for seed in range(sets):
        rng = np.random.default_rng([5, seed])
        gap = int(rng.integers(4, 25))
        falls = searched(rng, 30, size, gap)
        first, last = falls.interval(1.0)
        inside.append(first <= gap <= last)
        widths.append(last - first + 1)
    assert np.mean(inside) > 0.95 - 3.0 * np.sqrt(0.05 * 0.95 / sets)
    assert np.mean(widths) < {0.4: 30.0, 0.8: 12.0, 2.0: 2.5}[size]
