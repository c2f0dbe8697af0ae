"""The part keeps the contract's keys, its peers do the same arithmetic, each judged by what its camera says of the detector."""

import numpy as np
import pytest

from benchmarks import accuracy, kernels, peers
from benchmarks.accuracy import detector_errors, trial
from benchmarks.estimators import PEERS
from benchmarks.stars import STARS, TIME, simulated_views, star_frames, synthetic, wu_field
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


@pytest.mark.full
def test_the_contract_s_keys_are_there_and_every_ratio_is_a_peer_over_the_loop_that_does_its_work(monkeypatch):
    for name in (
        "EVALUATION_TURNS",
        "FILTER_TURNS",
        "THREAD_TURNS",
        "MATCHING_TURNS",
        "SLOWEST_PEER_FRAMES",
        "WU_TURNS",
    ):
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


@pytest.mark.full
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


VIEW_FRAMES = 20
#: Filters that take each frame once end some sigmas from the optimum of so few.
LINEARISED_ONCE = {"numpy_ekf", "filterpy_ekf", "filterpy_sqrf"}


@pytest.fixture(scope="module")
def views():
    return simulated_views(VIEW_FRAMES, 1, load_catalogue(None))


@pytest.mark.full
@pytest.mark.parametrize("name", PEERS)
def test_every_peer_answers_and_is_as_right_as_the_problem_it_solves_allows(name, views):
    if not PEERS[name].installed:
        pytest.skip(f"{PEERS[name].package} is not installed: pip install boresight[bench]")
    theirs, ours = (trial(one, views)["errors"] for one in (name, "boresight_batch"))
    assert 0.3 < theirs["rms_px"] < 1.0
    if PEERS[name].problem == "poses":
        assert theirs["detector_px"] > 2 * ours["detector_px"]
    else:
        apart = np.abs(np.subtract(theirs["over_bound"], ours["over_bound"])).max()
        assert apart < (5.0 if name in LINEARISED_ONCE else 0.5)


def test_a_detector_error_is_the_pixels_that_a_camera_is_wrong_by_however_it_is_turned(views):
    longer, C = views.truth * np.where(np.arange(8) == 0, 1.001, 1.0), np.eye(3)[[1, 2, 0]]

    def errors(x):
        pitch = views.sensor.pixel_pitch_m
        return detector_errors(lambda row, col: views.camera.directions(x, row, col, pitch) @ C.T, views)

    spread, corner = errors(longer)
    assert errors(views.truth) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert corner == pytest.approx(1.6, abs=0.3)
    assert 0.5 < spread < corner


def test_a_peer_that_raises_is_a_finding(views, monkeypatch):
    def broken(_views):
        raise RuntimeError("no bundle could be adjusted\nin this library")

    monkeypatch.setitem(vars(PEERS["scipy_least_squares"]), "estimate", broken)
    found = trial("scipy_least_squares", views)

    assert found["failure"] == "RuntimeError: no bundle could be adjusted"
    assert found["errors"] is None


@pytest.mark.full
def test_the_part_sets_each_peer_beside_the_batch_on_the_same_frames_in_the_same_run(monkeypatch):
    monkeypatch.setattr(accuracy, "LEAST_GROWTH_FRAMES", 12)
    monkeypatch.setattr(accuracy, "GROWTH_REPEATS", 1)
    monkeypatch.setattr(type(PEERS["pyceres"]), "installed", property(lambda self: not self.module))
    some = ["scipy_least_squares", "pyceres"]
    found = accuracy.measure(lambda *_: None, frames=12, sets=1, more_frames=24, peers=some)["estimators"]
    batch, scipy = found["boresight_batch"], found["scipy_least_squares"]
    assert scipy["us_per_frame_over_ours"] == pytest.approx(scipy["us_per_frame"] / scipy["ours_us_per_frame"])
    assert scipy["error_over_bound"] == pytest.approx(batch["error_over_bound"], rel=0.2)
    assert (scipy["growth"]["from_frames"], scipy["growth"]["to_frames"]) == (12, 24)
    assert found["pyceres"]["missing"] == "pyceres is not installed (pip install boresight[bench])"
