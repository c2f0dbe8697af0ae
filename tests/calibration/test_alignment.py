"""The rotation that new parameters bring along: its size, its sense, its errors, and the C_SD that nulls it."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from boresight.calibration.evaluation.alignment import (
    ARCSEC_PER_RAD,
    Alignment,
    align,
    alignment_view,
    sensitivity,
    sentence,
)
from boresight.calibration.problem import Problem
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import batch
from boresight.estimation.arcs import angular_sigma
from boresight.estimation.attitude import (
    attitudes,
    mean_rotation,
    to_matrix,
    to_quaternion,
    turns_from,
    vector_to_quaternion,
)
from tests.effort import effort
from tests.estimation.fields import FREE, GROUND, NOISE_PX, PITCH, SCALE, TRUTH, star_field

KNOWN = np.zeros((8, 8))


@pytest.fixture
def problem_of(sensor):
    def problem(seed, frames=40, noise_px=NOISE_PX, parity=1):
        arcs = star_field(np.random.default_rng(seed), frames=frames, noise_px=noise_px)
        arcs = arcs if parity == 1 else replace(arcs, s_i=arcs.s_i * [1, -1, 1])
        return Problem(replace(sensor, parity=parity), arcs, None, frames, ())

    return problem


@pytest.fixture
def population(problem_of):
    return align(problem_of(1, 4000, 0.0), GROUND, TRUTH, KNOWN)


def attitudes_under(problem, x):
    arcs = problem.arcs
    s_d = INVERTED_WANG.directions(x, arcs.row_px, arcs.col_px, PITCH)
    sigma = angular_sigma(INVERTED_WANG, GROUND, arcs)
    return attitudes(arcs.star_start, s_d, arcs.s_i, sigma, problem.sensor.parity)


@pytest.mark.parametrize("parity", [1, -1])
def test_with_the_update_of_c_sd_the_sensor_attitude_stays_on_average(problem_of, parity):
    problem = problem_of(2, parity=parity)
    found = align(problem, GROUND, TRUTH, KNOWN)
    old, new = attitudes_under(problem, GROUND), attitudes_under(problem, TRUTH)
    C_sd_old = to_matrix(np.array([0.1, -0.3, 0.2, 0.9]))
    C_sd_new = C_sd_old @ found.c_sd_update
    moved = to_quaternion((C_sd_new @ new.C) @ np.swapaxes(C_sd_old @ old.C, 1, 2))
    weights = 1 / np.trace(new.covariance, axis1=1, axis2=2)
    left = turns_from(np.array([0.0, 0, 0, 1]), mean_rotation(moved, weights)[None])[0]
    assert np.linalg.norm(found.rotation) * ARCSEC_PER_RAD > 5000
    assert np.linalg.norm(left) * ARCSEC_PER_RAD < 1e-5


@pytest.mark.parametrize("parity", [1, -1])
def test_a_shift_of_the_principal_point_turns_about_the_axis_it_must(problem_of, parity):
    shifted = TRUTH.copy()
    shifted[1] -= 10.0
    theta = align(problem_of(3, parity=parity), TRUTH, shifted, KNOWN).rotation
    assert theta[1] == pytest.approx(10.0 * PITCH / TRUTH[0], rel=0.05)
    assert abs(theta[0]) < 0.02 * theta[1]


def test_the_sensitivity_is_what_differences_of_attitudes_show(problem_of):
    problem = problem_of(4, 150)
    J = sensitivity(problem, TRUTH, angular_sigma(INVERTED_WANG, TRUTH, problem.arcs))
    for p in range(8):
        step = 1e-2 * SCALE[p] * np.eye(8)[p]
        difference = align(problem, TRUTH - step, TRUTH + step, KNOWN).rotation / 2e-2
        # the weights of the differences move a little with the state
        np.testing.assert_allclose(J[:, p] * SCALE[p], difference, atol=1e-3 * np.abs(J * SCALE).max())


def test_the_turn_between_ground_and_estimate_is_as_uncertain_as_it_says(problem_of, population):
    nees, runs = [], effort(30, 120)
    for seed in range(100, 100 + runs):
        problem = problem_of(seed)
        fit = batch.fit(problem.whitened(TRUTH), TRUTH, FREE, SCALE)
        found = align(problem, GROUND, fit.x, np.linalg.inv(fit.A) * np.outer(SCALE, SCALE))
        error = turns_from(population.quaternion, found.quaternion[None])[0]
        nees.append(error @ np.linalg.solve(found.covariance, error))
    # ten stretches give the scatter's part of the covariance nine degrees of freedom, hence the wider upper bound
    assert chi2.ppf(0.005, 3 * runs) < np.sum(nees) < 1.25 * chi2.ppf(0.995, 3 * runs)


def test_the_mean_of_a_set_scatters_as_it_says(problem_of, population):
    sets = effort(75, 300)
    found = [align(problem_of(seed), GROUND, TRUTH, KNOWN) for seed in range(400, 400 + sets)]
    errors = np.array([turns_from(population.quaternion, one.quaternion[None])[0] for one in found])
    claimed = np.mean([one.covariance_of_mean for one in found], axis=0)
    whiten = np.linalg.inv(np.linalg.cholesky(claimed))
    np.testing.assert_allclose(whiten @ np.cov(errors.T) @ whiten.T, np.eye(3), atol=0.3 * (300 / sets) ** 0.5)
    assert np.mean([one.consistent for one in found]) > 0.95


def test_frames_that_share_their_stars_are_not_counted_as_independent(problem_of):
    alone = problem_of(5, 20)
    arcs = alone.arcs
    stars = np.concatenate([np.tile(np.arange(*arcs.star_start[[2 * k, 2 * k + 2]]), 8) for k in range(20)])
    counts = np.concatenate([np.tile(np.diff(arcs.star_start)[2 * k : 2 * k + 2], 8) for k in range(20)])
    arrays = {name: getattr(arcs, name)[stars] for name in ("row_px", "col_px", "sigma_px", "s_i", "source_row")}
    held = replace(
        arcs, **arrays, frame=np.arange(160), frame_start=np.arange(0, 321, 2), star_start=np.append(0, counts.cumsum())
    )
    long = align(replace(alone, arcs=held), GROUND, TRUTH, KNOWN)
    np.testing.assert_allclose(
        long.covariance_of_mean, align(alone, GROUND, TRUTH, KNOWN).covariance_of_mean, rtol=1e-6, atol=1e-18
    )


def test_a_set_whose_second_half_turns_otherwise_is_not_consistent(problem_of):
    problem = problem_of(6, 100, 0.01)
    arcs = problem.arcs
    moved = replace(arcs, row_px=arcs.row_px.copy())
    late = np.arange(len(arcs.row_px)) > len(arcs.row_px) // 2
    moved.row_px[late] = 0.3 * arcs.row_px[late]  # another part of the detector, where the distortion turns otherwise
    assert not align(replace(problem, arcs=moved), GROUND, TRUTH, KNOWN).consistent


def test_the_same_parameters_turn_nothing_and_one_frame_has_no_scatter_and_so_no_alignment(problem_of):
    view = alignment_view(problem_of(7), TRUTH, TRUTH, KNOWN)
    assert np.abs(view["rotation_arcsec"]).max() < 1e-6
    assert view["consistent"]
    assert "C_SD may stay" in view["sentence"]
    np.testing.assert_allclose(view["c_sd_update"], np.eye(3), atol=1e-12)
    assert alignment_view(problem_of(8, 1), GROUND, TRUTH, KNOWN) is None


def test_the_view_holds_the_numbers_that_its_sentence_says_and_open_sigmas_where_parameters_are_undetermined(
    problem_of,
):
    problem = problem_of(9)
    view = alignment_view(problem, GROUND, TRUTH, np.diag((0.1 * SCALE) ** 2))
    assert view["frames"] == 40
    np.testing.assert_allclose(to_matrix(np.array(view["quaternion"])).T, view["c_sd_update"], atol=1e-15)
    assert (np.array(view["sigma_arcsec"]) > view["sigma_of_mean_arcsec"]).all()
    assert f"{np.linalg.norm(view['rotation_arcsec']):.0f}"[:3] in view["sentence"]
    assert "multiply C_SD from the right" in view["sentence"]
    view = alignment_view(problem_of(10), GROUND, TRUTH, np.full((8, 8), np.nan))
    assert view["sigma_arcsec"] == [None] * 3
    assert "another such calibration" not in view["sentence"]


@pytest.mark.parametrize(
    ("theta", "words"),
    [
        ([0.0, -1e-3, 0.0], "206.3 ± 2.1 arcsec about -y (the columns axis)"),
        ([1e-3, 1e-3, 0.0], "291.7 ± 2.1 arcsec about (0.71, 0.71, 0.00) in x, y, z of the detector"),
    ],
)
def test_the_axis_is_named(theta, words):
    P = np.eye(3) * 1e-10
    found = Alignment(vector_to_quaternion(np.array(theta)), P, P, 1e-4, 1e-4, 30, consistent=True)
    assert words in sentence(found)


def test_twenty_thousand_frames_take_well_under_a_second(problem_of):
    problem = problem_of(11, 20)
    arcs = problem.arcs
    arrays = {name: np.concatenate([getattr(arcs, name)] * 1000) for name in ("row_px", "col_px", "sigma_px", "s_i")}
    starts = np.append(0, np.tile(np.diff(arcs.star_start), 1000).cumsum())
    many = replace(arcs, **arrays, frame=np.arange(20_000), frame_start=np.arange(0, 40_001, 2), star_start=starts)
    began = time.process_time()
    align(replace(problem, arcs=many), GROUND, TRUTH, KNOWN)
    assert time.process_time() - began < 2.0  # 0.5 s on a free core; twice two threads may be counted
