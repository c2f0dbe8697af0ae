"""How a filter takes its frames: a pooled start, chunks that double, each matched with the state before it."""

from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration import sequence
from boresight.calibration.calibrate import calibrate
from boresight.calibration.estimate import Parameters
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.calibration.sequence import Frames, finished, pool_start, run_sequential, standing_frames
from tests.calibration.rematched import sky

FREE = np.arange(8)


@pytest.fixture(scope="module")
def field(catalogue):
    return sky(catalogue, 3, 90)


@pytest.fixture(scope="module")
def problem(field, catalogue):
    return build_problem(field.telemetry, field.sensor, catalogue)


def listened(problem):
    asked = []

    def arcs(first, last, state):
        asked.append((first, last, state.x))
        return problem.arcs.frames(first, last)

    return Frames(problem.arcs.frame, arcs), asked


def filtered(problem, frames, heard=None, **settings):
    chosen = CalibrationSettings(method="sqrf", **settings)
    parameters = Parameters(FREE, problem.sensor.typical_sigma)
    listen = (lambda *_: None) if heard is None else lambda *told: heard.append(told)
    return run_sequential(frames, problem, parameters, chosen, listen, lambda: False)


def test_every_frame_is_asked_for_once_and_in_order_after_the_pooled_start(problem):
    (frames, asked), n = listened(problem), len(problem.arcs.frame)
    filtered(problem, frames)
    chunks = [(first, last) for first, last, _ in asked if first > 0]
    assert [last for _, last in chunks[:-1]] == [first for first, _ in chunks[1:]]
    assert chunks[-1][1] == n
    assert max(last - first for first, last in chunks) <= max(1, n // sequence.CHUNKS)


def test_each_chunk_is_taken_at_the_state_that_the_frames_before_it_left(problem):
    frames, asked = listened(problem)
    history = filtered(problem, frames)
    updated = history.frame
    for first, _, x in (chunk for chunk in asked if chunk[0] > 0):
        before = np.searchsorted(updated, problem.arcs.frame[first]) - 1
        np.testing.assert_allclose(x, history.states[before])


def test_the_start_pools_as_many_frames_as_hold_the_arcs_it_needs(problem):
    wanted = sequence.START_ARCS_PER_PARAMETER * 8
    pooled = pool_start(problem.arcs, wanted)
    first = pooled.frames(0, 1)
    fewer = problem.arcs.frames(0, int(np.searchsorted(problem.arcs.frame, first.frame[0])))
    assert 2 * first.n_stars - 3 * first.n_exposures >= wanted
    assert 2 * fewer.n_stars - 3 * fewer.n_exposures < wanted
    assert pooled.n_stars == problem.arcs.n_stars


def test_the_filter_as_printed_pools_nothing(problem):
    history = filtered(problem, standing_frames(problem), linearisations=1)
    np.testing.assert_array_equal(history.frame, problem.arcs.frame)


def test_frames_without_a_usable_star_are_passed_over(field, catalogue):
    gone = np.isin(field.telemetry.frame, [40, 41, 42])
    bare = replace(field.telemetry, star_id=np.where(gone, 0, field.true))
    document = calibrate(bare, field.sensor, catalogue, CalibrationSettings(method="sqrf", match="given"))
    assert not {40, 41, 42} & set(document["history"]["frame"])
    assert document["status"] == "converged"


def test_progress_ends_at_the_last_frame(problem):
    heard = []
    filtered(problem, standing_frames(problem), heard)
    shares = [share for _, share, _ in heard]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_filter_that_ended_worse_than_it_began_is_called_diverged(problem):
    parameters = Parameters(FREE, problem.sensor.typical_sigma)
    history = filtered(problem, standing_frames(problem))
    assert finished(problem, parameters, history).status == "converged"
    history.last = replace(history.last, x=problem.sensor.initial * [1.3, 1, 1, 1, 1, 1, 1, 1])
    assert finished(problem, parameters, history).status == "diverged"
