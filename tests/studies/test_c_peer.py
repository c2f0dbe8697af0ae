"""The C peer does the same arithmetic as the loops it is timed against; without a C compiler there is none to hold."""

import numpy as np
import pytest

from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.estimation import batch
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.simulation.sensors import st16_sensor
from boresight.studies import c_peer, speed

FRAMES = 60


@pytest.fixture(scope="module")
def peers():
    with c_peer.compiled() as found:
        if not found:
            pytest.skip("no C compiler on this machine")
        yield found


@pytest.fixture(scope="module")
def arcs():
    return speed.synthetic(FRAMES, np.random.default_rng(4))


@pytest.mark.parametrize("variant", c_peer.VARIANTS)
def test_c_gives_the_normal_equations_of_the_compiled_loop(peers, arcs, variant):
    sensor = st16_sensor(1)
    ours = batch.normal_equations(arcs, sensor.initial, np.arange(8), sensor.typical_sigma)
    A, b, costs = peers[variant].normal_equations(arcs, sensor.initial, sensor.typical_sigma)
    np.testing.assert_allclose(A, ours.A, rtol=1e-9)
    np.testing.assert_allclose(b, ours.b, rtol=1e-9)
    np.testing.assert_allclose(costs, [ours.chi2, ours.sum_of_squares], rtol=1e-12)


@pytest.mark.parametrize("variant", c_peer.VARIANTS)
def test_c_runs_the_square_root_filter_to_the_same_states(peers, arcs, variant):
    sensor = st16_sensor(1)
    scale, begin = sensor.typical_sigma, start(sensor.initial, 8, 10.0)
    pooled = pool_start(arcs, START_ARCS_PER_PARAMETER * len(scale))
    ours = FILTERS["sqrf"](pooled, begin, np.arange(8), scale, Tuning())
    theirs = peers[variant].square_root_filter(pooled, begin, scale, Tuning())
    np.testing.assert_allclose((theirs.states - ours.states) / scale / ours.sigmas, 0.0, atol=1e-6)
    np.testing.assert_allclose(theirs.sigmas, ours.sigmas, rtol=1e-8)
    np.testing.assert_allclose(theirs.nis, ours.nis, rtol=1e-8)


@pytest.mark.usefixtures("peers")
def test_no_variant_takes_the_smallest_numbers_from_the_process_that_loads_it():
    assert np.nextafter(0.0, 1.0) / 2 + np.nextafter(0.0, 1.0) > 0.0
    assert np.finfo(np.float64).tiny / 2 > 0.0
