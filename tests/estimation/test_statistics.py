"""Chi-square, observability, differences, series, drift and prediction against plain forms, drawn estimates and their levels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special as scipys
from scipy.stats import binom, chi2

from boresight.calibration.evaluation.contrast import (
    SharedData,
    covariance_of_difference,
    joint_test,
    sigma_of_difference,
)
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import batch
from boresight.estimation.metrics import aggregate_rms, rms, tail_rms
from boresight.estimation.statistics import special
from boresight.estimation.statistics.consistency import chi_square, ljung_box, runs_p_value, share_bounds
from boresight.estimation.statistics.drift import (
    Epoch,
    baseline_test,
    fit_line,
    mahalanobis,
    power,
    slope_test,
)
from boresight.estimation.statistics.observability import further_covariance, observability
from boresight.estimation.statistics.uncertainty import radial_difference
from tests.estimation.fields import FREE, GROUND, PITCH, SCALE, TRUTH, star_field, whitened

NAMES, SYMBOLS = INVERTED_WANG.parameter_names, INVERTED_WANG.symbols


@given(dof=st.integers(1, 100_000))
def test_the_bounds_are_the_quantiles_of_chi_square(dof):
    test = chi_square(float(dof), dof)
    np.testing.assert_allclose([test.lower, test.upper], chi2.ppf([0.025, 0.975], dof) / dof, rtol=1e-6)
    assert test.consistent == (test.lower <= 1.0 <= test.upper)


def test_no_degrees_of_freedom_and_more_lags_than_values_are_programming_errors():
    with pytest.raises(ValueError, match="received 0"):
        chi_square(1.0, 0)
    with pytest.raises(ValueError, match=r"5 lags .*5 values"):
        ljung_box(np.ones(5), 5)


def test_the_principal_point_and_the_tilt_are_named_as_moving_together():
    pinhole = GROUND.copy()
    pinhole[4] = -50.0
    field = whitened(star_field(np.random.default_rng(21), frames=20, truth=pinhole), pinhole)
    equations = batch.normal_equations(field, pinhole, FREE, SCALE)
    seen = observability(equations.A, NAMES, SYMBOLS)
    pairs = [set(seen.sentence(i).split(" move together")[0].split(" and ")) for i in (7, 6)]
    assert pairs in ([{"m0", "a2"}, {"n0", "a1"}], [{"n0", "a1"}, {"m0", "a2"}])
    # moving the principal point with the tilt that follows it, a2 = (Delta / f) dm0 of the same sign, is the weak direction
    for i in (7, 6):
        v = seen.direction(i)
        point, tilt = ("m0_px", "a2_rad") if abs(v["m0_px"]) > 0.5 else ("n0_px", "a1_rad")
        ratio = v[tilt] * SCALE[NAMES.index(tilt)] / (v[point] * SCALE[NAMES.index(point)])
        assert ratio == pytest.approx(PITCH / GROUND[0], rel=0.1)


def test_singular_values_rebuild_the_information_and_an_undetermined_direction_is_said_to_be_so():
    field = whitened(star_field(np.random.default_rng(22), frames=10), TRUTH)
    A = batch.normal_equations(field, TRUTH, FREE, SCALE).A
    seen = observability(A, NAMES, SYMBOLS)
    np.testing.assert_allclose(seen.V @ np.diag(seen.singular_values**2) @ seen.V.T, A, rtol=1e-8, atol=1e-10 * A.max())
    assert (np.diff(seen.singular_values) <= 0).all()
    assert seen.condition_number == pytest.approx(seen.singular_values[0] / seen.singular_values[-1])
    open_one = observability(np.diag([4.0, 0.0]), ("f_m", "g_y"), ("f", "g_y"))
    assert open_one.sentence(1) == "g_y is nearly independent of the others: it is not determined by these data."
    assert (open_one.condition_number, open_one.weak()) == (None, [1])


def test_tail_and_aggregate_rms_follow_their_definitions():
    field = whitened(star_field(np.random.default_rng(23), frames=6), GROUND)
    states = np.linspace(GROUND, TRUTH, 6)
    tail = tail_rms(field, states)
    parts = [field.frames(k, k + 1) for k in range(6)]
    squares = np.array([rms(part, x) ** 2 * part.n_arcs for part, x in zip(parts, states, strict=True)])
    counts = np.array([float(part.n_arcs) for part in parts])
    np.testing.assert_allclose(tail, [rms(field, x) for x in states], rtol=1e-12)
    np.testing.assert_allclose(aggregate_rms(squares, counts)[-1] ** 2 * counts.sum(), squares.sum(), rtol=1e-12)


def test_the_band_of_the_radial_curve_is_the_spread_of_curves_drawn_from_the_covariance():
    field = whitened(star_field(np.random.default_rng(24), frames=40), TRUTH)
    P = np.linalg.inv(batch.normal_equations(field, TRUTH, FREE, SCALE).A) * np.outer(SCALE, SCALE)
    radius = np.array([0.0, 300.0, 900.0, 1500.0])
    curve = radial_difference(INVERTED_WANG, TRUTH, GROUND, P, radius, PITCH)
    draws = np.random.default_rng(1).multivariate_normal(TRUTH, P, size=4000, method="cholesky")
    drawn = np.array([radial_difference(INVERTED_WANG, x, GROUND, P, radius, PITCH).difference_px for x in draws])
    np.testing.assert_allclose(drawn.std(axis=0)[1:], curve.sigma_px[1:], rtol=0.05)
    np.testing.assert_allclose(drawn.mean(axis=0), curve.difference_px, atol=0.01)
    assert curve.sigma_px[0] == 0


def test_the_radial_curve_is_the_displacement_that_projection_shows():
    x = GROUND.copy()
    x[[0, 3, 4]] = TRUTH[[0, 3, 4]]
    radius = np.array([200.0, 1000.0])
    curve = radial_difference(INVERTED_WANG, x, GROUND, np.zeros((8, 8)), radius, PITCH)
    rays = INVERTED_WANG.directions(x, x[1] + radius, np.full(2, x[2]), PITCH)
    angle = np.arctan2(rays[:, 0], rays[:, 2])
    before = INVERTED_WANG.directions(GROUND, GROUND[1] + radius, np.full(2, GROUND[2]), PITCH)
    np.testing.assert_allclose(curve.difference_rad, angle - np.arctan2(before[:, 0], before[:, 2]), atol=1e-12)
    np.testing.assert_allclose(
        curve.difference_px / radius, np.tan(angle) / (before[:, 0] / before[:, 2]) - 1, atol=1e-10
    )


@given(st.integers(0, 10_000), st.integers(12, 60))
def test_autocorrelation_and_q_are_those_of_plain_sums(seed, n):
    y = np.random.default_rng(seed).normal(size=n)
    lags = n // 4
    test = ljung_box(y, lags)
    r = [sum(y[k] * y[k + lag] for k in range(n - lag)) / sum(y**2) for lag in range(1, lags + 1)]
    np.testing.assert_allclose(test.autocorrelation, r, atol=1e-12)
    assert test.value == pytest.approx(n * (n + 2) * sum(r[lag - 1] ** 2 / (n - lag) for lag in range(1, lags + 1)))
    assert test.dof == lags


def test_white_series_and_runs_of_independent_values_are_called_unlikely_as_often_as_the_level_says():
    rng = np.random.default_rng(1)
    p = np.array([ljung_box(rng.normal(size=200), 5).p for _ in range(2000)])
    of_runs = np.array([runs_p_value(rng.chisquare(8, size=100)) for _ in range(2000)])
    assert np.mean(p < 0.5) == pytest.approx(0.5, abs=0.05)
    assert [np.mean(each < 0.05) for each in (p, of_runs)] == pytest.approx([0.05] * 2, abs=0.02)


def test_a_slow_wave_below_the_noise_is_not_white_nor_is_one_run_up_and_one_down_chance():
    rng = np.random.default_rng(2)
    wave = 0.7 * np.sin(2 * np.pi * np.arange(300) / 100)
    assert ljung_box(wave + rng.normal(size=300), 5).p < 1e-4
    assert runs_p_value(wave + rng.normal(size=300)) < 0.05
    assert runs_p_value(np.arange(40.0)) < 1e-6
    assert runs_p_value(np.arange(6.0)) == 1
    assert runs_p_value(np.ones(50)) == 1


@given(st.integers(1, 400), st.floats(0.01, 0.5))
def test_bounds_of_a_share_are_those_of_the_binomial_distribution(n, share):
    low, high = share_bounds(n, share)
    assert low * n == pytest.approx(binom.ppf(0.025, n, share), abs=1e-6)
    assert high * n == pytest.approx(binom.ppf(0.975, n, share), abs=1e-6)


N_EXPOSURES, N_PARAMETERS, N_TRIALS = 60, 3, 6000
RNG = np.random.default_rng(7)
H = RNG.normal(size=(N_EXPOSURES, 4, N_PARAMETERS)) * np.array([1.0, 3.0, 0.2])


def estimates(noise, chosen):
    A, y = H[chosen].reshape(-1, N_PARAMETERS), noise[:, chosen].reshape(len(noise), -1)
    P = np.linalg.inv(A.T @ A)
    return y @ A @ P, P


@pytest.fixture(scope="module")
def noise():
    return np.random.default_rng(8).normal(size=(N_TRIALS, N_EXPOSURES, 4))


@pytest.mark.parametrize(
    ("a", "b", "tolerance"),
    [
        (range(30), range(30, 60), 0.06),
        (range(20), range(60), 0.06),
        (range(60), range(45), 0.06),
        (range(40), range(20, 60), 0.2),  # shares are told, not what the shared exposures hold
    ],
    ids=["disjoint", "a within b", "b within a", "partly"],
)
def test_differences_scatter_as_their_covariance_says(noise, a, b, tolerance):
    (x_a, P_a), (x_b, P_b) = estimates(noise, list(a)), estimates(noise, list(b))
    common = len(set(a) & set(b))
    D = covariance_of_difference(P_a, P_b, SharedData(common / len(a), common / len(b)))
    assert np.std(x_a - x_b, axis=0) == pytest.approx(np.sqrt(np.diag(D)), rel=tolerance)


def test_nested_runs_are_not_independent_and_their_joint_test_is_a_chi_square(noise):
    (x_a, P_a), (x_b, P_b) = estimates(noise, list(range(50))), estimates(noise, list(range(60)))
    naive = np.sqrt(np.diag(P_a + P_b))
    assert np.all(np.std(x_a - x_b, axis=0) < 0.4 * naive)
    (x_a, P_a), (x_b, P_b) = estimates(noise, list(range(20))), estimates(noise, list(range(60)))
    D = covariance_of_difference(P_a, P_b, SharedData(1, 1 / 3))
    sigma = sigma_of_difference(P_a, P_b, D)
    tests = [joint_test(d, D, sigma) for d in (x_a - x_b)[:800]]
    assert {dof for _, dof, _ in tests} == {N_PARAMETERS}
    assert np.mean([p < 0.05 for _, _, p in tests]) == pytest.approx(0.05, abs=0.025)


def test_a_worse_estimator_on_the_same_data_differs_by_the_difference_of_the_variances(noise):
    weight = np.where(np.arange(N_EXPOSURES) % 2, 1.0, 4.0)  # unbiased, but not with the weights of the noise
    A = H.reshape(-1, N_PARAMETERS)
    W = np.repeat(weight, 4)
    inverse = np.linalg.inv(A.T @ (A * W[:, None]))
    x_a = noise.reshape(N_TRIALS, -1) @ (A * W[:, None]) @ inverse
    P_a = inverse @ (A.T @ (A * W[:, None] ** 2)) @ inverse
    x_b, P_b = estimates(noise, list(range(60)))
    D = covariance_of_difference(P_a, P_b, SharedData(1, 1))
    assert np.std(x_a - x_b, axis=0) == pytest.approx(np.sqrt(np.diag(D)), rel=0.06)


def test_equal_estimates_of_the_same_data_have_no_noise_and_a_fixed_parameter_the_other_s_sigma(noise):
    _, P = estimates(noise, list(range(60)))
    D = covariance_of_difference(P, P * 1.001, SharedData(1, 1))
    sigma = sigma_of_difference(P, P, D)
    assert np.isnan(sigma).all()
    assert joint_test(np.ones(N_PARAMETERS), D, sigma) is None
    P_a, P_b = np.diag([4.0, 9.0]), np.diag([4.0, 0.0])
    sigma = sigma_of_difference(P_a, P_b, covariance_of_difference(P_a, P_b, SharedData(1, 1)))
    assert np.isnan(sigma[0])
    assert sigma[1] == pytest.approx(3)
    kinds = {(0, 0): "disjoint", (1, 1): "same", (1, 0.3): "inside", (0.3, 1): "around", (0.5, 0.5): "partly"}
    assert {shares: SharedData(*shares).kind for shares in kinds} == kinds


@given(st.floats(0, 1), st.floats(0, 1), st.floats(0.1, 10), st.floats(0.1, 10))
def test_a_covariance_is_never_negative_and_never_above_the_sum(share_a, share_b, scale_a, scale_b):
    P_a, P_b = scale_a * (np.eye(2) + 0.5), scale_b * (np.eye(2) + 0.8)
    shared = SharedData(share_a, share_b)
    D = covariance_of_difference(P_a, P_b, shared)
    assert np.linalg.eigvalsh(D).min() >= -1e-9
    assert np.all(np.diag(D) <= np.diag(P_a + P_b) + 1e-9)


@given(st.floats(0.01, 0.99), st.floats(0.1, 10))
def test_nested_data_are_the_limit_of_partly_shared_data(share, scale):
    P_a = scale * np.eye(2)
    P_b = share * P_a  # as much information a exposure
    nested = covariance_of_difference(P_a, P_b, SharedData(1, share))
    nearly = covariance_of_difference(P_a, P_b, SharedData(1 - 1e-9, share))
    assert nested == pytest.approx(nearly, abs=1e-6 * scale)


K = 5
SPREADS = np.array([5e-5, 50.0, 1e6, 50.0, 1e-3])  # as unlike as a camera's parameters are
ALPHA = 0.01
TRIALS = 4000


def _covariance(rng: np.random.Generator, sigmas: float) -> np.ndarray:
    A = rng.standard_normal((K, K)) + 2.0
    C = A @ A.T + 0.1 * np.eye(K)
    d = np.sqrt(np.diag(C))
    return C / np.outer(d, d) * np.outer(SPREADS, SPREADS) * sigmas**2


def _mission(rng: np.random.Generator, m: int, *, slope: float = 0.0, thermal: float = 0.0) -> list[Epoch]:
    found = []
    for t in np.sort(rng.uniform(0, 400, m)):
        T = 20 + 8 * np.sin(t / 30)
        C = _covariance(rng, 0.5 + rng.random())
        truth = SPREADS * (slope * t + thermal * (T - 20))
        found.append(Epoch(float(t), _drawn(rng, truth, C), C, float(T)))
    return found


def _within(alpha: float, trials: int) -> float:
    return 4 * float(np.sqrt(alpha * (1 - alpha) / trials))


def _drawn(rng: np.random.Generator, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    L = np.linalg.cholesky(covariance / np.outer(SPREADS, SPREADS))
    return mean + SPREADS * (L @ rng.standard_normal(K))


@pytest.mark.full
def test_the_baseline_test_keeps_its_false_alarm_rate_and_with_diagonal_covariances_would_not() -> None:
    rng = np.random.default_rng(7)
    P, B = _covariance(rng, 1.0), _covariance(rng, 0.3)
    drawn = [(_drawn(rng, SPREADS, P), _drawn(rng, SPREADS, B), _drawn(rng, SPREADS, P)) for _ in range(TRIALS)]
    found = [baseline_test(Epoch(9, one, P), Epoch(0, base, B), ALPHA).rejects for one, base, _ in drawn]
    assert abs(np.mean(found) - ALPHA) < _within(ALPHA, TRIALS)
    flat = np.diag(np.diag(P))
    found = [baseline_test(Epoch(9, one, flat), Epoch(0, other, flat), ALPHA).rejects for one, _, other in drawn]
    assert np.mean(found) > 2 * ALPHA


@pytest.mark.full
@pytest.mark.parametrize("thermal", [0.0, 0.4])
def test_the_slope_test_raises_no_more_false_alarms_than_it_says(thermal: float) -> None:
    rng = np.random.default_rng(11)
    trials = 1000
    lines = [fit_line(_mission(rng, 8, thermal=thermal)) for _ in range(trials)]
    assert all(line is not None and line.thermal_per_c is not None for line in lines)
    assert np.mean([slope_test(line, ALPHA).rejects for line in lines]) < ALPHA + _within(ALPHA, trials)


def test_the_power_is_the_share_of_changes_that_are_seen() -> None:
    rng = np.random.default_rng(3)
    P = _covariance(rng, 1.0)
    change = 0.8 * SPREADS * np.array([1, -1, 0.5, 0, 0])
    expected = power(change, P, ALPHA)
    base = Epoch(0, np.zeros(K), np.zeros((K, K)))
    seen = np.mean([baseline_test(Epoch(9, _drawn(rng, change, P), P), base, ALPHA).rejects for _ in range(TRIALS)])
    assert 0.1 < expected < 0.999
    assert abs(seen - expected) < _within(expected, TRIALS)


def test_a_drift_is_seen_with_its_slope_and_sigmas_that_are_too_small_are_widened_by_the_scatter() -> None:
    rng = np.random.default_rng(5)
    line = fit_line(_mission(rng, 20, slope=0.02, thermal=0.4))
    assert slope_test(line).rejects
    sigma = np.sqrt(np.diag(line.slope_covariance))
    assert (np.abs(line.slope_per_d - 0.02 * SPREADS) < 3.5 * sigma).all()
    assert (np.abs(line.thermal_per_c - 0.4 * SPREADS) < 3.5 * np.sqrt(np.diag(line.thermal_covariance))).all()
    rng = np.random.default_rng(9)
    honest = _mission(rng, 30)
    bold = [Epoch(one.t_d, one.value, one.covariance / 25, one.temperature_c) for one in honest]
    line, true_line = fit_line(bold), fit_line(honest)
    assert line.inflation == pytest.approx(25, rel=0.3)
    np.testing.assert_allclose(
        np.sqrt(np.diag(line.slope_covariance) / np.diag(true_line.slope_covariance)), 1.0, rtol=0.3
    )


@given(st.integers(0, 2**32 - 1), st.integers(3, 7))
def test_the_line_is_that_of_the_stacked_normal_equations(seed: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    epochs = [Epoch(one.t_d, one.value, one.covariance) for one in _mission(rng, m)]  # no temperatures
    t = np.array([one.t_d for one in epochs])
    if np.ptp(t) < 1:
        return
    X = np.concatenate([np.kron([1, (u - t.mean()) / 100], np.diag(SPREADS)) for u in t])
    weight = np.zeros((m * K, m * K))
    for i, one in enumerate(epochs):
        weight[i * K : (i + 1) * K, i * K : (i + 1) * K] = np.linalg.inv(one.covariance)
    y = np.concatenate([one.value for one in epochs])
    naive = np.linalg.solve(X.T @ weight @ X, X.T @ weight @ y)[K:] * SPREADS / 100
    line = fit_line(epochs)
    sigma = np.sqrt(np.diag(line.slope_covariance))
    assert (np.abs(line.slope_per_d - naive) < 1e-5 * sigma).all()


def test_what_cannot_be_tested_is_none_and_no_alarm() -> None:
    rng = np.random.default_rng(1)
    good = _mission(rng, 4)
    flat = np.ones((K, K))
    assert mahalanobis(np.ones(K), flat) is None
    assert mahalanobis(np.ones(K), np.full((K, K), np.nan)) is None
    assert fit_line(good[:2]) is None
    assert fit_line([Epoch(1.0, one.value, one.covariance) for one in good]) is None
    assert fit_line([Epoch(one.t_d, one.value, flat) for one in good]) is None
    assert baseline_test(Epoch(0, np.ones(K), flat), Epoch(0, np.ones(K), flat)) is None
    assert power(np.ones(K), flat) is None
    locked = [Epoch(one.t_d, one.value, one.covariance, one.t_d / 10) for one in _mission(rng, 6)]
    assert fit_line(locked).thermal_per_c is None  # temperature that goes with time is not told from it


def _problem(seed, n=4):
    rng = np.random.default_rng(seed)
    root, start = rng.normal(size=(n, n)), rng.normal(size=(n, n))
    return root @ root.T * 10.0 ** rng.uniform(-2, 2), start @ start.T + 0.1 * np.eye(n)


@given(st.integers(0, 10_000), st.integers(0, 70), st.sampled_from([0.0, 0.02, 1.0]), st.sampled_from([1.0, 0.98, 0.6]))
def test_many_frames_at_once_are_the_frames_one_by_one(seed, frames, noise, forgetting):
    a, P = _problem(seed)
    plain = P
    for _ in range(frames):
        plain = np.linalg.inv(np.linalg.inv(plain / forgetting + noise**2 * np.eye(4)) + a)
    found = further_covariance(P, a, frames, noise, forgetting)
    np.testing.assert_allclose(found, plain, rtol=1e-6, atol=1e-9 * np.abs(plain).max())


@pytest.mark.parametrize("forgetting", [1.0, 0.5, 0.9])
def test_without_noise_information_adds_up_and_with_it_a_million_frames_end_where_a_few_thousand_do(forgetting):
    a, P = _problem(2)
    found = further_covariance(P, a, 1000)
    np.testing.assert_allclose(np.linalg.inv(found), np.linalg.inv(P) + 1000 * a, rtol=1e-8)
    few, many = (further_covariance(P, a, frames, 0.1, forgetting) for frames in (5_000, 1_000_000))
    np.testing.assert_allclose(many, few, rtol=1e-9)


def test_a_direction_that_no_frame_tells_of_keeps_its_sigma():
    a = np.diag([1.0, 0.0])
    found = further_covariance(np.diag([4.0, 9.0]), a, 100)
    assert found[1, 1] == pytest.approx(9.0)
    assert found[0, 0] == pytest.approx(1 / 100.25)


DOF = [*map(float, range(1, 30)), 1.5, 100.0, 1177.0, 9999.0, 20_000.0]
CHANCES = (1e-6, 0.01, 0.025, 0.5, 0.975, 0.99)
SUCCESSES = [
    (k, n, p) for n in (1, 2, 30, 500, 30_000) for k in {0, n // 3, n // 2, n - 1, n} for p in (0.0027, 0.05, 0.5)
]
#: Arguments of each function, by its name here and in SciPy.
ARGUMENTS = {
    "ndtr": [(x,) for x in (-30.0, -3.0, 0.0, 2.0)],
    "ndtri": [(p,) for p in CHANCES],
    "chdtrc": [(dof, dof * share) for dof in DOF for share in (0.0, 0.3, 0.95, 1.0, 1.05, 1.5)],
    "chdtri": [(dof, p) for dof in DOF for p in CHANCES],
    "bdtr": SUCCESSES,
    "bdtrc": SUCCESSES,
    "stdtrit": [(dof, p) for dof in DOF for p in (0.6, 0.95, 0.975)],
    "fdtri": [(3.0, dof, 0.99) for dof in DOF],
    "fdtrc": [(first, dof, x) for first in (1.0, 4.0, 20.0) for dof in DOF for x in (0.0, 0.5, 1.0, 3.0, 9.0)],
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_tails_and_quantiles_are_scipys_one_by_one_and_of_arrays(name):
    ours, theirs = getattr(special, name), getattr(scipys, name)
    columns = [np.array(column) for column in zip(*ARGUMENTS[name], strict=True)]
    expected = theirs(*columns)
    np.testing.assert_allclose([ours(*row) for row in ARGUMENTS[name]], expected, rtol=1e-10, atol=1e-300)
    if name != "ndtri":
        for most in (5, len(expected)):
            found = ours(*(column[:most] for column in columns))
            np.testing.assert_allclose(found, expected[:most], rtol=1e-10, atol=1e-300)


def test_tails_without_degrees_of_freedom_are_scipys():
    for arguments in ((0.0, 1.0), (0.0, 0.0), (2.0, -1.0), (2.0, np.inf), (2.0, np.nan)):
        np.testing.assert_equal(special.chdtrc(*arguments), float(scipys.chdtrc(*arguments)))
