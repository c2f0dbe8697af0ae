"""How a filter takes its frames: a pooled start, chunks that double, and a history in constant memory."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.calibration import history_recorder, sequence
from boresight.calibration.calibrate import calibrate
from boresight.calibration.estimate import Parameters
from boresight.calibration.history_recorder import RecordedHistory
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.calibration.sequence import Frames, finished, pool_start, run_sequential, standing_frames
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation.filters.history import FilterHistory, start
from boresight.estimation.metrics import aggregate_rms
from boresight.telemetry.sensors import Sensor
from tests.calibration.sets import measured, sky
from tests.estimation.fields import rotation

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


def test_progress_ends_at_the_last_frame_and_the_filter_as_printed_pools_nothing(problem):
    history = filtered(problem, standing_frames(problem), linearisations=1)
    np.testing.assert_array_equal(history.frame, problem.arcs.frame)
    heard = []
    filtered(problem, standing_frames(problem), heard)
    shares = [share for _, share, _ in heard]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_frames_without_a_usable_star_are_passed_over(field, catalogue):
    gone = np.isin(field.telemetry.frame, [40, 41, 42])
    bare = replace(field.telemetry, star_id=np.where(gone, 0, field.true))
    document = calibrate(bare, field.sensor, catalogue, CalibrationSettings(method="sqrf", match="given")).to_dict()
    assert not {40, 41, 42} & set(document["history"]["frame"])
    assert document["status"] == "converged"


def test_a_filter_that_ended_worse_than_it_began_is_called_diverged(problem):
    parameters = Parameters(FREE, problem.sensor.typical_sigma)
    history = filtered(problem, standing_frames(problem))
    assert finished(problem, parameters, history).status == "converged"
    history.last = replace(history.last, x=problem.sensor.initial * [1.3, 1, 1, 1, 1, 1, 1, 1])
    assert finished(problem, parameters, history).status == "diverged"


PITCH, NOISE_PX, STARS = 6.9e-6, 0.13, 120
#: Eleven degrees corner to corner with hardly any distortion: (m0, a2) and (n0, a1) move stars almost alike.
NARROW = Sensor(
    name="NARROW", rows=768, columns=1024, pixel_pitch_m=PITCH, camera_model="inverted_wang", parity=-1,
    centroid_sigma_px=NOISE_PX, initial=np.array([0.035, 383.5, 511.5, 0.0, 0.0, 0.0, 0.0, 1.0]),
    typical_sigma=np.array([3e-4, 10.0, 10.0, 1e6, 100.0, 5e-3, 5e-3, 2e-4]), free=INVERTED_WANG.parameter_names,
)  # fmt: skip
TRUTH = np.array([0.0353, 401.0, 546.0, 3e5, -89.0, 7e-3, 3e-3, 1.00004])


def dense(seed, frames=5):
    rng = np.random.default_rng(seed)
    n = frames * STARS
    row, col = rng.uniform(0, NARROW.rows - 1, n), rng.uniform(0, NARROW.columns - 1, n)
    s_d = INVERTED_WANG.directions(TRUTH, row, col, PITCH).reshape(-1, STARS, 3)
    return measured(rng, np.concatenate([block @ rotation(rng) for block in s_d]), (row, col), NOISE_PX, frames)


@pytest.fixture
def dense_calibrated(calibrated):
    return lambda seed, method, **chosen: calibrated(dense(seed), NARROW, method=method, match="given", **chosen)


def off(document, other):
    return max(
        abs(document["parameters"][name] - value) / other["sigma"][name] for name, value in other["parameters"].items()
    )


@pytest.mark.full
@pytest.mark.parametrize("method", ["sqrf", "angular", "svd"])
def test_a_few_dense_fields_are_taken_in_at_once_and_end_where_the_batch_does(dense_calibrated, method):
    for seed in (0, 1, 3):
        found, batch = (dense_calibrated(seed, each) for each in (method, "batch"))
        assert off(found, batch) < (1.5 if method == "svd" else 0.3)  # singular values hold a tenth less
        assert "overclaim" not in found["advice_codes"]
        assert "one_update" in found["advice_codes"]
        assert " 5 " in found["advice"][found["advice_codes"].index("one_update")]


def test_taken_one_by_one_they_would_claim_several_times_what_they_hold_and_the_first_update_is_left_time_to_rest(
    dense_calibrated, monkeypatch
):
    monkeypatch.setattr(sequence, "BENT", np.inf)
    found = [dense_calibrated(seed, "svd") for seed in (0, 1, 3)]
    assert any(any("filter claims" in sentence for sentence in document["advice"]) for document in found)
    assert not any("one update" in sentence for document in found for sentence in document["advice"])
    monkeypatch.setattr(sequence, "BENT", np.inf)  # the first frame alone, which takes 15 linearisations
    rested = dense_calibrated(3, "svd")
    allowed = dense_calibrated(3, "svd", linearisations=100)
    monkeypatch.setattr(sequence, "START_LINEARISATIONS", 1)
    stopped = dense_calibrated(3, "svd")
    assert off(rested, allowed) < 0.1
    assert off(stopped, allowed) > 0.3


def test_the_filter_as_printed_still_takes_one_frame_and_linearises_once(dense_calibrated):
    document = dense_calibrated(0, "svd", linearisations=1)
    assert document["iterations"] == 5


def history(n, seed=3):
    rng = np.random.default_rng(seed)
    state = start(np.arange(8.0), 5, 2.0)
    return FilterHistory(
        rng.normal(size=(n, 8)), rng.uniform(size=(n, 5)), rng.chisquare(9, n), rng.integers(5, 20, n),
        rng.uniform(size=n), rng.integers(1, 6, n), state, finite=True,
    )  # fmt: skip


def cut(whole, first, last):
    names = ("states", "sigmas", "nis", "dof", "sum_of_squares", "linearisations")
    return FilterHistory(**{name: getattr(whole, name)[first:last] for name in names}, last=whole.last, finite=True)


def recorded(whole, seams=()):
    edges = [0, *sorted(seams), len(whole.nis)]
    found = RecordedHistory(whole.last)
    for first, last in itertools.pairwise(edges):
        found.append(cut(whole, first, last), 10 * np.arange(first, last))
    return found


@given(st.lists(st.integers(0, 60), max_size=6))
def test_seams_between_its_parts_change_no_bit(seams):
    whole = history(60)
    once, parts = recorded(whole), recorded(whole, seams)
    assert (once.nis_sum, once.dof_sum, once.linearisations_sum) == (
        parts.nis_sum,
        parts.dof_sum,
        parts.linearisations_sum,
    )
    every = np.arange(60)
    assert once.taken(every).tobytes() == parts.taken(every).tobytes()


def test_it_holds_what_the_filter_gave_with_the_running_rms_and_histories_of_some_frames():
    whole = history(50)
    kept = recorded(whole, (7,))
    records = kept.taken(np.array([0, 8, 49]))
    np.testing.assert_array_equal(records["states"], whole.states[[0, 8, 49]])
    np.testing.assert_array_equal(records["frame"], [0, 80, 490])
    running = aggregate_rms(whole.sum_of_squares, whole.dof.astype(float))
    np.testing.assert_array_equal(kept.column("aggregate_rms"), running)
    assert kept.nis_sum == pytest.approx(whole.nis.sum(), rel=1e-14)
    whole = history(40)
    part = recorded(whole).select_frames(np.array([30, 70, 390]))
    assert len(part) == 3
    np.testing.assert_array_equal(part.nis, whole.nis[[3, 7, 39]])


def test_a_long_one_goes_to_a_file_and_reads_the_same(monkeypatch):
    whole = history(500)
    small = recorded(whole)
    monkeypatch.setattr(history_recorder, "IN_MEMORY_BYTES", 4000)
    monkeypatch.setattr(history_recorder, "CHUNK", 64)
    large = recorded(whole, (100, 300))
    assert large._file._rolled
    places = np.array([0, 63, 64, 65, 499])
    assert large.taken(places).tobytes() == small.taken(places).tobytes()


@given(st.sets(st.integers(0, 99), max_size=12), st.sampled_from([7, 64, 1000]))
def test_no_peak_is_lost_between_the_points_that_are_kept(places, chunk):
    whole = history(100)
    places = np.array(sorted(places | {99}))
    kept = recorded(whole)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(history_recorder, "CHUNK", chunk)
        peaks = kept.peaks(places)
    for k, first in enumerate([0, *(places[:-1] + 1)]):
        part = slice(first, places[k] + 1)
        worst = first + int(np.argmax(whole.nis[part] / whole.dof[part]))
        assert (peaks.nis[k], peaks.dof[k], peaks.frame[k]) == (whole.nis[worst], whole.dof[worst], 10 * worst)
        np.testing.assert_array_equal(peaks.low[k], whole.states[part].min(axis=0))
        np.testing.assert_array_equal(peaks.high[k], whole.states[part].max(axis=0))
