"""Singular values of star combinations and the angles of all pairs: rightly differentiated, honest about what they hold."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from boresight.calibration.options import EITHER_FORM
from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import angular, singular_values
from boresight.estimation.arcs import angular_sigma, arclength, whiten
from boresight.estimation.batch import normal_equations
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.filters.singular import SingularValues
from boresight.estimation.singular_values import APART, CHOSEN, STAR_MODELS, Selection
from boresight.estimation.statistics import references
from boresight.estimation.statistics.consistency import chi_square, nees
from boresight.estimation.statistics.cramer_rao import centroid_rows
from boresight.estimation.statistics.references import (
    EvaluationPoint,
    judged,
    observability_of_models,
    observability_of_values,
    relative,
    seen,
    weighted_information,
    whitened_information,
)
from boresight.kernels.references import decompose_windows
from boresight.kernels.singular import _combinations, _window
from tests.effort import effort
from tests.estimation.fields import (
    FREE,
    GROUND,
    PINHOLE,
    PITCH,
    SCALE,
    SIX,
    START_SIGMA,
    TRUTH,
    WU_COLUMNS,
    WU_PITCH,
    WU_ROWS,
    WU_START,
    WU_TRUTH,
    directions_by_definition,
    rotation,
    star_field,
    whitened,
    wu_field,
    wu_whitened,
)

SIGMA = 1e-4


def _stars(rng, n):
    return INVERTED_WANG.directions(TRUTH, rng.uniform(0, 1943, n), rng.uniform(0, 2591, n), PITCH)


@given(st.integers(0, 10_000), st.integers(3, 30))
def test_no_attitude_and_no_mirror_changes_a_singular_value(seed, n):
    rng = np.random.default_rng(seed)
    s = _stars(rng, n)
    turned = s @ rotation(rng).T * [1, -1, 1]
    np.testing.assert_allclose(
        singular_values.decomposition(turned)[0], singular_values.decomposition(s)[0], rtol=1e-12, atol=1e-12
    )


@given(st.integers(0, 10_000), st.integers(3, 30))
def test_the_squares_add_up_to_the_number_of_stars_so_the_first_adds_nothing(seed, n):
    s = _stars(np.random.default_rng(seed), n)
    sigma, g = singular_values.decomposition(s)[0], singular_values.gradients(s)
    across = g - np.einsum("knj,nj->kn", g, s)[..., None] * s  # directions stay unit vectors
    assume(sigma[2] > 1e-3)
    assert np.sum(sigma**2) == pytest.approx(n, rel=1e-13)
    np.testing.assert_allclose(np.einsum("k,knj->nj", sigma, across), 0, atol=1e-12)


@settings(deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 20))
def test_slopes_are_right_to_central_differences(seed, n):
    rng = np.random.default_rng(seed)
    s = _stars(rng, n)
    sigma = singular_values.decomposition(s)[0]
    assume(min(sigma[1] - sigma[2], sigma[2]) > 0.02)
    step = 1e-5 * rng.normal(size=s.shape)
    ahead, behind = (singular_values.decomposition(s + sign * step)[0] for sign in (1, -1))
    slope = np.einsum("knj,nj->k", singular_values.gradients(s), step)
    np.testing.assert_allclose(slope, (ahead - behind) / 2, atol=1e-9)


def test_slopes_by_a_complex_step_through_the_camera():
    # sqrt(eigenvalue) of the analytic W(x) W(x)^T, by its characteristic polynomial, which complex numbers can go through
    rng = np.random.default_rng(4)
    row, col = rng.uniform(0, 1943, 6), rng.uniform(0, 2591, 6)
    s, D = INVERTED_WANG.directions_and_jacobian(TRUTH, row, col, PITCH)
    sigma = singular_values.decomposition(s)[0]
    analytic = np.einsum("knj,njp->kp", singular_values.gradients(s), D) * SCALE
    for p in range(8):
        x = TRUTH.astype(complex)
        x[p] += 1e-20j * SCALE[p]
        w = np.array(
            [directions_by_definition(INVERTED_WANG, x, *place, PITCH) for place in zip(row, col, strict=True)]
        )
        A = w.T @ w
        for k in range(3):  # d(lambda) = d(det(A - lambda I)) / (product of the gaps), at the real lambda
            lam = sigma[k] ** 2
            others = np.delete(sigma**2, k)
            moved = _determinant(A - lam * np.eye(3)).imag / 1e-20 / np.prod(others - lam)
            assert moved / (2 * sigma[k]) == pytest.approx(analytic[k, p], rel=1e-6, abs=1e-10)


def _determinant(A):
    return A[0] @ np.array([A[1, 1] * A[2, 2] - A[1, 2] ** 2, A[1, 2] * A[0, 2] - A[0, 1] * A[2, 2],
                            A[0, 1] * A[1, 2] - A[1, 1] * A[0, 2]])  # fmt: skip


def test_the_models_combine_the_stars_as_the_paper_draws_them():
    def stars(model):
        windows = singular_values.windows(6, model)
        return [[int(star) + 1 for star in singular_values.members(6, window)] for window in windows]

    listed = {model: stars(model) for model in STAR_MODELS}
    assert listed[1] == [[1, 2, 3], [2, 3, 4], [3, 4, 5], [4, 5, 6], [5, 6, 1], [6, 1, 2]]
    assert listed[2] == listed[1]  # half of six is three
    assert sorted(map(sorted, listed[3])) == [sorted({1, 2, 3, 4, 5, 6} - {left}) for left in range(6, 0, -1)]
    assert listed[4] == [[1, 2, 3], [1, 2, 3, 4], [1, 2, 3, 4, 5], [1, 2, 3, 4, 5, 6]]
    assert len(singular_values.windows(19, 2)[0]) == 2
    assert (singular_values.windows(19, 2)[:, 1] == 9).all()
    assert (singular_values.windows(4, 2)[:, 1] == 3).all()  # two stars span no volume


@pytest.mark.parametrize(
    ("sigma", "values", "rows"),
    [
        ((3.0, 0.4, 0.1), (2, 3), [-1, 0, 1]),
        ((3.0, 0.4, 0.1), (1, 3), [0, -1, 1]),
        ((3.0, 0.400, 0.395), (2, 3), [-1, 0, 0]),  # they meet: only their sum has a derivative
        ((3.0, 0.400, 0.395), (3,), [-1, -1, -1]),
        ((3.0, 0.400, 0.395), (1, 3), [0, -1, -1]),
        ((3.0, 0.4, 0.005), (2, 3), [-1, 0, -1]),  # stars on a great circle
        ((1.005, 1.0, 0.995), (1, 2, 3), [0, 0, 0]),
    ],
)
def test_values_that_meet_are_measured_by_their_sum_or_not_at_all(sigma, values, rows):
    assert singular_values.row_of_value(np.array(sigma), Selection(4, values), 0.01 / APART).tolist() == rows


def test_the_sum_of_two_equal_values_has_a_slope_where_neither_has():
    # three directions at equal angles about the axis: sigma_2 = sigma_3
    azimuth = np.array([0.0, 2 * np.pi / 3, 4 * np.pi / 3])
    s = np.stack([0.1 * np.cos(azimuth), 0.1 * np.sin(azimuth), np.full(3, np.sqrt(0.99))], axis=1)
    step = 1e-6 * np.random.default_rng(5).normal(size=s.shape)
    ahead, behind = (singular_values.decomposition(s + sign * step)[0] for sign in (1, -1))
    slope = np.einsum("knj,nj->k", singular_values.gradients(s), step)
    assert (slope[1] + slope[2]) == pytest.approx((ahead - behind)[1:].sum() / 2, abs=1e-11)
    assert abs((ahead - behind)[1] / 2 - slope[1]) > 1e-8


@pytest.mark.full
@pytest.mark.parametrize("model", STAR_MODELS)
def test_the_covariance_of_overlapping_combinations_is_that_of_many_noisy_exposures(model):
    rng = np.random.default_rng(6)
    s, n, draws = _stars(rng, 7), 7, effort(1200, 4000)
    taken = singular_values.exposure(s, np.full(n, SIGMA), Selection(model))
    noisy = s + SIGMA * rng.normal(size=(draws, n, 3))
    noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
    z = np.array([singular_values.stacked(each, taken.rows, Selection(model))[0] for each in noisy])
    rows = singular_values.determined_rows(taken.R)
    whitened = np.linalg.solve(np.linalg.cholesky(taken.R[np.ix_(rows, rows)]), (z - taken.z)[:, rows].T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(len(rows)), atol=5.5 / np.sqrt(draws))
    assert np.linalg.matrix_rank(taken.R, 1e-8 * taken.R.max()) == min(len(taken.z), 2 * n - 3)


def _last(field, method, tuning, x=TRUTH):
    pooled = pool_start(field, START_ARCS_PER_PARAMETER * 8)
    return FILTERS[method](pooled, start(x, 8, 10.0), FREE, SCALE, tuning)


@pytest.mark.parametrize("noise", [0.0, 0.02], ids=["no-q", "q"])
@pytest.mark.parametrize("linearisations", [1, 6])
@pytest.mark.parametrize("method", EITHER_FORM)
def test_the_gain_form_equals_the_information_form(method, linearisations, noise):
    field = whitened(star_field(np.random.default_rng(7), frames=8, mean_stars=7), GROUND)
    forms = [
        FILTERS[method](field, start(GROUND, 8, 3.0), FREE, SCALE, Tuning(linearisations, noise, 0.99, gain_form=form))
        for form in ("information", "gain")
    ]
    assert np.abs((forms[0].states - forms[1].states) / SCALE / forms[0].sigmas).max() < 1e-8
    np.testing.assert_allclose(forms[1].sigmas, forms[0].sigmas, rtol=1e-8)
    np.testing.assert_allclose(forms[1].nis, forms[0].nis, rtol=1e-7)
    np.testing.assert_array_equal(forms[1].dof, forms[0].dof)


@pytest.mark.few(2)
@pytest.mark.parametrize("model", STAR_MODELS)
def test_every_model_is_consistent_over_many_sets(model):
    errors = []
    nis, dof = 0.0, 0
    for seed in range(effort(12, 25)):
        field = whitened(star_field(np.random.default_rng(700 + seed), frames=60), TRUTH)
        history = _last(field, "svd", Tuning(selection=Selection(model)))
        errors.append(nees((history.last.x - TRUTH) / SCALE, history.last.P))
        nis, dof = nis + history.nis.sum(), dof + int(history.dof.sum())
    bounds = chi_square(sum(errors), 8 * len(errors))
    assert bounds.consistent, (np.mean(errors), 8 * bounds.lower, 8 * bounds.upper)
    assert chi_square(nis, dof).consistent


TWO_OR_MORE = [(2, 3), (1, 2), (1, 3), (1, 2, 3)]
SUBSET_SETS = effort(20, 40)


@pytest.fixture(scope="module")
def ends_of_subsets():
    fields = [wu_whitened(wu_field(np.random.default_rng(seed), frames=60)) for seed in range(SUBSET_SETS)]
    return {
        values: [
            FILTERS["svd"](field, start(WU_TRUTH, 6, 1.0), SIX, START_SIGMA, Tuning(selection=Selection(4, values)))
            for field in fields
        ]
        for values in TWO_OR_MORE
    }


@pytest.mark.few(1)
@pytest.mark.parametrize(("values", "more"), [((1, 2), 0.02), ((1, 3), 0.005), ((1, 2, 3), 0.001)], ids=str)
def test_the_sigmas_are_those_of_the_second_and_third(ends_of_subsets, values, more):
    found, usual = (
        np.mean([history.sigmas[-1] for history in ends_of_subsets[each]], axis=0) for each in (values, (2, 3))
    )
    assert (found / usual < 1 + more).all()
    assert (found / usual > 1 - 0.001).all()


@pytest.mark.parametrize("values", TWO_OR_MORE, ids=str)
def test_every_subset_is_consistent(ends_of_subsets, values):
    errors = [nees((history.last.x - WU_TRUTH) / START_SIGMA, history.last.P) for history in ends_of_subsets[values]]
    bounds = chi_square(sum(errors), 6 * SUBSET_SETS)
    assert bounds.consistent, (6 * bounds.mean, 6 * bounds.lower, 6 * bounds.upper)
    innovations = chi_square(
        *(sum(float(getattr(h, name).sum()) for h in ends_of_subsets[values]) for name in ("nis", "dof"))
    )
    assert innovations.consistent


@pytest.mark.parametrize("values", TWO_OR_MORE, ids=str)
def test_the_scale_of_a_row_decides_nothing(values):
    field = wu_field(np.random.default_rng(1), frames=3)
    for first, last in pairwise(field.star_start):
        R = singular_values.exposure(field.s_i[first:last], np.full(last - first, 4e-5), Selection(4, values)).R
        scale = 2.0 ** np.random.default_rng(2).integers(-10, 10, len(R))
        kept = singular_values.determined_rows(R)
        assert singular_values.determined_rows(R * np.outer(scale, scale)).tolist() == kept.tolist()


def _in_chunks(field, method):
    field = pool_start(field, START_ARCS_PER_PARAMETER * 6)
    first = FILTERS[method](field.frames(0, 1), start(WU_START, 6, 1.0), SIX, START_SIGMA, Tuning())
    return FILTERS[method](field.frames(1, field.n_frames), first.last, SIX, START_SIGMA, Tuning()).last


@pytest.fixture(scope="module")
def ends():
    return [_in_chunks(wu_whitened(wu_field(np.random.default_rng(seed))), "svd") for seed in range(effort(20, 40))]


def test_the_six_parameters_are_found_each_within_four_of_its_sigmas_and_with_an_honest_mean_nees(ends):
    errors = [nees((last.x - WU_TRUTH) / START_SIGMA, last.P) for last in ends]
    bounds = chi_square(sum(errors), 6 * len(errors))
    assert bounds.consistent, (6 * bounds.mean, 6 * bounds.lower, 6 * bounds.upper)
    whitened = [(last.x - WU_TRUTH) / START_SIGMA / np.sqrt(np.diag(last.P)) for last in ends]
    assert np.abs(whitened).max() < 4.2  # of 240


def test_arcs_without_noise_come_out_to_half_an_arc_second_after_a_hundred_frames(ends):
    # criterion A of the paper, 0.465" there after 2,400 frames
    rng = np.random.default_rng(99)
    row, col = rng.uniform(0, WU_ROWS, 40), rng.uniform(0, WU_COLUMNS, 40)
    i, j = np.triu_indices(40, 1)
    true = PINHOLE.directions(WU_TRUTH, row, col, WU_PITCH)
    errors = []
    for last in ends:
        found = PINHOLE.directions(last.x, row, col, WU_PITCH)
        errors.append(np.mean((arclength(found[i], found[j]) - arclength(true[i], true[j])) ** 2))
    assert np.degrees(np.sqrt(np.mean(errors))) * 3600 < 0.7


@given(st.integers(0, 10_000), st.integers(2, 12))
def test_slopes_of_angles_are_right_to_central_differences(seed, n):
    rng = np.random.default_rng(seed)
    s = _stars(rng, n)
    step = 1e-6 * rng.normal(size=s.shape)
    step -= np.sum(step * s, axis=1, keepdims=True) * s
    phi, g = angular.angles(s)
    ahead, behind = (angular.angles(s + sign * step)[0] for sign in (1, -1))
    np.testing.assert_allclose(np.einsum("rnj,nj->r", g, step), (ahead - behind) / 2, atol=1e-10 / phi.min())


@given(st.integers(0, 10_000), st.integers(4, 12))
def test_all_pairs_hold_two_numbers_a_star_less_three(seed, n):
    R = angular.covariance(_stars(np.random.default_rng(seed), n), np.full(n, 1e-4))
    values = np.linalg.eigvalsh(R / R.max())
    assert len(R) == n * (n - 1) // 2
    assert (np.abs(values[: len(R) - 2 * n + 3]) < 1e-12).all()


def test_the_filter_on_all_pairs_ends_where_the_filter_on_arcs_does():
    field = whitened(star_field(np.random.default_rng(3), frames=40), TRUTH)
    field = pool_start(field, START_ARCS_PER_PARAMETER * 8)
    pairs, arcs = (
        FILTERS[method](field, start(TRUTH, 8, 10.0), FREE, SCALE, Tuning()) for method in ("angular", "sqrf")
    )
    np.testing.assert_allclose((pairs.last.x - arcs.last.x) / SCALE / arcs.sigmas[-1], 0, atol=0.02)
    np.testing.assert_allclose(pairs.sigmas[-1], arcs.sigmas[-1], rtol=1e-3)
    np.testing.assert_array_equal(pairs.dof, arcs.dof)
    np.testing.assert_allclose(pairs.nis.sum(), arcs.nis.sum(), rtol=1e-3)


def _gain(field, x, form="gain"):
    return FILTERS["angular"](field, start(x, 8, 3.0), FREE, SCALE, Tuning(gain_form=form))


def test_the_gain_of_turned_rows_is_that_of_all_pairs_and_runs_on_hundreds_of_stars_an_exposure(monkeypatch):
    field = whitened(star_field(np.random.default_rng(5), frames=6, mean_stars=12), GROUND)
    printed = _gain(field, GROUND)
    monkeypatch.setattr("boresight.estimation.filters.angular.MOST_PAIRS", 0)
    turned = _gain(field, GROUND)
    assert np.abs((turned.states - printed.states) / SCALE / printed.sigmas).max() < 1e-8
    np.testing.assert_allclose(turned.sigmas, printed.sigmas, rtol=1e-8)
    np.testing.assert_allclose(turned.nis, printed.nis, rtol=1e-7)
    field = whitened(star_field(np.random.default_rng(4), frames=2, mean_stars=200), TRUTH)
    gain, information = (_gain(field, TRUTH, form) for form in ("gain", "information"))
    assert np.diff(field.star_start).max() > 200  # 20,000 pairs
    assert np.abs((gain.states - information.states) / SCALE / information.sigmas).max() < 1e-8
    np.testing.assert_allclose(gain.sigmas, information.sigmas, rtol=1e-8)


VIEW = EvaluationPoint(INVERTED_WANG, TRUTH, FREE, SCALE)


@dataclass(frozen=True)
class Content:
    """References beside the Cramér-Rao bound, (n_references, n_free): by the full R, by 1 / R_rr alone, and what that claims."""

    names: tuple[str, ...]
    full: np.ndarray
    diagonal: np.ndarray
    claimed: np.ndarray


def information_content(view, arcs):
    bound = centroid_rows(view.camera, view.x, arcs, view.free, view.scale).information
    whitened_arcs, _ = whiten(arcs, angular_sigma(view.camera, view.x, arcs))
    models = [Selection(model, CHOSEN.values) for model in STAR_MODELS]
    full = [
        normal_equations(whitened_arcs, view.x, view.free, view.scale).A,
        *(whitened_information(view, whitened_arcs, one) for one in (None, *models)),
    ]
    weighted = [weighted_information(view, whitened_arcs, one) for one in (None, *models)]
    unknown = np.full(len(view.free), np.nan)
    return Content(
        ("arcs", "angular", *(f"svd {model}" for model in STAR_MODELS)),
        np.stack([relative(A, bound) for A in full]),
        np.stack([unknown, *(relative(true, bound) for true, _ in weighted)]),
        np.stack([unknown, *(relative(claimed, bound) for _, claimed in weighted)]),
    )


@pytest.fixture(scope="module")
def field():
    return whitened(star_field(np.random.default_rng(1), frames=30), TRUTH)


@pytest.fixture(scope="module")
def content(field):
    return information_content(VIEW, field)


def test_all_pairs_hold_what_the_arcs_hold_singular_values_nearly_all_and_diagonal_weights_much_less(content):
    assert content.names == ("arcs", "angular", "svd 1", "svd 2", "svd 3", "svd 4")
    np.testing.assert_allclose(content.full[1], content.full[0], rtol=1e-3)
    np.testing.assert_allclose(content.full[0], 1, atol=0.02)
    assert (content.full[2:] < 1.02).all()
    assert (content.full[2:5] > 0.9).all()
    assert (content.full[5] > 0.75).all()  # Model 4 has one number an exposure less
    assert relative(np.diag([1.0, 0.0]), np.eye(2)).tolist() == [0.0, 0.0]  # what does not determine all has no share
    assert relative(np.diag([1.0, 0.25]), np.eye(2)).tolist() == [1.0, 0.25]
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
    alone = observability_of_values(VIEW, field)  # the first singular value observes least
    assert (np.median(alone, axis=0)[1:] > 3 * np.median(alone[:, 0])).all()


def test_a_frame_with_fewer_rows_than_parameters_observes_nothing():
    field = whitened(star_field(np.random.default_rng(2), frames=2, mean_stars=1.0), TRUTH)  # four stars an exposure
    assert (np.diff(field.star_start) == 4).all()
    assert (observability_of_values(VIEW, field) == 0).all()  # two combinations of one value, twice
    assert observability_of_models(VIEW, field).shape == (2, 4)


@pytest.mark.parametrize("most_squares", [1, 1500, 1e9])
def test_the_runs_in_which_frames_are_taken_change_nothing(field, monkeypatch, most_squares):
    monkeypatch.setattr(references, "MOST_SQUARES", most_squares)
    runs = seen(VIEW, field)
    smallest, information = judged(VIEW, runs, [Selection(4)])
    one_by_one = [judged(VIEW, seen(VIEW, field.frames(k, k + 1)), [Selection(4)]) for k in range(field.n_frames)]
    assert sum(len(run.frame_start) - 1 for run in runs) == field.n_frames
    np.testing.assert_allclose(smallest, np.concatenate([found[0] for found in one_by_one], axis=1), rtol=1e-9)
    np.testing.assert_allclose(information, sum(found[1] for found in one_by_one), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("model", STAR_MODELS)
@pytest.mark.parametrize("n", [3, 7, 12, 19])
def test_windows_decomposed_together_have_the_singular_values_and_vectors_of_each(model, n):
    s = _stars(np.random.default_rng(n), n)
    prefix = np.zeros((n + 1, 6))
    prefix[1:] = np.cumsum((s[:, :, None] * s[:, None, :])[:, *np.triu_indices(3)], axis=0)
    value, P = np.empty((n, 3)), np.empty((n, 3, 3))
    decompose_windows(prefix, n, model, np.empty(120), value, P)
    for c in range(_combinations(n, model)):
        first, size = _window(n, model, c)
        W = s[np.arange(first, first + size) % n].T
        np.testing.assert_allclose(value[c] ** 2, np.linalg.eigvalsh(W @ W.T)[::-1], atol=1e-14 * n)
        np.testing.assert_allclose(P[c] @ np.diag(value[c] ** 2) @ P[c].T, W @ W.T, atol=1e-14 * n)
        np.testing.assert_allclose(P[c].T @ P[c], np.eye(3), atol=1e-14)


@pytest.mark.parametrize("noise_px", [0.1, 40.0])  # values that lie apart, and some that noise does not tell apart
@pytest.mark.parametrize("free", [FREE, FREE[[0, 4, 7]]])
def test_selections_judged_together_hold_what_each_holds_by_the_loops_of_the_filter(field, noise_px, free):
    view = replace(VIEW, free=free, scale=SCALE[free])
    field = whitened(replace(field, sigma_px=np.full(field.n_stars, noise_px)), TRUTH)
    chosen = [
        *(Selection(model) for model in STAR_MODELS),
        *(Selection(4, k) for k in ((1,), (2,), (3,), (1, 2, 3), (1, 2))),
    ]
    smallest, information = judged(view, seen(view, field), chosen, unmeasured=[chosen[-1]])
    assert np.isnan(smallest[-1]).all()
    for place, selection in enumerate(chosen):
        (run,) = seen(view, field)
        filtered = SingularValues(selection, view.free, view.scale)
        filtered.whiten(run.star_start, run.s_i, run.sigma_rad)
        _, H = filtered.rows(run.s, run.D)
        np.testing.assert_allclose(information[place], H.T @ H, rtol=1e-9, atol=1e-9 * np.abs(H.T @ H).max())
        _, rows = filtered.unwhitened(run.s, run.D)
        of_frames = [rows[first:last].reshape(-1, len(free)) for first, last in pairwise(run.frame_start)]
        enough = [(H != 0).any(axis=1).sum() >= len(free) for H in of_frames]
        plain = np.where(enough, [np.linalg.svd(H, compute_uv=False)[-1] for H in of_frames], 0.0)
        if selection != chosen[-1]:
            np.testing.assert_allclose(smallest[place], plain, rtol=1e-8, atol=1e-14)
