"""The bench keeps the contract's keys, times what it says it times, and its matching peer does match."""

import numpy as np
import pytest

from boresight.estimation.blocks import FRAMES
from boresight.estimation.cameras.inverted_wang import INVERTED_WANG
from boresight.simulation.sensors import ST16_MAGNITUDE_LIMIT, st16_sensor, st16_truth
from boresight.sky.apparent import apparent_directions
from boresight.sky.catalogue import load_catalogue
from boresight.studies import singular_speed, speed, speed_limits
from boresight.studies.matching_peer import scipy_match
from boresight.studies.star_frames import STARS, TIME, star_frames

CONTRACT = {
    "frames", "batch_evaluation_us_per_frame", "batch_fit_us_per_frame", "sqrf_us_per_frame", "match_us_per_frame",
    "svd_us_per_frame", "peak_rss_mb", "peers",
}  # fmt: skip


@pytest.fixture(scope="module")
def measured():
    return speed.measure(30, thread_frames=2 * FRAMES)


@pytest.fixture(scope="module")
def catalogue():
    return load_catalogue(None)


def test_the_contract_s_keys_are_there_and_every_time_is_a_time(measured):
    assert set(measured) >= CONTRACT
    times = {key: value for key, value in measured.items() if key.endswith("_us_per_frame")} | measured["peers"]
    assert all(value > 0 for value in times.values())


def test_every_ratio_is_a_peer_over_the_loop_that_does_its_work(measured):
    assert {f"{name}_us_per_frame" for name in measured["ratios"]} == set(measured["peers"])
    ours = measured["match_us_per_frame"]
    assert measured["ratios"]["scipy_match"] == pytest.approx(measured["peers"]["scipy_match_us_per_frame"] / ours)
    assert measured["match_per_batch_evaluation"] == pytest.approx(
        ours / measured["match_batch_evaluation_us_per_frame"]
    )


def test_what_is_promised_of_the_loops_is_held_against_the_faster_c_of_the_same_run(measured):
    assert set(measured["limits"]) == {"evaluation_over_c", "sqrf_over_c", "two_threads"}
    assert all(limit["kept"] in {True, False, None} for limit in measured["limits"].values())


def test_a_limit_is_kept_at_its_value_and_not_beyond():
    held = speed_limits.limits(
        {"evaluation": {"ours": 1.25, "c": 1.0, "c_fast_math": 2.0}, "sqrf": {"ours": 1.0}}, 1.59
    )
    assert {name: limit["kept"] for name, limit in held.items()} == {
        "evaluation_over_c": True,
        "sqrf_over_c": None,
        "two_threads": False,
    }


@pytest.mark.parametrize("stars", singular_speed.STARS)
def test_the_compiled_svd_update_is_set_beside_the_same_update_in_numpy_at_the_paper_s_numbers_of_stars(
    measured, stars
):
    name = f"svd_update_{stars}_stars"
    plain, lean = (measured["peers"][f"{peer}_{name}_us_per_frame"] for peer in ("numpy", "numpy_lean"))

    assert measured["ratios"][f"numpy_{name}"] == pytest.approx(plain / measured[f"{name}_us_per_frame"])
    assert plain > lean > measured[f"{name}_us_per_frame"]


@pytest.mark.parametrize("stars", [31, 19, 8, 4])
@pytest.mark.parametrize("peer", ["plain", "lean"])
def test_the_peers_of_the_svd_update_end_where_it_does(stars, peer):
    ways = singular_speed.updates(singular_speed.star_field(stars, 30, np.random.default_rng(stars)))

    for ours, theirs in zip(ways["compiled"], ways[peer], strict=True):
        (z, information), (z_peer, information_peer) = ours(), theirs()
        np.testing.assert_allclose(z_peer, z, atol=1e-6)
        np.testing.assert_allclose(information_peer, information, atol=1e-7 * np.abs(information).max())


def test_frames_for_matching_hold_twelve_real_stars_in_each_of_two_exposures(catalogue):
    telemetry = star_frames(20, st16_sensor(1), st16_truth(1), catalogue, np.random.default_rng(1))

    assert len(telemetry) == 20 * 2 * STARS
    image = telemetry.star_id.reshape(-1, STARS)
    assert all(len(set(stars)) == STARS for stars in image.tolist())
    np.testing.assert_array_equal(image[::2], image[1::2])
    assert (catalogue.magnitude[catalogue.index_of(telemetry.star_id)] <= ST16_MAGNITUDE_LIMIT).all()
    assert not np.array_equal(telemetry.row_px[:STARS], telemetry.row_px[STARS : 2 * STARS])


def test_the_peer_finds_the_unnamed_stars_of_a_well_known_camera(catalogue):
    rng, truth = np.random.default_rng(2), st16_truth(1)
    telemetry = star_frames(20, st16_sensor(1), truth, catalogue, rng)
    bright = np.flatnonzero(catalogue.magnitude <= ST16_MAGNITUDE_LIMIT)
    s_i = apparent_directions(catalogue, bright, np.full(len(bright), TIME), None)
    s_d = INVERTED_WANG.directions(truth, telemetry.row_px, telemetry.col_px, 2.2e-6)
    given = np.where(rng.random(len(telemetry)) < 0.5, 0, telemetry.star_id)

    found = scipy_match(
        np.arange(0, len(telemetry) + 1, STARS), s_d, given, catalogue.hip[bright], s_i, 0.25, 6e-4
    )  # fmt: skip

    assert np.mean(found == telemetry.star_id) > 0.95
