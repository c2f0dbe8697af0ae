"""A forgetting factor carries a fixed share of the information from frame to frame, in every filter alike, and follows drift."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.estimation import batch
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from tests.estimation.fields import FREE, GROUND, SCALE, TRUTH, star_field, weighed

FOCAL = np.array([0])


def _filtered(arcs, tuning, method="sqrf", free=FOCAL, spread=1.0):
    return FILTERS[method](arcs, start(TRUTH, len(free), spread), free, SCALE[free], tuning)


@pytest.mark.parametrize("method", sorted(FILTERS))
def test_the_information_is_the_geometric_sum_over_frames(method):
    arcs = weighed(star_field(np.random.default_rng(1), frames=60), TRUTH)
    share = 0.9
    claimed = np.linalg.inv(_filtered(arcs, Tuning(forgetting=share), method, FREE, 0.1).last.P)
    held = 100.0 * np.eye(8) * share**60
    for k in range(60):
        frame = batch.normal_equations(arcs.frames(k, k + 1), TRUTH, FREE, SCALE)
        held += share ** (59 - k) * frame.A
    # the filter linearises where it stands, not at the truth
    assert np.linalg.eigvals(np.linalg.solve(held, claimed)).real == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("method", sorted(FILTERS))
def test_a_constant_parameter_comes_to_rest_at_the_information_of_that_many_frames(method):
    arcs = weighed(star_field(np.random.default_rng(2), frames=300), TRUTH)
    a_frame = batch.normal_equations(arcs, TRUTH, FOCAL, SCALE[FOCAL]).A[0, 0] / 300
    sigmas = _filtered(arcs, Tuning(forgetting=0.9), method).sigmas[100:, 0]
    assert np.mean(sigmas**-2) == pytest.approx(a_frame * 10, rel=0.05)


@pytest.mark.parametrize("tuning", [Tuning(forgetting=0.97), Tuning(forgetting=0.95, process_noise=0.03)], ids=str)
def test_the_filters_agree_on_what_they_forget(tuning):
    arcs = weighed(star_field(np.random.default_rng(3), frames=50), GROUND)
    sqrf, ekf, ukf = (_filtered(arcs, tuning, method, FREE).last for method in ("sqrf", "ekf", "ukf"))
    np.testing.assert_allclose(sqrf.P, ekf.P, atol=1e-8 * np.abs(ekf.P).max())
    sigma = np.sqrt(np.diag(ekf.P))
    np.testing.assert_allclose((sqrf.z - ekf.z) / sigma, 0, atol=1e-6)
    np.testing.assert_allclose((ukf.z - ekf.z) / sigma, 0, atol=0.25)


def test_errors_are_spread_as_least_squares_with_fading_weights_has_them():
    # a frame m frames old weighs lambda^m, so the error variance is (1 - lambda) / (1 + lambda) frames and the claim 1 - lambda
    share, squares = 0.8, []
    for seed in range(25):
        arcs = weighed(star_field(np.random.default_rng(40 + seed), frames=120), TRUTH)
        history = _filtered(arcs, Tuning(forgetting=share))
        errors = (history.states[39::20, 0] - TRUTH[0]) / SCALE[0] / history.sigmas[39::20, 0]
        squares.append(np.mean(errors**2))
    spread = np.mean(squares)
    # 125 nearly independent errors: their mean square is known to 13 % (one sigma)
    assert spread == pytest.approx(1 / (1 + share), rel=0.4)


@pytest.mark.parametrize(
    "tuning", [Tuning(process_noise=0.03), Tuning(forgetting=0.9)], ids=["small process noise", "forgetting"]
)
@pytest.mark.parametrize("method", sorted(FILTERS))
def test_a_drifting_focal_length_is_followed_and_lags_where_nothing_is_forgotten(method, tuning):
    frames, a_frame = 120, 0.02 * SCALE[0]
    parts = []
    for k in range(frames):
        truth = TRUTH.copy()
        truth[0] += k * a_frame
        parts.append(weighed(star_field(np.random.default_rng([7, k]), frames=1, truth=truth), truth))
    arcs = _joined(parts)
    end = TRUTH[0] + (frames - 1) * a_frame
    follows, lags = (_filtered(arcs, choice, method) for choice in (tuning, Tuning()))
    assert abs(follows.last.x[0] - end) / SCALE[0] < 5 * follows.sigmas[-1, 0]
    assert abs(lags.last.x[0] - end) / SCALE[0] > 10 * lags.sigmas[-1, 0]


def _joined(parts):
    arrays = ("row_px", "col_px", "sigma_px", "s_i", "source_row", "phi", "band")
    stars = np.concatenate([[0], *(np.diff(part.star_start) for part in parts)]).cumsum()
    return replace(
        parts[0],
        frame=np.arange(len(parts)),
        frame_start=2 * np.arange(len(parts) + 1),
        star_start=stars,
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays},
    )
