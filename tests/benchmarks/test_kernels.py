"""The part keeps the contract's keys, and its peers do the same arithmetic as the loops they are timed against."""

import numpy as np
import pytest

from benchmarks import kernels, peers
from benchmarks.stars import STARS, TIME, star_frames, synthetic, wu_field
from boresight.calibration.sequence import START_ARCS_PER_PARAMETER, pool_start
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import batch
from boresight.estimation.blocks import FRAMES
from boresight.estimation.filters import FILTERS, Tuning
from boresight.estimation.filters.history import start
from boresight.simulation.sensors import ST16_MAGNITUDE_LIMIT, st16_sensor, st16_truth
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import load_catalogue

CONTRACT = {
    "frames", "batch_evaluation_us_per_frame", "batch_fit_us_per_frame", "sqrf_us_per_frame", "match_us_per_frame",
    "svd_us_per_frame", "peak_rss_mb", "peers",
}  # fmt: skip


def test_the_contract_s_keys_are_there_and_every_ratio_is_a_peer_over_the_loop_that_does_its_work(monkeypatch):
    for name in ("EVALUATION_TURNS", "FILTER_TURNS", "THREAD_TURNS", "MATCHING_TURNS", "SLOWEST_PEER_FRAMES"):
        monkeypatch.setattr(kernels, name, 2)
    found = kernels.measure(lambda *_: None, frames=30, thread_frames=2 * FRAMES)
    assert set(found) >= CONTRACT
    times = {key: value for key, value in found.items() if key.endswith("_us_per_frame")} | found["peers"]
    assert all(value > 0 for value in times.values())
    assert {f"{name}_us_per_frame" for name in found["ratios"]} == set(found["peers"])
    for peer, ours in (("scipy_match", "match"), ("numpy_svd_update_8_stars", "svd_update_8_stars")):
        ratio = found["peers"][f"{peer}_us_per_frame"] / found[f"{ours}_us_per_frame"]
        assert found["ratios"][peer] == pytest.approx(ratio)
    assert set(found["limits"]) == {"evaluation_over_c", "sqrf_over_c", "two_threads"}


def test_a_limit_is_kept_at_its_value_and_not_beyond():
    times = {"evaluation": {"ours": 1.25, "c": 1.0, "c_fast_math": 2.0}, "sqrf": {"ours": 1.0}}
    kept = {name: limit["kept"] for name, limit in kernels.limits(times, 1.59).items()}
    assert kept == {"evaluation_over_c": True, "sqrf_over_c": None, "two_threads": False}


def test_c_does_the_arithmetic_of_the_compiled_loops_and_takes_no_small_numbers_from_the_process():
    arcs, sensor = synthetic(60, np.random.default_rng(4)), st16_sensor(1)
    x, scale, free = sensor.initial, sensor.typical_sigma, np.arange(8)
    pooled, begin = pool_start(arcs, START_ARCS_PER_PARAMETER * 8), start(x, 8, 10.0)
    equations, history = (
        batch.normal_equations(arcs, x, free, scale),
        FILTERS["sqrf"](pooled, begin, free, scale, Tuning()),
    )
    with peers.compiled() as in_c:
        for peer in in_c.values():
            A, b, costs = peer.normal_equations(arcs, x, scale)
            np.testing.assert_allclose(A, equations.A, rtol=1e-9)
            np.testing.assert_allclose(b, equations.b, rtol=1e-9)
            np.testing.assert_allclose(costs, [equations.chi2, equations.sum_of_squares], rtol=1e-12)
            theirs = peer.square_root_filter(pooled, begin, scale, Tuning())
            np.testing.assert_allclose((theirs.states - history.states) / scale / history.sigmas, 0.0, atol=1e-6)
            np.testing.assert_allclose(theirs.nis, history.nis, rtol=1e-8)
        assert np.nextafter(0.0, 1.0) / 2 + np.nextafter(0.0, 1.0) > 0.0
    if not in_c:
        pytest.skip("no C compiler on this machine")


@pytest.mark.parametrize("stars", [31, 4])
@pytest.mark.parametrize("peer", ["plain", "lean"])
def test_the_peers_of_the_svd_update_end_where_it_does(stars, peer):
    ways = kernels.updates(wu_field(np.full(30, stars), np.random.default_rng(stars)))
    for ours, theirs in zip(ways["compiled"], ways[peer], strict=True):
        (z, information), (z_peer, information_peer) = ours(), theirs()
        np.testing.assert_allclose(z_peer, z, atol=1e-6)
        np.testing.assert_allclose(information_peer, information, atol=1e-7 * np.abs(information).max())


def test_the_matching_peer_finds_the_unnamed_stars_of_a_well_known_camera():
    catalogue, rng, truth = load_catalogue(None), np.random.default_rng(2), st16_truth(1)
    telemetry = star_frames(20, st16_sensor(1), truth, catalogue, rng)
    bright = np.flatnonzero(catalogue.magnitude <= ST16_MAGNITUDE_LIMIT)
    s_i = apparent_directions(catalogue, bright, np.full(len(bright), TIME), None)
    s_d = INVERTED_WANG.directions(truth, telemetry.row_px, telemetry.col_px, 2.2e-6)
    given = np.where(rng.random(len(telemetry)) < 0.5, 0, telemetry.star_id)
    row_start = np.arange(0, len(telemetry) + 1, STARS)
    found = peers.scipy_match(row_start, s_d, given, catalogue.hip[bright], s_i, 0.25, 6e-4)
    assert np.mean(found == telemetry.star_id) > 0.95
