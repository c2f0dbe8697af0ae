"""What each reference holds: all pairs as much as the arcs, singular values a little less, and much less without full weights."""

import numpy as np
import pytest

from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import singular_values
from boresight.estimation.singular_values import Selection
from boresight.estimation.statistics import references
from boresight.estimation.statistics.references import (
    View,
    information_content,
    judged,
    observability_of_models,
    observability_of_values,
    relative,
    seen,
)
from tests.estimation.fields import FREE, SCALE, TRUTH, star_field, weighed

VIEW = View(INVERTED_WANG, TRUTH, FREE, SCALE)


@pytest.fixture(scope="module")
def field():
    return weighed(star_field(np.random.default_rng(1), frames=30), TRUTH)


@pytest.fixture(scope="module")
def content(field):
    return information_content(VIEW, field)


def test_all_pairs_hold_what_the_arcs_hold_and_that_is_all_there_is(content):
    assert content.names == ("arcs", "angular", "svd 1", "svd 2", "svd 3", "svd 4")
    np.testing.assert_allclose(content.full[1], content.full[0], rtol=1e-3)
    np.testing.assert_allclose(content.full[0], 1, atol=0.02)


def test_singular_values_hold_nearly_all_of_it_under_every_model(content):
    assert (content.full[2:] < 1.02).all()
    assert (content.full[2:5] > 0.9).all()
    assert (content.full[5] > 0.75).all()  # Model 4 has one number an exposure less


def test_weights_that_leave_out_the_correlation_lose_much_and_claim_more(content):
    assert (content.diagonal[1:] < content.full[1:]).all()
    assert (content.claimed[1:] > content.diagonal[1:]).all()
    assert np.median(content.diagonal[5]) < 0.5
    assert (
        np.median(content.diagonal[1] / content.diagonal[5]) > 1.5
    )  # all pairs beside Model 4, as the paper weighs them
    assert np.isnan(content.diagonal[0]).all()


def test_observability_is_the_smallest_singular_value_of_the_rows_of_a_frame(field):
    plain = np.zeros((3, 4))
    for k in range(3):
        frame = field.frames(k, k + 1)
        s, D = INVERTED_WANG.directions_and_jacobian(TRUTH, frame.row_px, frame.col_px, frame.pitch)
        for model in (1, 2, 3, 4):
            rows = []
            for first, last in zip(frame.star_start, frame.star_start[1:], strict=False):
                stars = slice(first, last)
                selection = Selection(model)
                taken = singular_values.exposure(frame.s_i[stars], np.full(last - first, 6e-5), selection)
                g = singular_values.stacked(s[stars], taken.rows, selection)[1]
                rows.append(np.einsum("rnj,njp->rp", g, D[stars]) * SCALE)
            plain[k, model - 1] = np.linalg.svd(np.concatenate(rows), compute_uv=False)[-1]
    np.testing.assert_allclose(observability_of_models(VIEW, field.frames(0, 3)), plain, rtol=0.02)


def test_the_first_singular_value_observes_least(field):
    alone = observability_of_values(VIEW, field)
    assert (np.median(alone, axis=0)[1:] > 3 * np.median(alone[:, 0])).all()


def test_a_frame_with_fewer_rows_than_parameters_observes_nothing():
    field = weighed(star_field(np.random.default_rng(2), frames=2, mean_stars=1.0), TRUTH)  # four stars an exposure
    assert (np.diff(field.star_start) == 4).all()
    assert (observability_of_values(VIEW, field) == 0).all()  # two combinations of one value, twice
    assert observability_of_models(VIEW, field).shape == (2, 4)


def test_what_does_not_determine_all_parameters_has_no_share():
    assert relative(np.diag([1.0, 0.0]), np.eye(2)).tolist() == [0.0, 0.0]
    assert relative(np.diag([1.0, 0.25]), np.eye(2)).tolist() == [1.0, 0.25]


@pytest.mark.parametrize("most_squares", [1, 1500, 1e9])
def test_the_runs_in_which_frames_are_taken_change_nothing(field, monkeypatch, most_squares):
    monkeypatch.setattr(references, "MOST_SQUARES", most_squares)
    runs = seen(VIEW, field)
    smallest, information = judged(VIEW, runs, Selection(4))
    one_by_one = [judged(VIEW, seen(VIEW, field.frames(k, k + 1)), Selection(4)) for k in range(field.n_frames)]
    assert sum(len(run.frame_start) - 1 for run in runs) == field.n_frames
    np.testing.assert_allclose(smallest, np.concatenate([found[0] for found in one_by_one]), rtol=1e-9)
    np.testing.assert_allclose(information, sum(found[1] for found in one_by_one), rtol=1e-9, atol=1e-6)
