"""Noise from the data: found within its sigmas where it is injected, not needed where it is not; applied, it makes sigmas true."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2, kstest

from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import parse_calibration
from boresight.calibration.evaluation.pixel_residuals import FreeCovariance
from boresight.calibration.noise import (
    HARMONICS,
    NEEDED,
    PHASE_NAMES,
    UNITS,
    estimate_noise,
    fit_noise,
    holm,
    phase_amplitude,
    phase_waves,
)
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.calibration.telemetry_pieces import TelemetryFile
from boresight.kernels.noise import score_noise, take_rotations_out
from boresight.simulation.scenes import calibration_scenario, simulate, validation_scenario
from boresight.simulation.sensors import st16_truth
from tests.calibration.sets import write_in_groups
from tests.effort import effort, few_of

TRUTH = st16_truth(1)


def made(catalogue, seed, sigma_px=0.3, frames=100, curve_px=0.0, base=None, **changes):
    """A set whose file states no noise, with an S-curve of its centroids within the pixel; and its sensor."""
    scenario = replace(base or calibration_scenario(1, frames), centroid_sigma_px=sigma_px, **changes)
    telemetry = simulate(scenario, np.random.default_rng([seed, 29]), catalogue)
    moved = {
        name: getattr(telemetry, name) + curve_px * np.sin(2 * np.pi * getattr(telemetry, name))
        for name in ("row_px", "col_px")
    }
    return replace(telemetry, sigma_px=None, **moved), replace(scenario.sensor, centroid_sigma_px=sigma_px)


def estimated(catalogue, telemetry, sensor, x=TRUTH):
    """Every term at the truth; what parameters might be is part of the fit."""
    arcs = build_problem(telemetry, sensor, catalogue).arcs.whole()
    n = len(x)
    known = FreeCovariance(np.arange(n), sensor.typical_sigma, np.zeros((n, n)))
    return estimate_noise(arcs, sensor, x, known, catalogue, telemetry, telemetry)


def by_name(noise):
    return {term.name: term for term in noise.terms}


def restricted_likelihood(theta, r, X, g, sigma):
    """The textbook form with whole matrices: -(ln|V| + ln|X' V^-1 X| + r' P r) / 2."""
    V = np.repeat((sigma * np.exp(g @ theta)) ** 2, 2)
    W = X / V[:, None]
    A = X.T @ W
    left = r / V - W @ np.linalg.solve(A, W.T @ r)
    return -(np.log(V).sum() + np.linalg.slogdet(A)[1] + r @ left) / 2


def a_small_field(rng, exposures=40, stars=7):
    n = exposures * stars
    K, J, D = rng.normal(size=(n, 2, 3)), rng.normal(size=(n, 2, 4)), rng.normal(size=(n, 2, 2))
    g = np.stack([np.ones(n), rng.normal(size=n)], axis=-1)
    sigma, starts = rng.uniform(0.1, 0.3, n), np.arange(0, n + 1, stars)
    return K, J, D, g, sigma, starts


def test_the_noise_maximises_the_restricted_likelihood_and_claims_its_curvature():
    rng = np.random.default_rng(4)
    K, J, D, g, sigma, starts = a_small_field(rng)
    r = (sigma * np.exp(g @ [0.3, 0.2]))[:, None] * rng.normal(size=(len(sigma), 2))
    found = fit_noise(r, J, K, D, g, sigma, starts)
    attitude = np.zeros((len(sigma), 2, 3 * (len(starts) - 1)))
    for e in range(len(starts) - 1):
        stars = slice(starts[e], starts[e + 1])
        attitude[stars, :, 3 * e : 3 * e + 3] = K[stars]
    X = np.concatenate([attitude, J, D], axis=2).reshape(2 * len(sigma), -1)
    flat, steps = r.ravel(), 1e-4 * np.eye(2)

    def at(theta):
        return restricted_likelihood(theta, flat, X, g, sigma)

    slope = [(at(found.theta + h) - at(found.theta - h)) / 2e-4 for h in steps]
    known_to = np.sqrt(np.diag(found.P_theta))
    assert np.abs(slope * known_to).max() < 0.05  # of a sigma from the maximum
    # the information is that of the likelihood: tr(P dV P dV) / 2
    V = np.repeat((sigma * np.exp(g @ found.theta)) ** 2, 2)
    P = np.diag(1 / V) - (X / V[:, None]) @ np.linalg.solve(X.T @ (X / V[:, None]), (X / V[:, None]).T)
    slopes = [np.diag(2 * V * np.repeat(g[:, k], 2)) for k in range(2)]
    A = np.array([[np.trace(P @ a @ P @ b) / 2 for b in slopes] for a in slopes])
    np.testing.assert_allclose(np.linalg.inv(found.P_theta), A, rtol=0.02, atol=0.01 * A.max())
    # the bias is the generalised least squares of the whole matrices
    b = np.linalg.solve(X.T @ (X / V[:, None]), X.T @ (flat / V))[-2:]
    np.testing.assert_allclose(found.b, b, atol=0.02 * np.sqrt(np.diag(found.P_b)).max())


def test_the_loops_of_the_likelihood_are_plain_numpy():
    rng = np.random.default_rng(5)
    K, J, D, g, sigma, starts = a_small_field(rng)
    r, n, exposures, weight = rng.normal(size=(len(sigma), 2)), len(sigma), len(starts) - 1, 1 / sigma
    L, X = np.empty((exposures, 3, 3)), np.empty((n, 2, 7))
    take_rotations_out(starts, r, J, K, D, weight, L, X)
    c, G = rng.normal(size=6), rng.normal(size=(6, 6))
    score, A = np.empty(2), np.empty((2, 2))
    score_noise(starts, K, weight, L, g, X, X.reshape(2 * n, -1)[:, :-1] @ G, c, score, A)
    expected_score, expected_A = np.zeros(2), np.zeros((2, 2))
    for e in range(exposures):
        stars = slice(starts[e], starts[e + 1])
        w = weight[stars, None, None]
        turn, rows = (K[stars] * w).reshape(-1, 3), np.concatenate([J, D, r[:, :, None]], axis=2)[stars] * w
        N = np.linalg.inv(turn.T @ turn)
        rows = rows.reshape(-1, 7) - turn @ N @ turn.T @ rows.reshape(-1, 7)
        np.testing.assert_allclose(X[stars].reshape(-1, 7), rows, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(L[e] @ L[e].T, N, rtol=1e-10)
        h = np.sum((turn @ N) * turn, axis=1) + np.sum((rows[:, :-1] @ G) * rows[:, :-1], axis=1)
        q = np.repeat(g[stars], 2, axis=0)
        expected_score += q.T @ ((rows[:, -1] - rows[:, :-1] @ c) ** 2 - 1 + h)
        S = [(turn * q[:, k : k + 1]).T @ turn @ N for k in range(2)]
        expected_A += 2 * (q.T @ (q * (1 - 2 * h)[:, None]) + [[np.trace(a @ b) for b in S] for a in S])
    np.testing.assert_allclose(score, expected_score, rtol=1e-10)
    np.testing.assert_allclose(A, expected_A, rtol=1e-10)


def test_noise_and_bias_scatter_as_they_claim():
    rng, n = np.random.default_rng(7), effort(60, 600)
    K, J, D, g, sigma, starts = a_small_field(rng)
    theta, b = np.array([0.2, -0.1]), np.array([0.02, -0.03])
    z = np.empty((n, 4))
    for k in range(n):
        r = D @ b + (sigma * np.exp(g @ theta))[:, None] * rng.normal(size=(len(sigma), 2))
        found = fit_noise(r, J, K, D, g, sigma, starts)
        z[k, :2] = (found.theta - theta) / np.sqrt(np.diag(found.P_theta))
        z[k, 2:] = (found.b - b) / np.sqrt(np.diag(found.P_b))
    assert np.abs(z.mean(axis=0)).max() < 4 / np.sqrt(n)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], n) / n
    assert ((low < (z**2).mean(axis=0)) & ((z**2).mean(axis=0) < high)).all()


def test_holms_correction_is_the_naive_one():
    p = np.random.default_rng(1).uniform(0, 0.3, 9)
    naive = np.empty(9)
    worst = 0.0
    for rank, place in enumerate(sorted(range(9), key=lambda k: p[k])):
        worst = max(worst, min(1.0, (9 - rank) * p[place]))
        naive[place] = worst
    np.testing.assert_allclose(holm(list(p)), naive)


def test_of_clean_sets_no_more_than_one_in_a_hundred_needs_a_term(catalogue):
    n = effort(20, 400)
    p, needed = {name: [] for name in UNITS}, 0
    for seed in range(n):
        noise = estimated(catalogue, *made(catalogue, seed))
        assert noise.unavailable == {}
        needed += any(term.needed for term in noise.terms)
        for term in noise.terms:
            p[term.name].append(term.probability)
    assert needed <= binom.ppf(0.999, n, NEEDED)
    for values in p.values():
        assert kstest(values, "uniform").pvalue > 1e-4


def measured_curve(curve_px, sigma_px):
    """Harmonics of E[bias | measured phase], by drawing."""
    rng = np.random.default_rng(8)
    true = rng.uniform(0, 1, 2_000_000)
    seen = true + sigma_px * rng.normal(size=len(true))
    place = seen + curve_px * np.sin(2 * np.pi * seen)
    return np.linalg.lstsq(phase_waves(place), place - true, rcond=None)[0]


def test_an_s_curve_and_noise_that_grows_with_magnitude_are_found_within_their_sigmas(catalogue):
    expected, n = measured_curve(0.1, 0.05), effort(4, 60)
    curve, slopes, by_chance = [], [], 0
    for seed in range(n):
        found = by_name(estimated(catalogue, *made(catalogue, seed, sigma_px=0.05, curve_px=0.1)))
        for name in ("phase_row", "phase_col"):
            values, sigma = found[name].coefficients, found[name].sigma
            curve.append([(values[one] - e) / sigma[one] for one, e in zip(PHASE_NAMES, expected, strict=True)])
            assert found[name].needed
            assert phase_amplitude(values) == pytest.approx(0.1, abs=0.03)
        by_chance += found["magnitude"].needed
        grown = by_name(estimated(catalogue, *made(catalogue, seed, sigma_dex_per_mag=0.2)))
        slopes.append((grown["magnitude"].coefficients["slope"] - 0.2) / grown["magnitude"].sigma["slope"])
        assert grown["magnitude"].needed
        by_chance += grown["phase_row"].needed
    assert by_chance <= binom.ppf(0.999, 2 * n, NEEDED)
    curve = np.array(curve)
    assert np.mean(curve**2) < chi2.ppf(1 - 1e-3, curve.size) / curve.size
    assert np.abs(np.mean(slopes)) < 1.0  # the telemetry's magnitude has an error of 0.1 of its own
    assert len(HARMONICS) * 2 == curve.shape[1]


def test_a_colour_of_the_lens_is_found_and_subtracted(catalogue):
    telemetry, sensor = made(catalogue, 3, sigma_px=0.1)
    star = catalogue.find_index(telemetry.star_id)
    bv = np.where(star >= 0, catalogue.colour_bv[np.maximum(star, 0)], 0.6)
    corner = np.hypot(sensor.rows, sensor.columns) / 2
    shifted = replace(
        telemetry,
        row_px=telemetry.row_px + 0.3 * bv * (telemetry.row_px - TRUTH[1]) / corner,
        col_px=telemetry.col_px + 0.3 * bv * (telemetry.col_px - TRUTH[2]) / corner,
    )
    term = by_name(estimated(catalogue, shifted, sensor))["colour"]
    assert term.needed
    assert term.coefficients["slope"] == pytest.approx(0.3, rel=0.15)
    found = calibrate(shifted, sensor, catalogue, CalibrationSettings(noise_model="from-data", match="given"))
    assert by_name(found.noise)["colour"].applied
    left = calibrate(shifted, sensor, catalogue, CalibrationSettings(match="given"))
    assert found.chi2_per_dof < left.chi2_per_dof


def nees(found):
    d = np.array([found.parameters[name] for name in found.covariance.names]) - TRUTH
    return float(d @ np.linalg.solve(np.array(found.covariance.matrix), d))


@pytest.mark.full
@pytest.mark.parametrize("changes", few_of([{"sigma_dex_per_mag": 0.2}, {"sigma_px": 0.05, "curve_px": 0.1}], 1))
def test_applied_from_the_data_the_sigmas_are_true_where_the_stated_noise_misleads(catalogue, changes):
    n, of, inside = effort(4, 200), {"stated": [], "from-data": []}, {"stated": 0, "from-data": 0}
    for seed in range(n):
        telemetry, sensor = made(catalogue, seed, **changes)
        for noise_model, values in of.items():
            found = calibrate(telemetry, sensor, catalogue, CalibrationSettings(noise_model=noise_model))
            values.append(nees(found))
            applied = [term.name for term in found.noise.terms if term.applied]
            assert bool(applied) == (noise_model == "from-data")
            inside[noise_model] += found.chi2.consistent
    low, high = chi2.ppf([1e-3, 1 - 1e-3], 8 * n) / n
    assert low < np.mean(of["from-data"]) < high
    assert inside["from-data"] >= binom.ppf(1e-3, n, 0.9)
    assert inside["stated"] == 0
    assert np.mean(np.abs(np.log(np.array(of["stated"]) / 8))) > np.mean(np.abs(np.log(np.array(of["from-data"]) / 8)))


def test_what_was_applied_is_on_record_and_holds_for_validation_and_files_too(catalogue, tmp_path):
    telemetry, sensor = made(catalogue, 1, sigma_px=0.05, curve_px=0.1)
    validation, _ = made(catalogue, 2, sigma_px=0.05, curve_px=0.1, base=validation_scenario(1, 30))
    settings = CalibrationSettings(noise_model="from-data")
    found = calibrate(telemetry, sensor, catalogue, settings, validation=validation)
    assert found.inputs.settings.noise_model == "from-data"
    assert parse_calibration(found.to_json()).noise == found.noise
    assert calibrate(telemetry, sensor, catalogue, settings, validation=validation).parameters == found.parameters
    plain = calibrate(telemetry, sensor, catalogue, CalibrationSettings(), validation=validation)
    assert found.validation.rms_arc_rad.final < 0.75 * plain.validation.rms_arc_rad.final
    file = TelemetryFile(write_in_groups(telemetry, tmp_path, 200), large_rows=0, chunk_frames=40)
    pieces = calibrate(file, sensor, catalogue, settings, scratch_folder=tmp_path)
    for name, sigma in found.sigma.items():
        assert pieces.parameters[name] == pytest.approx(found.parameters[name], abs=0.1 * sigma)


def test_what_cannot_be_told_says_why(catalogue):
    telemetry, sensor = made(catalogue, 1, frames=40)
    noise = estimated(catalogue, replace(telemetry, time_utc=telemetry.time_utc, quaternion=None), sensor)
    assert "rate" in by_name(noise)
    rounded = replace(telemetry, row_px=np.round(telemetry.row_px))
    assert "unrounded" in estimated(catalogue, rounded, sensor).unavailable["phase_row"]
    few = telemetry.frame < 4
    picked = {
        name: getattr(telemetry, name)[few]
        for name in vars(telemetry)
        if isinstance(getattr(telemetry, name), np.ndarray)
    }
    short = estimated(catalogue, replace(telemetry, **picked), sensor)
    assert short.terms == []
    assert set(short.unavailable) == set(UNITS)
