"""A set under a state: what is matched, what the flight rule keeps of it, and how sure the parameters are taken to be."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.estimate import Parameters, run_batch
from boresight.calibration.matching.matched import Dataset
from boresight.calibration.matching.rematch import Rematcher
from boresight.calibration.options import CalibrationSettings
from boresight.estimation.filters.history import start
from tests.calibration.rematched import sky

ALL = np.arange(8)


@pytest.fixture(scope="module")
def field(catalogue):
    return sky(catalogue, 4, 24)


def matched_set(field, telemetry, free=ALL, **settings):
    parameters = Parameters(free, field.sensor.typical_sigma[free])
    return Dataset(telemetry, field.sensor, field.catalogue, parameters, CalibrationSettings(**settings), None)


def fitted(field, sets, free=ALL):
    problem = sets.at_start().problem
    parameters = Parameters(free, field.sensor.typical_sigma[free])
    return run_batch(problem, parameters, CalibrationSettings(), lambda *_: None, lambda: False), problem


def asked(monkeypatch):
    calls, real = [], Rematcher.__call__

    def listening(self, x, P, frames=slice(None), noise=1.0):
        calls.append((x, P, noise))
        return real(self, x, P, frames, noise)

    monkeypatch.setattr(Rematcher, "__call__", listening)
    return calls


def test_given_matches_stand_under_every_state(field):
    sets = matched_set(field, field.blanked(0.4), match="given")
    first = sets.at_start()
    assert sets.stands
    assert sets.at_covariance(field.x * 1.01, np.eye(8)) is first
    assert first.problem.arcs.n_stars <= (field.blanked(0.4).star_id > 0).sum()


def test_at_the_start_the_parameters_are_as_sure_as_the_ground_calibration(field, monkeypatch):
    calls = asked(monkeypatch)
    matched_set(field, field.blanked(0.4), initial_sigma_scale=7.0).at_start()
    np.testing.assert_allclose(calls[0][1], np.diag((7.0 * field.sensor.typical_sigma) ** 2))


def test_parameters_held_fixed_stay_as_unsure_as_on_the_ground(field, monkeypatch):
    free = np.array([0, 3, 4])
    sets = matched_set(field, field.blanked(0.4), free)
    calls = asked(monkeypatch)
    sets.at_covariance(field.x, 0.01 * np.eye(3))
    variance = np.diag(calls[0][1]) / field.sensor.typical_sigma**2
    np.testing.assert_allclose(variance[free], 0.01)
    np.testing.assert_allclose(np.delete(variance, free), 100.0)


def test_residuals_larger_than_claimed_widen_noise_and_covariance_alike(field, monkeypatch):
    telemetry = replace(field.blanked(0.2), sigma_px=None)
    sets = matched_set(replace(field, sensor=replace(field.sensor, centroid_sigma_px=0.2)), telemetry)
    estimate, problem = fitted(field, sets)
    calls = asked(monkeypatch)
    sets.at(estimate, problem)
    (_, P, noise), scale = calls[0], field.sensor.typical_sigma
    assert noise == pytest.approx(0.437 / 0.2, rel=0.1)
    held = np.linalg.inv(estimate.A + np.eye(8) / 100)
    np.testing.assert_allclose(P / np.outer(scale, scale), noise**2 * held, rtol=1e-9)


def test_residuals_as_claimed_widen_hardly_anything_and_smaller_ones_nothing(field, monkeypatch):
    sets = matched_set(field, field.blanked(0.2))
    estimate, problem = fitted(field, sets)
    calls = asked(monkeypatch)
    sets.at(estimate, problem)
    sets.at(replace(estimate, chi2=0.1 * estimate.chi2), problem)
    assert calls[0][2] == pytest.approx(1.0, abs=0.1)
    assert calls[1][2] == 1.0


def test_the_flight_rule_keeps_fewer_stars_at_the_ground_than_the_statistical_and_as_many_when_refined(
    field, catalogue
):
    for sky_, low, high in ((field, 0.0, 0.6), (sky(catalogue, 4, 24, start="refined"), 0.97, 1.0)):
        counts = []
        for rule in ("flight", "statistical"):
            sets = matched_set(sky_, sky_.blanked(0.2), match_rule=rule)
            matched = sets.at_covariance(sky_.x, sky_.P / np.outer(*[sky_.sensor.typical_sigma] * 2))
            counts.append(matched.problem.arcs.n_stars)
            # what was matched before the check is kept for the record
            assert (matched.matches.star_id > 0).sum() >= (matched.telemetry.star_id > 0).sum()
        assert low <= counts[0] / counts[1] <= high


def test_frames_matched_one_by_one_are_those_of_the_whole_set(field):
    sets = matched_set(field, field.blanked(0.3))
    frames, state = sets.frames(), start(field.sensor.initial, 8, 10.0)
    parts = [frames.arcs(k, k + 1, state) for k in range(frames.n_frames)]
    whole = sets.at_start().problem.arcs
    assert sum(part.n_stars for part in parts) == whole.n_stars
    np.testing.assert_allclose(np.concatenate([part.s_i for part in parts]), whole.s_i)
    np.testing.assert_array_equal(np.concatenate([part.frame for part in parts]), whole.frame)
