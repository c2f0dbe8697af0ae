"""Sigmas with misfit: never narrower than noise, the same on clean sets, and honest where the model is wrong."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

from boresight.calibration.calibrate import select_free_parameters
from boresight.calibration.calibration import Calibration, Covariance, ModelMisfit, Values
from boresight.calibration.estimate import run_batch
from boresight.calibration.evaluation.contrast import read_covariance
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import make_problem
from boresight.calibration.result import trend_entry
from boresight.calibration.trust.departures import find_departures
from boresight.calibration.trust.displacements import add_up, find_score
from boresight.calibration.trust.fitted_set import FAMILY_LEVEL, UNLIKELY, fit_best
from boresight.calibration.trust.misfit import _envelope, find_misfit, is_wider, misfit_advice, sum_of_squares, widen
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.statistics.consistency import nees
from boresight.estimation.statistics.observability import chi2_rise, is_curved
from boresight.telemetry.schema import Telemetry
from tests.calibration.sets import st16
from tests.estimation.fields import COLUMNS, PITCH, ROWS

NOISE_PX = {
    "clean": 0.437,
    "temperature": 0.437,
    "phase": 0.05,
    "tangential": 0.1,
    "quarter": 0.437,
    "loud": 0.437,
    "second": 0.437,
}


@dataclass(frozen=True)
class Made:
    fitted: object
    widening: object
    described: object
    error: np.ndarray

    @property
    def nees(self):
        return nees(self.error, self.fitted.estimate.P), nees(self.error, self.widening.P)

    @property
    def curved(self):
        fitted, estimate = self.fitted, self.fitted.estimate
        free, scale = fitted.parameters.free, fitted.parameters.scale
        return is_curved(chi2_rise(fitted.arcs, fitted.x, free, scale, estimate.A))


def made(case, seed, frames=100, stars=12):
    """A set of two exposures a frame whose camera is not what the model says, fitted and widened."""
    rng = np.random.default_rng([seed, len(case), *map(ord, case[:3])])
    camera = CAMERA_MODELS["pinhole_radial" if case == "tangential" else "inverted_wang"]
    names, noise_px, exposures = list(camera.parameter_names), NOISE_PX[case], 2 * frames
    scale = np.array(camera.default_typical_sigma)
    start = camera.plain(7316.0, ROWS / 2, COLUMNS / 2, PITCH)
    truth = start + scale * rng.normal(size=len(start))
    reach = 0.5 if case == "quarter" else 1.0
    row, col = (
        rng.uniform(0, reach * ROWS - 1, exposures * stars),
        rng.uniform(0, reach * COLUMNS - 1, exposures * stars),
    )
    if case == "tangential":
        truth[names.index("k1")] = truth[names.index("k2")] = 0.0
        s = tangential(truth, names, row, col, rng)
    elif case == "second":
        s = second(camera, truth, row, col, frames, rng)
    elif case == "temperature":
        s = breathing(camera, truth, row, col, frames, rng)
    else:
        s = camera.directions(truth, row, col, PITCH)
    turns = Rotation.random(exposures, rng=rng).as_matrix()
    s_i = np.einsum("eij,enj->eni", turns, s.reshape(exposures, stars, 3)).reshape(-1, 3)
    if case == "phase":
        row, col = (place + 0.1 * np.sin(2 * np.pi * place) for place in (row, col))
    stated = noise_px / 2 if case == "loud" else noise_px
    telemetry = Telemetry(
        frame=np.repeat(np.arange(frames), 2 * stars), exposure=np.tile(np.repeat([0, 1], stars), frames),
        row_px=row + noise_px * rng.normal(size=len(row)), col_px=col + noise_px * rng.normal(size=len(row)),
        star_id=np.arange(1, len(row) + 1),
    )  # fmt: skip
    sensor = replace(
        st16(), camera_model=camera.name, centroid_sigma_px=stated, initial=start, typical_sigma=scale,
        free=camera.parameter_names,
    )  # fmt: skip
    return judged(telemetry, sensor, s_i, truth)


def tangential(truth, names, row, col, rng):
    """Directions through a decentred lens, of 5e-4 either way."""
    lens = CAMERA_MODELS["brown_conrady"]
    x = np.array(lens.plain(7316.0, ROWS / 2, COLUMNS / 2, PITCH))
    for place, name in enumerate(lens.parameter_names):
        if name in names:
            x[place] = truth[names.index(name)]
        if name in ("p1", "p2"):
            x[place] = 5e-4 * rng.choice([-1, 1])
    return lens.directions(x, row, col, PITCH)


def breathing(camera, truth, row, col, frames, rng):
    """Directions through a lens whose focal length swings by 100 ppm."""
    phase, turns = rng.uniform(0, 2 * np.pi), rng.uniform(1.5, 6)
    s = np.empty((frames, len(row) // frames, 3))
    for k, rows in enumerate(np.arange(len(row)).reshape(frames, -1)):
        x = truth.copy()
        x[0] *= 1 + 1e-4 * np.sin(2 * np.pi * turns * k / frames + phase)
        s[k] = camera.directions(x, row[rows], col[rows], PITCH)
    return s.reshape(-1, 3)


def second(camera, truth, row, col, frames, rng):
    """Directions through a lens that is 400 ppm longer in the second exposure of every frame, or in the first."""
    parts = np.arange(len(row)).reshape(frames, 2, -1)
    s = camera.directions(truth, row, col, PITCH)
    other, moved = truth.copy(), parts[:, 1].ravel()
    other[0] *= 1 + 4e-4 * rng.choice([-1, 1])
    s[moved] = camera.directions(other, row[moved], col[moved], PITCH)
    return s


def judged(telemetry, sensor, s_i, truth):
    settings = CalibrationSettings(match="given")
    parameters, problem = select_free_parameters(sensor, settings), make_problem(telemetry, sensor, s_i, 4)
    estimate = run_batch(problem, parameters, settings, lambda *_: None, lambda: False)
    fitted = fit_best(problem, parameters, settings, estimate, telemetry, None)
    departures, _ = find_departures(fitted)
    sums = add_up(fitted, departures)
    scores = {one.name: find_score(sums, one.name) for one in departures}
    tests = [
        SimpleNamespace(name=name, noticed=score.p < UNLIKELY, adjusted=min(1.0, 33 * score.p))
        for name, score in scores.items()
    ]
    error = (estimate.x - truth)[parameters.free] / parameters.scale
    described = find_misfit(fitted, sums, scores, tests)
    return Made(fitted, widen(fitted, sums, scores, tests), described, error)


@pytest.fixture(scope="module")
def decentred():
    found = made("tangential", 2)
    departures, _ = find_departures(found.fitted)
    sums = add_up(found.fitted, departures)
    return found.fitted, sums, {one.name: find_score(sums, one.name) for one in departures}


def _widened(decentred, name, adjusted):
    fitted, sums, scores = decentred
    test = SimpleNamespace(name=name, noticed=adjusted < FAMILY_LEVEL, adjusted=adjusted)
    return find_misfit(fitted, sums, scores, [test])[1]


def test_what_is_suspected_of_a_lens_widens_and_is_not_advised(decentred):
    noticed, suspected, silent = (_widened(decentred, "tangential", p) for p in (1e-9, 0.03, 0.06))
    assert (noticed.departures, noticed.suspected) == (["tangential"], [])
    assert (suspected.departures, suspected.suspected) == (["tangential"], ["tangential"])
    assert (silent.departures, silent.suspected) == ([], [])
    assert suspected.factor == noticed.factor
    assert max(noticed.factor.values()) > 20 > 1.01 * max(silent.factor.values())
    alone = [replace(one, level=1.0) for one in (noticed, suspected, silent)]
    assert [[advice.code for advice in misfit_advice(one)] for one in alone] == [["misfit"], [], []]
    for reason in ({"level": 2.0}, {"bends": True}, {"selected": 2.0}, {"blocks": 24}):
        assert misfit_advice(replace(alone[1], **reason))


def test_what_does_not_stay_with_a_place_widens_only_where_it_is_noticed(decentred):
    assert _widened(decentred, "phase", 0.03).departures == []
    assert _widened(decentred, "phase", 1e-9).departures == ["phase"]


WRONG = ("temperature", "phase", "tangential", "quarter", "loud", "second")


@pytest.mark.parametrize("case", ["clean", *WRONG])
def test_sigmas_with_misfit_are_never_narrower_and_their_matrix_is_a_covariance(case):
    found = made(case, 1, frames=60)
    sigma, misfit = found.described
    free = found.fitted.names
    assert min(misfit.factor[name] for name in free) >= 1 - 1e-9
    excess = found.widening.P - found.fitted.estimate.P
    in_sigma = excess / np.sqrt(np.outer(*2 * [np.diag(found.fitted.estimate.P)]))
    assert np.linalg.eigvalsh(in_sigma).min() > -1e-6
    np.testing.assert_allclose(np.sqrt(np.diag(np.asarray(misfit.covariance))), [sigma[name] for name in free])
    assert misfit.sentence.endswith(".")


@pytest.mark.parametrize(
    ("case", "before"), [("tangential", 100.0), ("phase", 20.0), ("loud", 10.0), ("second", 100.0)]
)
def test_where_the_model_is_wrong_the_error_is_within_the_sigmas_with_misfit(case, before):
    noise, wide = made(case, 2).nees
    assert noise > before
    assert wide < 20.0  # of six or eight: the 99 % point


@pytest.mark.full
@pytest.mark.parametrize("case", WRONG)
def test_nees_with_misfit_is_within_its_bounds_or_below(case):
    sets = [made(case, seed, frames=150) for seed in range(100)]
    dof = len(sets[0].error)
    # no covariance holds a set that is curved, and the product says of it that it is
    wide = np.array([one.nees[1] for one in sets if not one.curved])
    assert len(wide) > (75 if case == "quarter" else 95)
    assert wide.mean() < dof + 3 * np.sqrt(2 * dof / len(wide))
    assert np.sum(wide > 2.5 * dof) <= binom.ppf(0.99, len(wide), chi2.sf(2.5 * dof, dof))


@pytest.mark.full
def test_on_clean_sets_the_sigmas_stay():
    sets = [made("clean", seed, frames=150) for seed in range(100)]
    factors = np.array([np.sqrt(np.diag(one.widening.P) / np.diag(one.fitted.estimate.P)) for one in sets])
    assert factors.mean() < 1.03  # one or two are suspected of a displacement that is not there
    assert np.mean(factors.max(axis=1) > 1.05) < 0.12
    noise, wide = (np.median([one.nees[i] for one in sets]) for i in (0, 1))
    assert wide > 0.97 * noise


def wandering(rng, frames, p, rho):
    """Scores (frames, p) of frames that wander: of unit variance, with correlation rho from one to the next."""
    steps = rng.normal(size=(frames, p))
    for k in range(1, frames):
        steps[k] = rho * steps[k - 1] + np.sqrt(1 - rho**2) * steps[k]
    return steps


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_the_sum_over_blocks_is_the_covariance_of_the_sum_of_scores(rho):
    rng, frames, p = np.random.default_rng(3), 960, 4
    sums, estimated = [], []
    for _ in range(200):
        scores = wandering(rng, frames, p, rho)
        sums.append(scores.sum(axis=0))
        estimated.append(sum_of_squares(scores - scores.mean(axis=0), 24, 10**9))
    true = np.cov(np.array(sums).T)
    mean = np.mean(estimated, axis=0)
    assert np.trace(mean) == pytest.approx(np.trace(true), rel=0.25)
    if rho:  # frames taken one by one would know nothing of it: what follows each other errs alike
        assert np.trace(mean) > 5 * frames * p


@pytest.mark.parametrize("B", [24, 48, 96])
def test_noise_alone_seldom_widens(B):
    rng = np.random.default_rng(B)
    wider = 0
    for _ in range(2000):
        g = rng.normal(size=(B, 8))
        g -= g.mean(axis=0)
        wider += is_wider(g.T @ g / (B - 1), B)
    assert wider < 2000 * 0.02


def test_the_envelope_is_nowhere_narrower_than_either():
    rng = np.random.default_rng(4)
    for _ in range(20):
        P, Q = (a @ a.T + np.eye(5) for a in rng.normal(size=(2, 5, 5)))
        E = _envelope(P, Q)
        assert min(np.linalg.eigvalsh(E - P).min(), np.linalg.eigvalsh(E - Q).min()) > -1e-9
        directions = rng.normal(size=(200, 5))
        widths = [np.einsum("ni,ij,nj->n", directions, one, directions) for one in (E, P, Q)]
        assert (widths[0] <= widths[1] + widths[2]).all()


def test_what_decides_reads_the_sigmas_with_misfit_and_an_older_calibration_its_only_ones():
    old = Calibration(
        status="converged", method="batch", parameters=Values({"f_m": 0.016}), sigma=Values({"f_m": 1e-6}),
        covariance=Covariance(names=["f_m"], matrix=[[1e-12]]),
    )  # fmt: skip
    wide = Covariance(names=["f_m"], matrix=[[9e-12]])
    misfit = ModelMisfit(covariance=wide, factor=Values({"f_m": 3.0}), blocks=0, sentence="")
    new = replace(old, sigma_with_misfit=Values({"f_m": 3e-6}), misfit=misfit)
    assert (old.reliable_sigma["f_m"], new.reliable_sigma["f_m"]) == (1e-6, 3e-6)
    assert read_covariance(old, ["f_m"])[0, 0] == 1e-12
    assert read_covariance(new, ["f_m"])[0, 0] == 9e-12
    assert trend_entry(old).covariance == [[1e-12]]
    assert trend_entry(new).covariance == [[9e-12]]
