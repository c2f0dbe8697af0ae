"""Covariance after further frames: the joined form against frames taken one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.estimation.statistics.observability import further_covariance


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


def test_without_noise_information_adds_up():
    a, P = _problem(1)
    found = further_covariance(P, a, 1000)
    np.testing.assert_allclose(np.linalg.inv(found), np.linalg.inv(P) + 1000 * a, rtol=1e-8)


def test_with_noise_a_million_frames_end_where_a_thousand_do():
    a, P = _problem(2)
    np.testing.assert_allclose(further_covariance(P, a, 1_000_000, 0.1), further_covariance(P, a, 5000, 0.1), rtol=1e-9)


@pytest.mark.parametrize("forgetting", [0.5, 0.9])
def test_with_forgetting_a_million_frames_end_where_a_thousand_do(forgetting):
    a, P = _problem(3)
    few, many = (further_covariance(P, a, frames, 0.1, forgetting) for frames in (1_000, 1_000_000))
    np.testing.assert_allclose(many, few, rtol=1e-9)


def test_a_direction_that_no_frame_tells_of_keeps_its_sigma():
    a = np.diag([1.0, 0.0])
    found = further_covariance(np.diag([4.0, 9.0]), a, 100)
    assert found[1, 1] == pytest.approx(9.0)
    assert found[0, 0] == pytest.approx(1 / 100.25)
