"""Two states judged on one set, intervals of resampled frames, frames that one alone has; a forecast that foretells a run."""

import itertools
import re
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtri
from scipy.stats import binomtest

from boresight.calibration.advice import to_hold
from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import to_plain
from boresight.calibration.evaluation import bootstrap
from boresight.calibration.evaluation.evaluate import (
    evaluate_matched_frames,
    evaluate_parameters,
    mcnemar,
    shadow_summary,
    shadow_view,
)
from boresight.calibration.evaluation.forecast import MOST_FRAMES, MOST_STARS, forecast
from boresight.calibration.matching.flight_check import (
    FLIGHT_REASONS,
    FlightCheck,
    check_flight,
    compute_flight_tolerance,
)
from boresight.calibration.matching.matched_frames import (
    REASONS_OF_FRAMES,
    GivenMatches,
    MatchedFrames,
    common_arcs,
    match_under_states,
)
from boresight.calibration.options import METHODS, CalibrationSettings
from boresight.calibration.problem import build_problem
from boresight.cameras.inverted_wang import INVERTED_WANG
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import arclength
from boresight.estimation.statistics.observability import WEAK
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky.directions import star_directions
from boresight.telemetry.read.frames import Sample, read_sample
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.schema import find_exposures
from boresight.telemetry.sensors import read_sensor
from tests.calibration.sets import case, field, simulated
from tests.estimation.fields import GROUND, NOISE_PX, PITCH, TRUTH
from tests.working_tables import write_working_table

GIVEN, REMATCH = CalibrationSettings(match="given"), CalibrationSettings(match="rematch")
KEYS = {
    "schema", "frames", "availability", "matched_star_ratio", "rms_arc_rad", "common_pairs", "matched_stars",
    "flight_tolerance_rad", "intervals", "reasons",
}  # fmt: skip
CLOSE = GROUND + 0.7 * (TRUTH - GROUND)


@pytest.fixture
def evaluated(make_telemetry, sensor, catalogue):
    def run(telemetry, initial, final, seed=0):
        rng = None if seed is None else np.random.default_rng(seed)
        whole = make_telemetry(telemetry) if isinstance(telemetry, int) else telemetry
        return to_plain(evaluate_parameters(whole, sensor, catalogue, initial, final, GIVEN, rng=rng))

    return run


def test_the_document_is_the_contracts_and_plain_json_and_without_a_generator_has_no_intervals(evaluated):
    found, bare = evaluated(1, GROUND, TRUTH), evaluated(1, GROUND, TRUTH, None)
    assert set(found) >= KEYS
    assert orjson.loads(orjson.dumps(found)) == found
    assert (found["schema"], found["frames"]) == ("boresight.evaluation/1", 40)
    assert found["flight_tolerance_rad"] == pytest.approx(5 * 84.5e-6, rel=1e-3)
    assert (bare["intervals"]["availability"]["final"], bare["availability"]["final"]) == ([None, None], 1)


@pytest.fixture(scope="module")
def halves(catalogue):
    scenario = replace(calibration_scenario(3), frames=40, blanked_share=0.5)
    return scenario.sensor, simulate(scenario, np.random.default_rng(1), catalogue), scenario.truth


def test_a_state_beside_itself_gains_nothing_and_where_nothing_is_accepted_there_is_no_rms_and_no_ratio(evaluated):
    found = evaluated(1, TRUTH, TRUTH)
    assert found["matched_star_ratio"] == found["rms_ratio"] == 1
    assert found["intervals"]["matched_star_ratio"] == found["intervals"]["rms_ratio"] == [1, 1]
    assert found["availability"] == {"initial": 1, "final": 1}
    assert found["reasons"] == {"initial": {}, "final": {}}
    longer = TRUTH * np.where(np.arange(8) == 0, 2, 1)
    found = evaluated(5, longer, longer)
    assert found["availability"] == {"initial": 0, "final": 0}
    assert found["rms_arc_rad"] == {"initial": None, "final": None}
    assert (found["matched_star_ratio"], found["common_pairs"]) == (None, 0)
    assert orjson.loads(orjson.dumps(found)) == found


def test_every_frame_that_is_not_available_has_its_reason(evaluated):
    found = evaluated(2, GROUND, TRUTH, None)
    for side in ("initial", "final"):
        failed = round((1 - found["availability"][side]) * found["frames"])
        assert sum(found["reasons"][side].values()) == failed
    assert found["availability"]["initial"] < 0.5 < found["availability"]["final"]


def test_both_states_are_judged_on_the_pairs_of_the_larger_set_whichever_side_it_is_on(make_telemetry, evaluated):
    telemetry = make_telemetry(3)
    there, back = evaluated(telemetry, CLOSE, TRUTH, None), evaluated(telemetry, TRUTH, CLOSE, None)
    assert there["matched_star_ratio"] > 1
    assert there["common_pairs"] == back["common_pairs"] == 2 * len(telemetry) - 3 * 80
    assert there["rms_arc_rad"]["initial"] == back["rms_arc_rad"]["final"]
    assert there["matched_star_ratio"] == pytest.approx(1 / back["matched_star_ratio"])


def test_the_rms_is_the_plain_root_mean_square_of_the_arcs(make_telemetry, evaluated):
    telemetry = make_telemetry(4, frames=1, exposures=1)
    ra, dec = telemetry.ra_rad, telemetry.dec_rad
    s_i = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    places, _ = arcsets.order(np.array([0, 12]), s_i)
    i, j = places[arcsets.pairs(12)].T
    found = evaluated(telemetry, GROUND, TRUTH, None)
    for side, x in (("initial", GROUND), ("final", TRUTH)):
        s_d = INVERTED_WANG.directions(x, telemetry.row_px, telemetry.col_px, PITCH)
        errors = arcsets.arclength(s_d[i], s_d[j]) - arcsets.arclength(s_i[i], s_i[j])
        assert found["rms_arc_rad"][side] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-9)


def test_the_interval_of_the_rms_holds_what_the_centroid_noise_says(make_telemetry, sensor, catalogue):
    row, col = np.meshgrid(np.arange(0, sensor.rows, 8.0), np.arange(0, sensor.columns, 8.0))
    pixel = INVERTED_WANG.solid_angle(TRUTH, row.ravel(), col.ravel(), PITCH)
    # the arc's ends have different variances each way, but an arc over the field sees them all; their mean is the solid angle's
    expected = np.sqrt(2 * NOISE_PX**2 * pixel.mean())
    rng, hits = np.random.default_rng(9), 0
    for seed in range(60):
        whole = make_telemetry(100 + seed, frames=30)
        found = to_plain(evaluate_parameters(whole, sensor, catalogue, TRUTH, TRUTH, GIVEN, rng=rng))
        low, high = found["intervals"]["rms_arc_rad"]["final"]
        hits += low <= expected <= high
    assert hits >= 51


def test_half_the_stars_come_back_by_matching_anew_and_sensor_three_becomes_available(halves, catalogue):
    sensor, telemetry, truth = halves
    P = np.diag((0.05 * sensor.typical_sigma) ** 2)
    states = (telemetry, sensor, catalogue, sensor.initial, truth)
    given = to_plain(evaluate_parameters(*states, GIVEN, None, P))
    rematched = to_plain(evaluate_parameters(*states, REMATCH, None, P, rng=np.random.default_rng(0)))
    assert rematched["availability"]["initial"] < 0.6
    assert rematched["availability"]["final"] > 0.95
    assert rematched["matched_stars"]["final"] > 1.8 * given["matched_stars"]["final"]
    low, high = rematched["intervals"]["availability"]["initial"]
    assert low <= rematched["availability"]["initial"] <= high


@pytest.fixture
def seen(make_telemetry, sensor, catalogue):
    telemetry = make_telemetry(21, frames=30)
    telemetry.row_px[::170] += 40.0
    states = [(sensor.initial, None), (TRUTH, None)]
    ordered = build_problem(telemetry, sensor, catalogue).arcs
    return telemetry, ordered, match_under_states(telemetry, sensor, catalogue, states, GIVEN)


def test_every_star_is_in_one_of_the_sets_in_the_same_order_and_scores_are_those_of_arcs_ordered_anew(seen, sensor):
    telemetry, ordered, (initial, final) = seen
    rematched = common_arcs(telemetry, sensor, final, 4)
    kept = common_arcs(telemetry, sensor, final, 4, ordered)
    assert len(kept) == 2
    assert sum(arcs.n_exposures for arcs in kept) == rematched[0].n_exposures
    runs, expected = (
        sorted(rows.tolist() for arcs in sets for rows in np.split(arcs.source_row, arcs.star_start[1:-1]))
        for sets in (kept, rematched[:1])
    )
    assert runs == expected
    found, known = (
        to_plain(evaluate_matched_frames(telemetry, sensor, initial, final, GIVEN, np.random.default_rng(1), *order))
        for order in ((ordered,), ())
    )
    assert (found["common_pairs"], found["stars"]) == (known["common_pairs"], known["stars"])
    assert found["rms_arc_rad"] == pytest.approx(known["rms_arc_rad"], rel=1e-9)
    assert found["rms_ratio"] == pytest.approx(known["rms_ratio"], rel=1e-9)


SETTINGS = CalibrationSettings()


@dataclass(frozen=True)
class Given:
    s_i: np.ndarray
    exposure_start: np.ndarray
    frame: np.ndarray


def match_given(telemetry, catalogue=None):
    exposures = find_exposures(telemetry)
    s_i = star_directions(
        telemetry.star_id, telemetry.ra_rad, telemetry.dec_rad, telemetry.time_utc, telemetry.velocity_m_s, catalogue
    )
    return Given(s_i, np.append(exposures.start, len(telemetry)), exposures.frame)


def plain_agreement(s_d, s_i, tolerance):
    kept = list(range(len(s_d)))
    while True:
        i, j = np.meshgrid(kept, kept, indexing="ij")
        excess = np.abs(arclength(s_d[i], s_d[j]) - arclength(s_i[i], s_i[j])) - tolerance
        np.fill_diagonal(excess, -1)
        counts, totals = (excess > 0).sum(1), np.where(excess > 0, excess, 0).sum(1)
        if not counts.any():
            return kept
        del kept[max(range(len(kept)), key=lambda k: (counts[k], totals[k], k))]


@pytest.fixture
def checked(sensor):
    tolerance = compute_flight_tolerance(sensor, SETTINGS)
    return lambda telemetry, matches, x=TRUTH: check_flight(telemetry, sensor, matches, x, tolerance, 4)


def test_the_tolerance_is_five_sigmas_of_an_arc_or_what_is_asked_for(sensor):
    asked = [CalibrationSettings(flight_tolerance_urad=300.0), SETTINGS]
    tolerances = [compute_flight_tolerance(sensor, settings) for settings in asked]
    assert tolerances == pytest.approx([300e-6, 5 * 84.5e-6], rel=1e-3)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("x", [GROUND, TRUTH], ids=["ground", "truth"])
def test_the_compiled_check_equals_the_plain_search_and_no_two_accepted_matches_disagree(
    make_telemetry, sensor, catalogue, checked, seed, x
):
    telemetry = make_telemetry(seed, frames=5)
    matches, tolerance = match_given(telemetry, catalogue), compute_flight_tolerance(sensor, SETTINGS)
    seen, s_d = checked(telemetry, matches, x), INVERTED_WANG.directions(x, telemetry.row_px, telemetry.col_px, PITCH)
    for first, last in itertools.pairwise(matches.exposure_start):
        expected = plain_agreement(s_d[first:last], matches.s_i[first:last], tolerance)
        rows = first + np.flatnonzero(seen.accepted[first:last])
        assert (rows - first).tolist() == expected
        i, j = np.triu_indices(len(rows), 1)
        error = arclength(s_d[rows[i]], s_d[rows[j]]) - arclength(matches.s_i[rows[i]], matches.s_i[rows[j]])
        assert np.all(np.abs(error) <= tolerance)


def test_a_wrong_match_is_dropped_and_costs_nothing_else(make_telemetry, catalogue, checked):
    telemetry = make_telemetry(2, frames=10)
    matches = match_given(telemetry, catalogue)
    s_i = matches.s_i.copy()
    s_i[::12] = s_i[6::12]  # the first detection of each exposure is called another star of it
    seen = checked(telemetry, replace(matches, s_i=s_i))
    dropped = np.flatnonzero(~seen.accepted)
    assert set(dropped % 12) <= {0, 6}
    assert (len(dropped), seen.availability, seen.matched_stars) == (20, 1, 20 * 11)


def test_a_frame_is_available_by_either_exposure_and_counts_the_stars_of_valid_ones(make_telemetry, catalogue, checked):
    telemetry = make_telemetry(5, frames=3)
    matches = match_given(telemetry, catalogue)
    s_i = matches.s_i.copy()
    s_i[3:12] = np.nan  # frame 0, exposure 0 keeps three
    s_i[24:48] = np.nan  # frame 1 keeps none
    seen = checked(telemetry, replace(matches, s_i=s_i))
    assert seen.frames.tolist() == [0, 1, 2]
    assert seen.valid_frames.tolist() == [True, False, True]
    assert seen.matched_in_frame.tolist() == [12, 0, 24]
    assert seen.availability == pytest.approx(2 / 3)


@pytest.mark.parametrize(
    ("stars", "matched", "wrong", "reason"), [(12, 3, 0, 1), (12, 5, 2, 2), (12, 12, 4, 3), (12, 12, 3, 0)]
)
def test_every_reason_is_given_where_it_is_due(make_telemetry, catalogue, checked, stars, matched, wrong, reason):
    telemetry = make_telemetry(3, frames=1, stars=stars, exposures=1)
    matches = match_given(telemetry, catalogue)
    s_i = matches.s_i.copy()
    s_i[matched:] = np.nan
    s_i[:wrong] = np.random.default_rng(4).normal(size=(wrong, 3))
    s_i[:wrong] /= np.linalg.norm(s_i[:wrong], axis=1, keepdims=True)
    seen = checked(telemetry, replace(matches, s_i=s_i))
    assert (seen.accepted.sum(), seen.reason.tolist()) == (matched - wrong, [reason])
    assert seen.valid_frames.tolist() == [reason == 0]
    assert seen.matched_stars == (matched - wrong if reason == 0 else 0)
    assert FLIGHT_REASONS[0] == "valid"


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.integers(1, 3)), min_size=1, max_size=40), st.data())
def test_the_counts_of_reasons_are_those_of_the_frames_in_the_order_in_which_they_are_met(exposures, data):
    flight, found, step = np.array(exposures).T
    frame = np.cumsum(step - 1)
    frames = np.unique(frame)
    valid = np.array(data.draw(st.lists(st.booleans(), min_size=len(frames), max_size=len(frames))))
    none = np.zeros(0)
    view = FlightCheck(none, flight == 0, flight.astype(np.int8), frames, valid, none)
    seen = MatchedFrames(none, GivenMatches(none, none, none, frame, found.astype(np.int8)), view, 0.0)
    plain = Counter(REASONS_OF_FRAMES[code] for code in seen.reasons if code != 0)
    assert list(seen.count_reasons().items()) == list(plain.items())


@pytest.mark.parametrize("number", [3, 4])
def test_sensors_three_and_four_are_seldom_available_at_their_ground_calibration_and_nearly_always_at_the_truth(
    number, catalogue
):
    scenario = calibration_scenario(number)
    telemetry = simulate(scenario, np.random.default_rng(scenario.seed), catalogue)
    matches, tolerance = match_given(telemetry, catalogue), compute_flight_tolerance(scenario.sensor, SETTINGS)
    ground = check_flight(telemetry, scenario.sensor, matches, scenario.sensor.initial, tolerance, 4)
    truth = check_flight(telemetry, scenario.sensor, matches, scenario.truth, tolerance, 4)
    assert ground.availability < 0.4
    assert truth.availability > 0.95
    assert truth.accepted.sum() > 0.995 * np.isfinite(matches.s_i[:, 0]).sum()


@pytest.fixture
def seen_under(sensor, catalogue):
    return lambda telemetry, x: match_under_states(telemetry, sensor, catalogue, [(x, None)], GIVEN)[0]


def test_what_one_side_loses_the_other_gains(make_telemetry, seen_under):
    telemetry = make_telemetry(1)
    ground, truth = seen_under(telemetry, GROUND), seen_under(telemetry, TRUTH)
    there, back = to_plain(shadow_view(telemetry, ground, truth)), to_plain(shadow_view(telemetry, truth, ground))
    assert orjson.loads(orjson.dumps(there)) == there
    assert there["summary"]["candidate_only"] == back["summary"]["baseline_only"] > 0
    assert there["summary"]["stars_gained"] == back["summary"]["stars_lost"] > 0
    for one, other in zip(there["frames"], back["frames"], strict=True):
        assert (one["gained"], one["lost"]) == (other["lost"], other["gained"])
        assert (one["baseline"], one["candidate"]) == (other["candidate"], other["baseline"])


def test_the_counts_of_stars_and_the_lists_of_frames_agree_and_a_state_beside_itself_changes_nothing(
    make_telemetry, seen_under
):
    telemetry = make_telemetry(2)
    ground, truth = seen_under(telemetry, GROUND), seen_under(telemetry, TRUTH)
    found = to_plain(shadow_view(telemetry, ground, truth))
    assert [frame["frame"] for frame in found["frames"]] == list(range(40))
    for frame in found["frames"]:
        difference = frame["candidate"]["matched"] - frame["baseline"]["matched"]
        assert len(frame["gained"]) - len(frame["lost"]) == difference
        assert (frame["baseline"]["reason"] is None) == frame["baseline"]["valid"]
        own = telemetry.star_id[telemetry.frame == frame["frame"]]
        assert set(frame["gained"]) | set(frame["lost"]) <= set(own.tolist())
    assert sum(frame["baseline"]["valid"] for frame in found["frames"]) == ground.view.valid_frames.sum()
    assert sum(len(frame["gained"]) for frame in found["frames"]) == found["summary"]["stars_gained"]
    same = to_plain(shadow_view(telemetry, truth, truth))["summary"]
    assert [same[key] for key in ("baseline_only", "candidate_only", "stars_lost", "stars_gained", "p")] == [
        0,
        0,
        0,
        0,
        1,
    ]
    times = np.datetime64("2026-10-01T00:00:00", "us") + telemetry.frame * np.timedelta64(40, "s")
    timed = to_plain(shadow_view(replace(telemetry, time_utc=times), truth, truth))
    assert timed["frames"][1]["time_utc"] == "2026-10-01T00:00:40.000000Z"
    assert found["frames"][1]["time_utc"] is None


def test_a_long_set_keeps_the_frames_that_differ_and_counts_them_all(make_telemetry, seen_under, monkeypatch):
    telemetry = make_telemetry(4)
    seen = seen_under(telemetry, TRUTH)
    failing = seen.view.valid_frames.copy()
    failing[[5, 17]] = False
    worse = replace(seen, view=replace(seen.view, valid_frames=failing))
    monkeypatch.setattr("boresight.calibration.evaluation.evaluate.MOST_FRAMES", 6)
    monkeypatch.setattr("boresight.calibration.evaluation.evaluate.MOST_DIFFERING", 3)
    found = to_plain(shadow_view(telemetry, seen, worse))
    kept = [frame["frame"] for frame in found["frames"]]
    assert {0, 5, 17, 39} <= set(kept)
    assert kept == sorted(set(kept))
    assert len(kept) <= 6
    assert found["frames_in_set"] == 40
    assert found["summary"]["baseline_only"] == 2


@given(b=st.integers(0, 60), c=st.integers(0, 60))
def test_the_test_is_the_exact_binomial_one(b, c):
    expected = binomtest(b, b + c).pvalue if b + c else 1.0
    assert mcnemar(b, c) == pytest.approx(expected, rel=1e-9)


def test_alike_states_are_told_apart_no_more_often_than_the_test_says():
    rng = np.random.default_rng(6)
    p = [mcnemar(int(rng.binomial(40, 0.5)), 0) for _ in range(3)]  # one-sided splits are never called chance
    fair = [mcnemar(b, 40 - b) for b in rng.binomial(40, 0.5, 2000).tolist()]
    assert max(p) < 0.05
    assert np.mean(np.array(fair) < 0.05) < 0.05


@pytest.mark.parametrize(
    ("baseline", "candidate", "words"),
    [
        ([1, 1, 0, 0], [1, 1, 0, 0], "solve the same frames; 2 .* gained, 1 lost"),
        ([0] * 9, [1] * 9, "solve 9 frames .* lose no frame .* 2 .* gained, 1 lost"),
        ([1, 1], [0, 1], "lose 1 frame .* solve no frame .*: consistent with chance.* 2 .* gained, 1 lost"),
    ],
)
def test_the_summary_says_it_in_a_sentence(baseline, candidate, words):
    found = to_plain(shadow_summary(np.array(baseline, bool), np.array(candidate, bool), 1, 2))
    assert re.search(words, found["sentence"])


def frames_that_fail(rng, n, correlation, share):
    steps = rng.normal(size=n + 100) * np.sqrt(1 - correlation**2)
    state = np.empty(n + 100)
    state[0] = rng.normal()
    for i in range(1, n + 100):
        state[i] = correlation * state[i - 1] + steps[i]
    return (state[100:] < ndtri(share)).astype(float)


def covered(rng, correlation, share, *, blocks, sets=300, n=200):
    hits = 0
    for _ in range(sets):
        series = frames_that_fail(rng, n, correlation, share)
        length = bootstrap.block_length(series) if blocks else 1
        shares = bootstrap.resampled_sums(series[:, None], length, rng, 400)[:, 0] / (-(-n // length) * length)
        low, high = bootstrap.share_interval(series.mean(), shares, n / length)
        hits += low <= share <= high
    return hits / sets


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8])
@pytest.mark.parametrize("share", [0.2, 0.95])
def test_intervals_of_blocks_hold_the_truth_about_as_often_as_they_say(correlation, share):
    assert covered(np.random.default_rng(5), correlation, share, blocks=True) > 0.87


def test_intervals_of_single_frames_would_not_where_neighbours_are_alike():
    assert covered(np.random.default_rng(6), 0.8, 0.2, blocks=False) < 0.75


def test_independent_frames_are_drawn_one_by_one_and_alike_ones_in_runs():
    rng = np.random.default_rng(7)
    alone, alike = (
        np.median([bootstrap.block_length(frames_that_fail(rng, 400, correlation, 0.5)) for _ in range(20)])
        for correlation in (0.0, 0.8)
    )
    assert alone == 1
    assert 5 < alike < 40
    for series in (np.ones(50), np.array([1.0]), np.array([1.0, 0.0])):  # does not vary, or hardly exists
        assert bootstrap.block_length(series) == 1


@given(n=st.integers(1, 60), length=st.integers(1, 20), seed=st.integers(0, 1000))
def test_resampled_sums_are_sums_of_whole_blocks(n, length, seed):
    length = min(n, length)
    ones = np.ones((n, 2))
    sums = bootstrap.resampled_sums(ones, length, np.random.default_rng(seed), 7)
    np.testing.assert_allclose(sums, np.full((7, 2), -(-n // length) * length))


def test_the_resampled_mean_is_unbiased_and_has_the_spread_of_the_mean_also_where_blocks_are_longer():
    rng = np.random.default_rng(8)
    values = rng.normal(size=(300, 1))
    means = bootstrap.resampled_sums(values, 1, rng, 4000)[:, 0] / 300
    assert means.mean() == pytest.approx(values.mean(), abs=4 * values.std() / np.sqrt(300 * 4000))
    assert means.std() == pytest.approx(values.std() / np.sqrt(300), rel=0.05)
    many = np.random.default_rng(10).normal(size=(20_000, 1))
    sums = bootstrap.resampled_sums(np.column_stack([many, np.ones(20_000)]), 1, rng, 2000)
    assert (sums[:, 0] / sums[:, 1]).std() == pytest.approx(many.std() / np.sqrt(20_000), rel=0.08)


def test_a_share_without_exceptions_has_an_interval_and_an_end_that_is_not_finite_is_null():
    low, high = bootstrap.share_interval(1.0, np.ones(100), 200)
    assert (low, high) == (pytest.approx(0.981, abs=1e-3), 1)  # Wilson's score interval, 200 of 200
    scores = np.concatenate([np.linspace(1, 2, 900), np.full(100, np.inf)])
    assert bootstrap.interval(1.5, scores, 200) == [pytest.approx(1.03, abs=0.02), None]


def forecast_table(telemetry, sensor, catalogue, tmp_path, frames=MOST_FRAMES, **settings):
    table = tmp_path / str(len(list(tmp_path.iterdir())))  # a stored table never changes under its path
    write_working_table(telemetry, table)
    sample = read_sample(table, frames, MOST_STARS)
    return forecast(sample, sensor, catalogue, CalibrationSettings(**{"match": "given", **settings}))


def _sigma(judged):
    return np.sqrt(np.diag(judged.estimate.P)) * judged.parameters.scale


def over_sigma(foretold, judged):
    return np.array(list(foretold.sigma.values())) / _sigma(judged)


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5, 6])
def test_sigmas_foretold_from_a_tenth_of_the_frames_are_those_of_the_run(number, catalogue, tmp_path):
    run = simulated(catalogue, number, frames=1000, seed=7)
    foretold = forecast_table(run.telemetry, run.problem.sensor, catalogue, tmp_path, frames=100)
    assert (foretold.frames_sampled, foretold.frames) == (100, 1000)
    np.testing.assert_allclose(over_sigma(foretold, run), 1, atol=0.1)


@pytest.mark.parametrize(
    "settings",
    [
        *({"method": method} for method in METHODS),
        {"method": "sqrf", "variant": "q"},
        {"method": "ekf", "forgetting_factor": 0.98},
        {"method": "sqrf", "free": ("f_m", "b2_per_m2"), "initial_sigma_scale": 0.001},
        {"robust": "huber"},
        {"error": "cosine"},
    ],
    ids=lambda settings: "-".join(map(str, settings.values())),
)
def test_every_method_s_sigmas_are_foretold_within_a_tenth(settings, sensor, catalogue, tmp_path):
    telemetry = field(1, frames=160)
    run = case(telemetry, sensor, catalogue, **settings)
    foretold = forecast_table(telemetry, sensor, catalogue, tmp_path, frames=80, **settings)
    atol = 0.2 if settings.get("variant") == "q" or settings.get("forgetting_factor") else 0.1  # the last frames' own
    np.testing.assert_allclose(over_sigma(foretold, run), 1, atol=atol)


def test_directions_foretold_to_be_weak_are_those_the_run_names_and_holding_what_it_says_leaves_none(
    catalogue, tmp_path
):
    run = simulated(catalogue, 3, frames=8, seed=2)
    sensor = run.problem.sensor
    foretold = forecast_table(run.telemetry, sensor, catalogue, tmp_path)
    made = calibrate(run.telemetry, sensor, catalogue, CalibrationSettings(match="given")).to_dict()
    weak = [sigma for sigma in made["observability"]["sigma_of_direction"] if sigma > WEAK]
    assert foretold.weak == len(weak) > 0
    assert re.findall(r"\d+", foretold.sentence) == ["8", str(len(weak))]
    assert foretold.weak_directions[0] == made["observability"]["weakest"]["sentence"]
    held = to_hold(run.estimate.A)
    left = tuple(name for place, name in enumerate(sensor.free) if place not in held)
    after = forecast_table(run.telemetry, sensor, catalogue, tmp_path, free=left)
    assert foretold.help[0].startswith("Hold ")
    assert 0 < len(held) < 8
    assert after.weak == 0
    assert after.help == []
    assert re.findall(r"\d+|all", after.sentence) == [str(len(left)), "all"]


def test_so_many_frames_as_the_forecast_says_leave_no_weak_direction(sensor, catalogue, tmp_path):
    few = forecast_table(field(3, frames=6), sensor, catalogue, tmp_path)
    words = few.help[-1].split()
    needed = int(words[1].replace(",", ""))
    assert few.help[-1].startswith("About ")
    assert forecast_table(field(3, frames=int(1.2 * needed)), sensor, catalogue, tmp_path).weak == 0
    assert forecast_table(field(3, frames=needed // 2), sensor, catalogue, tmp_path).weak > 0


def test_stars_in_the_middle_alone_are_said_to_be_so(sensor, catalogue, tmp_path):
    telemetry = field(4, frames=30)
    row, col = telemetry.row_px - sensor.rows / 2, telemetry.col_px - sensor.columns / 2
    inner = (np.abs(row) < sensor.rows / 4) & (np.abs(col) < sensor.columns / 4)
    kept = {
        name: getattr(telemetry, name)[inner]
        for name in ("frame", "exposure", "row_px", "col_px", "star_id", "ra_rad", "dec_rad")
    }
    foretold = forecast_table(replace(telemetry, **kept), sensor, catalogue, tmp_path)
    assert foretold.weak > 0
    assert any(re.search(r"\d %.* 16 of 36 ", sentence) for sentence in foretold.help)


def test_a_set_without_enough_stars_foretells_nothing_and_a_fit_that_does_not_rest_the_present_parameters(
    sensor, catalogue, tmp_path
):
    foretold = forecast_table(field(5, frames=3, stars=3), sensor, catalogue, tmp_path)
    assert set(foretold.sigma.values()) == {None}
    assert foretold.weak is None
    assert foretold.sentence.code == "too_few_stars"
    # more stars than those of which other minima are looked for
    foretold = forecast_table(field(6, frames=150), sensor, catalogue, tmp_path, max_iterations=1)
    assert foretold.at == "present"
    assert all(value is None or value > 0 for value in foretold.sigma.values())


@pytest.mark.parametrize("free", [("f_m",), ("f_m", "b2_per_m2"), None])
def test_sigmas_of_the_real_star_fields_are_foretold_within_a_tenth(free, catalogue, real_sky):
    telemetry, sensor = read_telemetry(real_sky / "esa-5-frames.csv"), read_sensor(real_sky / "esa.sensor.json")
    settings = CalibrationSettings(free=free)
    foretold = forecast(Sample(telemetry, 5, 5), sensor, catalogue, settings)
    made = calibrate(telemetry, sensor, catalogue, settings).to_dict()
    for name in made["free"]:
        assert foretold.sigma[name] == pytest.approx(made["sigma"][name], rel=0.1)
    if free is None:
        said = " ".join(foretold.weak_directions)
        assert "n0 and a1 move together" in said
        assert "m0 and a2 move together" in said
