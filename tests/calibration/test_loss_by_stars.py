"""The loss by stars: order of rows, fixed point, honest covariance at the noise stated and at gross outliers."""

from dataclasses import fields, replace

import numpy as np
import pytest

from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.estimation.robust import TUNING, StarWeights
from boresight.estimation.statistics.special import chdtri
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import read_sensor
from tests.calibration.sets import field, in_memory, st16, streamed, written
from tests.calibration.test_verification import calibrated, normalised_error, with_wrong
from tests.estimation.fields import TRUTH

RNG = np.random.default_rng


def with_gross(telemetry, share, seed, reach_px=30.0):
    """Throw the centroids of some rows off by up to so many pixels an axis."""
    rng, n = RNG([3, seed]), len(telemetry)
    rows = rng.choice(n, round(share * n), replace=False)
    row, col = telemetry.row_px.copy(), telemetry.col_px.copy()
    row[rows] = np.clip(row[rows] + rng.uniform(-reach_px, reach_px, len(rows)), 0, st16().rows - 1)
    col[rows] = np.clip(col[rows] + rng.uniform(-reach_px, reach_px, len(rows)), 0, st16().columns - 1)
    return replace(telemetry, row_px=row, col_px=col)


def permuted(telemetry, seed):
    """Another order of the rows of every exposure."""
    order = np.lexsort((RNG(seed).random(len(telemetry)), telemetry.exposure, telemetry.frame))
    arrays = {item.name: getattr(telemetry, item.name) for item in fields(telemetry)}
    return replace(telemetry, **{name: one[order] for name, one in arrays.items() if isinstance(one, np.ndarray)})


@pytest.mark.parametrize("stars", [5, 12])
def test_the_order_of_the_rows_does_not_matter(catalogue, stars):
    telemetry = with_gross(field(6, frames=60, stars=stars), 0.05, 6)
    one, other = (calibrated(each, catalogue, robust="stars") for each in (telemetry, permuted(telemetry, 1)))
    assert one.status == other.status == "converged"
    for name in one.free:
        assert abs(one.parameters[name] - other.parameters[name]) < 1e-6 * one.sigma[name]


@pytest.mark.few(1)
@pytest.mark.parametrize("sets", [pytest.param(5), pytest.param(200, marks=pytest.mark.full)])
@pytest.mark.parametrize("spoil", ["nothing", "gross", "names"])
def test_the_covariance_is_honest_on_clean_sets_and_with_every_tenth_star_wrong(catalogue, sets, spoil):
    errors = []
    for seed in range(sets):
        telemetry = field(2000 + seed, frames=60)
        if spoil == "gross":
            telemetry = with_gross(telemetry, 0.1, seed)
        if spoil == "names":
            telemetry, _ = with_wrong(telemetry, 0.1, seed)
        found = calibrated(telemetry, catalogue, robust="stars")
        assert found.status == "converged"
        errors.append(normalised_error(found))
    low, high = (chdtri(8 * sets, p) / sets for p in (0.9995, 0.0005))
    assert low < np.mean(errors) < high


def test_of_gaussian_noise_95_percent_of_the_information_is_left(catalogue):
    telemetry = field(7, frames=150)
    plain, by_stars = (calibrated(telemetry, catalogue, robust=loss) for loss in ("none", "stars"))
    shares = [(plain.sigma[name] / by_stars.sigma[name]) ** 2 for name in plain.free]
    assert np.mean(shares) == pytest.approx(0.95, abs=0.03)


@pytest.mark.full
def test_heavy_tails_cost_least_squares_more_than_the_loss_by_stars(catalogue):
    rng, telemetry = RNG(4), field(9, frames=150, noise_px=0.0)
    noise = st16().centroid_sigma_px * rng.standard_t(2.2, size=(2, len(telemetry)))
    row = np.clip(telemetry.row_px + noise[0], 0, st16().rows - 1)
    col = np.clip(telemetry.col_px + noise[1], 0, st16().columns - 1)
    heavy = replace(telemetry, row_px=row, col_px=col)
    found = calibrated(heavy, catalogue, robust="stars")
    assert normalised_error(found) < chdtri(8, 1e-4)
    assert found.robust.downweighted > 0
    assert f" {found.robust.downweighted:,} stars" in found.robust.sentence


def weighted_statistic(s, c, sigma, w, i):
    """t^2 of star i under the weighted attitude of the others of its exposure, by hand."""
    n = len(s)
    rest = [k for k in range(n) if k != i and w[k] > 0]
    u, _, vt = np.linalg.svd(sum(w[k] / sigma[k] ** 2 * np.outer(s[k], c[k]) for k in rest))
    C = u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt
    N = np.linalg.inv(sum(w[k] / sigma[k] ** 2 * (np.eye(3) - np.outer(s[k], s[k])) for k in rest))
    e1 = np.cross([0.0, 1.0, 0.0], s[i])
    e1 /= np.linalg.norm(e1)
    T = np.stack([e1, np.cross(s[i], e1)])
    d = T @ (s[i] - C @ c[i])
    K = T @ np.stack([np.cross(axis, s[i]) for axis in np.eye(3)], axis=-1)
    return d @ np.linalg.solve(sigma[i] ** 2 * np.eye(2) + K @ N @ K.T, d)


def test_the_weights_of_an_exposure_reproduce_themselves(catalogue):
    telemetry = with_gross(field(6, frames=3, exposures=1), 0.1, 6, reach_px=4.0)
    problem = build_problem(telemetry, st16(), catalogue)
    arcs = problem.arcs.whole()
    w, t2 = StarWeights(1, TRUTH, 1.0, 4).compute_weights(arcs)
    assert (w > 0.99).any()
    assert (w < 0.5).any()
    camera = problem.camera
    s = camera.directions(TRUTH, arcs.row_px, arcs.col_px, arcs.pitch)
    sigma = arcs.sigma_px * np.sqrt(camera.solid_angle(TRUTH, arcs.row_px, arcs.col_px, arcs.pitch))
    for first, last in zip(arcs.star_start[:-1], arcs.star_start[1:], strict=True):
        part = slice(first, last)
        brute = [weighted_statistic(s[part], arcs.s_i[part], sigma[part], w[part], i) for i in range(last - first)]
        np.testing.assert_allclose(t2[part], brute, rtol=1e-2, atol=1e-3)
    np.testing.assert_allclose(w, np.maximum(1 - t2 / TUNING**2, 0.0) ** 2, atol=1e-9)


def test_a_set_in_pieces_has_the_same_estimate(catalogue, tmp_path):
    path, telemetry = written(with_gross(field(4, frames=60), 0.05, 3), tmp_path)
    choices = {"match": "given", "robust": "stars"}
    whole, pieces = in_memory(telemetry, st16(), catalogue, **choices), streamed(path, st16(), catalogue, 7, **choices)
    assert whole["status"] == "converged"
    assert whole["robust"] == pieces["robust"]
    assert whole["parameters"] == pieces["parameters"]


def test_the_loss_is_of_the_batch():
    with pytest.raises(ValueError, match="only with method 'batch'"):
        CalibrationSettings.parse({"method": "sqrf", "robust": "stars"})


@pytest.mark.full
@pytest.mark.parametrize(("frames", "stars"), [(1, 12), (1, 30), (5, 100)])
def test_few_exposures_reach_their_fixed_point_though_rounding_hides_the_last_of_the_way(catalogue, frames, stars):
    for seed in range(4):
        found = calibrated(field(seed, frames=frames, stars=stars, exposures=1), catalogue, robust="stars")
        assert found.status == "converged"


def test_real_frames_reach_their_fixed_point(catalogue, real_sky):
    telemetry, sensor = read_telemetry(real_sky / "esa-5-frames.csv"), read_sensor(real_sky / "esa.sensor.json")
    found, plain = (calibrated(telemetry, catalogue, sensor, robust=robust) for robust in ("stars", "none"))
    assert found.status == "converged"
    for name in plain.free:
        assert abs(found.parameters[name] - plain.parameters[name]) < plain.sigma[name]
