"""No compiled loop asks for memory frame by frame: one call makes its space once, however many frames it is given."""

import dataclasses

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from benchmarks.stars import star_frames, synthetic
from boresight import kernels
from boresight.calibration.matching.rematch import ground_covariance, rematch
from boresight.calibration.options import CalibrationSettings
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation.blocks import FRAMES
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


def weigh_values(arcs):
    exposures, most = arcs.n_exposures, 12
    kernels.factor_values(
        arcs.star_start, arcs.s_i, np.full(arcs.n_stars, 1e-4), 1, np.ones(3, np.bool_), APART, DETERMINED,
        np.full((exposures, most, 3), -1), np.empty((exposures, 3 * most)), np.empty((exposures, 3 * most, 3 * most)),
        np.empty((exposures, 3 * most), np.int64), np.empty((exposures, 2), np.int64),
    )  # fmt: skip


def agree(arcs):
    accepted = np.empty(arcs.n_stars, np.bool_)
    agreeing_matches(arcs.star_start, arcs.s_i, arcs.s_i, np.ones(arcs.n_stars, np.bool_), 1e-4, accepted)


CALLS = {
    "evaluation": lambda arcs: batch.normal_equations(arcs, X, FREE, SCALE),
    "evaluation with Huber's loss": lambda arcs: batch.normal_equations(arcs, X, FREE, SCALE, 1.3),
    "square-root filter": lambda arcs: FILTERS["sqrf"](arcs, start(X, 8, 10.0), FREE, SCALE, Tuning()),
    "unscented filter": lambda arcs: FILTERS["ukf"](arcs, start(X, 8, 10.0), FREE, SCALE, Tuning()),
    "ordering": lambda arcs: arcsets.order(arcs.star_start, arcs.s_i),
    "weighing": lambda arcs: arcsets.whiten(arcs, np.full(arcs.n_stars, 1e-4)),
    "arc errors": lambda arcs: arc_errors(arcs, X),
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
def arcs():
    return synthetic(MANY, np.random.default_rng(3))


@pytest.mark.parametrize("call", CALLS)
def test_more_frames_make_no_more_arrays(counted, arcs, call):
    assert MANY < FRAMES, "all frames are in one block"
    few, many = arcs.frames(0, FEW), arcs
    assert counted(lambda: CALLS[call](many)) == counted(lambda: CALLS[call](few)) > 0


@pytest.mark.parametrize("named", [1.0, 0.5], ids=["named", "half named"])
def test_matching_more_frames_makes_no_more_arrays(counted, named):
    catalogue, P = load_catalogue(None), ground_covariance(SENSOR, 10.0)
    settings = CalibrationSettings(match="rematch")
    made = []
    for frames in (FEW, MANY):
        rng = np.random.default_rng(5)
        stars = star_frames(frames, SENSOR, st16_truth(1), catalogue, rng)
        stars = dataclasses.replace(stars, star_id=np.where(rng.random(len(stars)) < named, stars.star_id, 0))
        made.append(counted(lambda stars=stars: rematch(stars, SENSOR, catalogue, X, P, settings, None)))
    assert made[0] == made[1] > 0
