"""The number of threads changes no bit of a result, and neither do chunks of whole blocks."""

import numpy as np
import pytest

from benchmarks.stars import synthetic
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import arcs as arcsets
from boresight.estimation import batch
from boresight.estimation.batch import NormalEquations
from boresight.estimation.blocks import FRAMES, computing_on, in_blocks
from boresight.simulation.sensors import st16_sensor

SENSOR = st16_sensor(1)
FREE = np.arange(8)


@pytest.fixture(scope="module")
def arcs():
    return synthetic(3 * FRAMES + 7, np.random.default_rng(8))


def evaluated(arcs):
    return batch.normal_equations(arcs, SENSOR.initial, FREE, SENSOR.typical_sigma)


def same(one, other):
    return (one.A == other.A).all() and (one.b == other.b).all() and one.chi2 == other.chi2


def test_threads_change_no_bit_of_the_normal_equations(arcs):
    alone = evaluated(arcs)
    for threads in (2, 3):
        with computing_on(threads):
            assert same(evaluated(arcs), alone)


def test_chunks_of_whole_blocks_add_up_to_the_same_bits(arcs):
    parts = [
        evaluated(arcs.frames(first, min(first + FRAMES, arcs.n_frames))) for first in range(0, arcs.n_frames, FRAMES)
    ]
    assert same(NormalEquations.added(parts, 8), evaluated(arcs))


def test_order_and_weights_are_the_same_on_two_threads(arcs):
    sigma = arcsets.angular_sigma(INVERTED_WANG, SENSOR.initial, arcs)
    alone, places = arcsets.whiten(arcs, sigma)[0], arcsets.order(arcs.star_start, arcs.s_i)[0]
    with computing_on(2):
        beside = arcsets.whiten(arcs, sigma)[0]
        assert (arcsets.order(arcs.star_start, arcs.s_i)[0] == places).all()
    assert (beside.band == alone.band).all()
    assert (beside.phi == alone.phi).all()


def test_results_come_in_the_order_of_the_blocks_whichever_ends_first():
    with computing_on(2):
        assert in_blocks(lambda first, last: (first, last), 10, 4) == [(0, 4), (4, 8), (8, 10)]


def test_an_empty_set_has_no_blocks():
    assert in_blocks(lambda first, last: (first, last), 0) == []
