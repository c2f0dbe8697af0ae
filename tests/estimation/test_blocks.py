"""Threads and blocks change no bit of a result, and no compiled loop asks for memory frame by frame."""

import dataclasses

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from benchmarks.stars import star_frames, synthetic
from boresight import kernels
from boresight.calibration.matching.rematch import ground_covariance, rematch
from boresight.calibration.options import CalibrationSettings
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation.batch import NormalEquations
from boresight.estimation.blocks import FRAMES, computing_on, in_blocks
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.estimation.metrics import arc_errors
from boresight.estimation.singular_values import APART, DETERMINED
from boresight.kernels.flight import agreeing_matches
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.sky.catalogue import load_catalogue

SENSOR = st16_sensor(1)
X, SCALE, FREE = SENSOR.initial, SENSOR.typical_sigma, np.arange(8)
FEW, MANY = 4, 40


def weigh_values(stars):
    exposures, most = stars.n_exposures, 12
    kernels.factor_values(
        stars.star_start, stars.s_i, np.full(stars.n_stars, 1e-4), 1, np.ones(3, np.bool_), APART, DETERMINED,
        np.full((exposures, most, 3), -1), np.empty((exposures, 3 * most)), np.empty((exposures, 3 * most, 3 * most)),
        np.empty((exposures, 3 * most), np.int64), np.empty((exposures, 2), np.int64),
    )  # fmt: skip


def agree(stars):
    accepted = np.empty(stars.n_stars, np.bool_)
    agreeing_matches(stars.star_start, stars.s_i, stars.s_i, np.ones(stars.n_stars, np.bool_), 1e-4, accepted)


CALLS = {
    "evaluation": lambda stars: batch.normal_equations(stars, X, FREE, SCALE),
    "evaluation with Huber's loss": lambda stars: batch.normal_equations(stars, X, FREE, SCALE, 1.3),
    "square-root filter": lambda stars: FILTERS["sqrf"](stars, start(X, 8, 10.0), FREE, SCALE, Tuning()),
    "unscented filter": lambda stars: FILTERS["ukf"](stars, start(X, 8, 10.0), FREE, SCALE, Tuning()),
    "ordering": lambda stars: arcsets.order(stars.star_start, stars.s_i),
    "weighing": lambda stars: arcsets.whiten(stars, np.full(stars.n_stars, 1e-4)),
    "arc errors": lambda stars: arc_errors(stars, X),
    "singular values": weigh_values,
    "check of the flight code": agree,
}


@pytest.fixture(scope="module")
def counted():
    were_on = _nrt_python.memsys_stats_enabled()
    _nrt_python.memsys_enable_stats()

    def count(run):
        run()
        before = rtsys.get_allocation_stats().alloc
        run()
        return rtsys.get_allocation_stats().alloc - before

    yield count
    if not were_on:
        _nrt_python.memsys_disable_stats()


@pytest.fixture(scope="module")
def stars():
    return synthetic(MANY, np.random.default_rng(3))


@pytest.mark.parametrize("call", CALLS)
def test_more_frames_make_no_more_arrays(counted, stars, call):
    assert MANY < FRAMES, "all frames are in one block"
    few, many = stars.frames(0, FEW), stars
    assert counted(lambda: CALLS[call](many)) == counted(lambda: CALLS[call](few)) > 0


@pytest.mark.parametrize("named", [1.0, 0.5], ids=["named", "half named"])
def test_matching_more_frames_makes_no_more_arrays(counted, named):
    catalogue, P = load_catalogue(None), ground_covariance(SENSOR, 10.0)
    settings = CalibrationSettings(match="rematch")
    made = []
    for frames in (FEW, MANY):
        rng = np.random.default_rng(5)
        measured = star_frames(frames, SENSOR, st16_truth(1), catalogue, rng)
        measured = dataclasses.replace(
            measured, star_id=np.where(rng.random(len(measured)) < named, measured.star_id, 0)
        )
        made.append(counted(lambda measured=measured: rematch(measured, SENSOR, catalogue, X, P, settings, None)))
    assert made[0] == made[1] > 0


@pytest.fixture(scope="module")
def arcs():
    return synthetic(3 * FRAMES + 7, np.random.default_rng(8))


def evaluated(arcs):
    return batch.normal_equations(arcs, X, FREE, SCALE)


def same(one, other):
    return (one.A == other.A).all() and (one.b == other.b).all() and one.chi2 == other.chi2


def test_threads_and_chunks_of_whole_blocks_change_no_bit(arcs):
    alone = evaluated(arcs)
    for threads in (2, 3):
        with computing_on(threads):
            assert same(evaluated(arcs), alone)
    parts = [
        evaluated(arcs.frames(first, min(first + FRAMES, arcs.n_frames))) for first in range(0, arcs.n_frames, FRAMES)
    ]
    assert same(NormalEquations.added(parts, 8), evaluated(arcs))
    sigma = arcsets.angular_sigma(INVERTED_WANG, X, arcs)
    alone, places = arcsets.whiten(arcs, sigma)[0], arcsets.order(arcs.star_start, arcs.s_i)[0]
    with computing_on(2):
        beside = arcsets.whiten(arcs, sigma)[0]
        assert (arcsets.order(arcs.star_start, arcs.s_i)[0] == places).all()
    assert (beside.band == alone.band).all()
    assert (beside.phi == alone.phi).all()


def test_results_come_in_the_order_of_the_blocks_and_an_empty_set_has_none():
    with computing_on(2):
        assert in_blocks(lambda first, last: (first, last), 10, 4) == [(0, 4), (4, 8), (8, 10)]
    assert in_blocks(lambda first, last: (first, last), 0) == []
