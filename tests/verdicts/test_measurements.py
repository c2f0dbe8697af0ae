"""What gates measure, and on which validation frames."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import (
    Calibration,
    ChiSquareTest,
    ProcessNoise,
    RemovedOf,
    Shadow,
    TrustTest,
    Values,
    parse_calibration,
    to_plain,
)
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.process_noise import LAST_FRAMES
from boresight.calibration.trust.trust_tests import TRUST_TESTS
from boresight.figures.tables import parameter_rows, printed_rows
from boresight.platform.db.documents import canonical
from boresight.simulation.scenes import calibration_scenario, simulate, validation_scenario
from boresight.simulation.sensors import st16_truth
from boresight.verdicts.gates import GATES, judge, measure, parse_profile
from boresight.verdicts.gates.assessed_set import assess_calibration, ground_set, read_incumbent
from boresight.verdicts.gates.assessment import (
    assess,
    change_of_share,
    compute_validation_scores,
    started_from,
    take_scores,
)
from boresight.verdicts.gates.measurements import (
    NO_RUN,
    NO_TESTS,
    Measurement,
    Score,
    ValidationScores,
    measure_chi_square,
)
from boresight.verdicts.numbers import (
    MINUS,
    QUANTITIES,
    find_power,
    grouped,
    parameter,
    quantity,
    sigma,
    to_second_digit,
    unit,
    with_reach,
)
from boresight.verdicts.verdict import make_verdict_marks
from tests.calibrations import changed
from tests.effort import effort
from tests.verdicts.gate_cases import NAMES, SENSOR, SIGMA, a_result, a_set, as_read, gate_inputs


def found(name, **changed):
    return measure(gate_inputs(**changed))[name]


def with_parameters(**values):
    return a_set(parameters=a_set()["parameters"] | values)


def with_matrix(matrix):
    return a_set(covariance={"names": list(NAMES), "matrix": np.asarray(matrix).tolist()}, sigma={})


def test_every_gate_is_measured():
    assert all(callable(gate.measure) for gate in GATES.values())
    measured = measure(gate_inputs())
    assert all(one.sentence for one in measured.values())
    report = judge(parse_profile({}), measured)
    answers = {one.name: one.status for one in report.gates}
    assert {name for name, status in answers.items() if status == "NO-DATA"} == {
        name for name in GATES if name.startswith(("validation", "availability", "matched", "quantisation"))
    }
    assert set(answers.values()) == {"PASS", "NO-DATA"}


P = np.diag(SIGMA**2)


def correlated(rho, lower=1.0):
    matrix = P.copy()
    matrix[1, 2] = rho * np.sqrt(P[1, 1] * P[2, 2])
    matrix[2, 1] = lower * matrix[1, 2]
    return matrix


@pytest.mark.parametrize(
    ("value", "word"),
    [*((value, "f_m") for value in (float("nan"), float("inf"), None, "0.016", True)), (16.0, "metres")],
)
def test_a_parameter_that_is_no_plausible_number_or_no_camera_with_the_others_fails(value, word):
    measured = found("finite", candidate=with_parameters(f_m=value))
    assert measured.met == "FAIL"
    assert word in measured.sentence


def test_a_set_without_one_of_its_parameters_fails_and_no_gate_breaks_down():
    values = a_set()["parameters"]
    del values["n0_px"]
    measured = measure(gate_inputs(candidate=a_set(parameters=values)))
    assert measured["finite"].met == "FAIL"
    assert measured["arc-uncertainty"].value is None
    assert "n0_px" in measured["parameter-shift"].sentence


@pytest.mark.parametrize("sigma", [-1.0, float("nan"), float("inf"), "wide", None])
def test_a_sigma_that_is_no_number_fails_and_none_of_a_fixed_parameter_is_finite(sigma):
    assert found("finite", candidate=a_set(sigma={"f_m": sigma})).met == ("PASS" if sigma is None else "FAIL")


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (with_matrix(correlated(1.01)), "not positive definite"),
        (with_matrix(correlated(1.0)), "not positive definite"),
        (with_matrix(correlated(0.5, 1 / 0.9)), "not symmetric"),
        (with_matrix(P * 0), "not a positive number"),
        (with_matrix(-P), "not a positive number"),
        (with_matrix(P * np.nan), "not a positive number"),
        (with_matrix(P[:7]), "not names and a square matrix"),
        (with_matrix([]), "not names and a square matrix"),
        *(
            (a_set(covariance=covariance), "")
            for covariance in (None, {}, {"names": [], "matrix": []}, {"names": ["f"], "matrix": [[1.0]]})
        ),
        (a_set(sigma={"f_m": 1e-3}), "f_m"),
    ],
)
def test_what_is_no_covariance_fails_and_a_strong_but_possible_correlation_is_one(changed, words):
    measured = found("covariance", candidate=changed)
    assert measured.met == "FAIL"
    assert words in measured.sentence
    assert found("covariance", candidate=with_matrix(correlated(0.9999999))).met == "PASS"


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"candidate": a_set(sensor="ST16-2")}, "belongs to the sensor ST16-2"),
        ({"candidate": a_set(camera_model="pinhole_radial")}, "camera model pinhole_radial"),
        ({"made_with": dataclasses.replace(SENSOR, pixel_pitch_m=4e-6)}, "Detector"),
        ({"made_with": dataclasses.replace(SENSOR, parity=-SENSOR.parity)}, "parity"),
    ],
)
def test_a_set_of_another_sensor_fails(changed, words):
    measured = found("sensor", **changed)
    assert measured.met == "FAIL"
    assert words in measured.sentence


@pytest.mark.parametrize(
    ("status", "met"),
    [("converged", "PASS"), ("max_iterations", "MARGINAL"), ("rank_deficient", "FAIL"), (None, "FAIL")],
)
def test_an_estimate_must_have_come_to_rest(status, met):
    assert found("convergence", candidate=a_set(status=status)).met == met


def test_the_shift_is_in_sigmas_of_the_difference_at_least_a_tenth_of_the_typical_spread():
    typical = SENSOR.typical_sigma
    measured = found("parameter-shift", candidate=with_parameters(n0_px=SENSOR.initial[2] + 6 * typical[2]))
    assert measured.value == pytest.approx(6 / np.sqrt(1 + 0.02**2 + 0.1**2))
    assert measured.sentence.startswith("n0_px changed most, by +6.0 σ")
    sure = a_set(covariance={"names": list(NAMES), "matrix": (1e-6 * P).tolist()})
    moved = {**sure, "parameters": sure["parameters"] | {"f_m": sure["parameters"]["f_m"] + SENSOR.typical_sigma[0]}}
    assert found("parameter-shift", candidate=moved, incumbent=sure).value == pytest.approx(10, rel=1e-6)


def test_residuals_are_judged_by_the_runs_own_bounds_and_arcs_beside_the_incumbent():
    once = found("arc-uncertainty")
    twice = found("arc-uncertainty", candidate=with_matrix(4 * P))
    assert twice.value == pytest.approx(2 * once.value)
    assert once.incumbent == pytest.approx(50 * once.value, rel=0.05)
    assert found("chi-square").bounds == (0.91, 1.09)
    assert "A batch has no innovations" in found("nis").sentence
    assert found("nis", result=a_result(method="sqrf")).sentence.startswith("Innovations are")


def test_observability_is_told_with_its_weakest_direction_and_coverage_counts_regions_with_stars():
    assert found("condition-number").value == 10
    assert (found("weak-directions").value, found("weak-directions").sentence) == (0.1, "n0 and a1 move together.")
    blind = {"singular_values": [1.0, 0.0], "sigma_of_direction": [1.0, None], "condition_number": None}
    unseen = a_result(observability=dataclasses.replace(a_result().observability, **blind))
    for name in ("condition-number", "weak-directions"):
        assert "one direction" in found(name, result=unseen).sentence
    counts = np.zeros((12, 16), int)
    counts[:6, :8] = 3
    half_seen = a_result(coverage=dataclasses.replace(a_result().coverage, counts=counts.tolist()))
    assert found("coverage", result=half_seen).value == pytest.approx(1 / 4)


def _with_test(name, effect):
    noticed = TrustTest(name=name, probability=1e-9, adjusted=1e-8, noticed=True, effect=effect, sentence=f"{name}!")
    return a_result(tests=[noticed if test.name == name else test for test in a_result().tests])


@pytest.mark.parametrize("kind", TRUST_TESTS, ids=lambda kind: kind.name)
def test_what_any_test_notices_reaches_its_gate_and_fails_it_by_its_size(kind):
    def status(effect):
        report = judge(parse_profile({}), measure(gate_inputs(result=_with_test(kind.name, effect))))
        return {one.name: one.status for one in report.gates}

    assert status(None)[kind.gate] == status(0.0)[kind.gate] == status(2.9)[kind.gate] == "MARGINAL"
    assert status(3.1)[kind.gate] == "FAIL"
    assert [name for name, one in status(3.1).items() if one == "FAIL"] == [kind.gate]
    assert found(kind.gate, result=_with_test(kind.name, 2.0)).sentence == f"{kind.name}!"


def test_a_run_without_tests_has_no_data_for_their_gates():
    for gate in {kind.gate for kind in TRUST_TESTS}:
        assert NO_TESTS in found(gate, result=a_result(tests=[])).sentence


@pytest.mark.parametrize(
    "name", ["chi-square", "nis", "condition-number", "weak-directions", "coverage", "assumptions"]
)
def test_what_no_run_measured_has_no_data(name):
    assert found(name, result=None).sentence == NO_RUN
    nothing = Calibration(status="converged")
    assert (
        "run it again" in found(name, result=nothing).sentence
        or "do not determine" in found(name, result=nothing).sentence
    )


def test_assumptions_pass_once_declared_warn_until_then_and_are_marginal_where_something_is_left_in():
    (made,) = a_result().assumptions
    assert (found("assumptions").met, "global shutter" in found("assumptions").sentence) == ("PASS", True)
    asked = dataclasses.replace(made, declared=False, sentence="Nobody declared the readout.")
    unknown = found("assumptions", result=a_result(assumptions=[made, asked]))
    assert (unknown.met, unknown.value) == (None, None)
    assert unknown.sentence == "Nobody declared the readout. Then run again."
    left = dataclasses.replace(made, left_in=True, sentence="It stays in the centroids.")
    assert found("assumptions", result=a_result(assumptions=[made, left])).met == "MARGINAL"
    (threshold,) = (one for one in parse_profile({}).thresholds if one.name == "assumptions")
    assert (threshold.must_have_data, threshold.critical, threshold.waivable) == (False, False, True)


def definition(kind, **scaling):
    fields = [
        {"name": name, "parameter": name, "offset_bytes": 8 * place, "type": kind, **scaling}
        for place, name in enumerate(NAMES)
    ]
    return {"table_id": "CAM", "flight_software_version": "1", "length_bytes": 64, "fields": fields}


def test_quantisation_is_nothing_in_float64_something_in_float32_unknown_without_a_table_and_fails_where_none_fits():
    exact, rounded = (found("quantisation", definition=definition(kind)) for kind in ("float64", "float32"))
    assert exact.value == pytest.approx(0, abs=1e-9)
    assert 1e-6 < rounded.value < 1e-2
    assert "adds it" in found("quantisation").sentence
    assert found("quantisation", definition=definition("uint8", scale=1e-12, offset=0.0)).met == "FAIL"


def test_a_run_started_from_the_incumbent_or_not_and_a_file_is_as_unsure_as_the_ground_unless_it_says():
    ground = ground_set(SENSOR)
    started, nothing = (Calibration(status="converged", initial=Values(x)) for x in (ground.parameters, {}))
    starts = [(started, ground), (started, as_read(a_set())), (nothing, ground)]
    assert [started_from(*pair) for pair in starts] == [True, False, False]
    assert read_incumbent(a_set()["parameters"], SENSOR).covariance == ground.covariance
    assert to_plain(read_incumbent(a_set(), SENSOR).covariance) == a_set()["covariance"]


JUNK = st.one_of(
    st.none(), st.booleans(), st.floats(), st.text(max_size=3), st.lists(st.floats(), max_size=3), st.just({})
)


def places(document, path=()):
    for key, value in document.items():
        yield (*path, key)
        if isinstance(value, dict):
            yield from places(value, (*path, key))


def spoiled(document, path, junk):
    return {
        key: junk if path == (key,) else spoiled(value, path[1:], junk) if path[:1] == (key,) else value
        for key, value in document.items()
    }


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@settings(max_examples=effort(30, 150), deadline=None)
@given(st.data())
def test_whatever_stands_in_a_document_there_is_a_report_that_can_be_stored(data):
    which = data.draw(st.sampled_from(["candidate", "incumbent"]))
    sound = a_set()
    path = data.draw(st.sampled_from(list(places(sound))))
    report = judge(parse_profile({}), measure(gate_inputs(**{which: spoiled(sound, path, data.draw(JUNK))})))
    assert canonical(to_plain(report))


def test_the_rms_is_told_in_multiples_of_the_stated_noise():
    noise = np.sqrt(2) * SENSOR.centroid_sigma_px * SENSOR.pixel_pitch_m / SENSOR.initial[0]
    score = Score(2 * noise, (1.5 * noise, 2.5 * noise), 4 * noise)
    scores = ValidationScores(50, {"validation-rms": score})
    measured = found("validation-rms", validation=scores)
    assert measured.value == pytest.approx(2)
    assert measured.interval == pytest.approx((1.5, 2.5))
    assert measured.incumbent == pytest.approx(4)
    noisier = dataclasses.replace(SENSOR, centroid_sigma_px=2 * SENSOR.centroid_sigma_px)
    assert found("validation-rms", sensor=noisier, validation=scores).value == pytest.approx(1)


def test_the_numbers_of_a_row_share_one_power_of_ten_and_a_pure_number_has_no_unit():
    power = find_power(1.033e8, -2.1e6, 1.4e6)
    assert [grouped(to_second_digit(one, 1.4e6, power=power)) for one in (1.033e8, -2.1e6, 1.4e6)] == [
        "1.033·10⁸",
        f"{MINUS}0.021·10⁸",
        "0.014·10⁸",
    ]
    result = Calibration(
        status="converged",
        camera_model="inverted_wang",
        parameters={"b4_per_m4": 1.033e8, "g_y": 1.0002},
        initial={"b4_per_m4": 9.9e6, "g_y": 1.0},
        sigma={"b4_per_m4": 1.4e6, "g_y": 2e-5},
    )
    row = parameter_rows(result)
    assert [one.power for one in row] == [8, 0]
    printed = printed_rows(result)[0]
    assert [printed.initial, printed.final, printed.change, printed.sigma] == [
        "0.099·10⁸",
        "1.033·10⁸",
        "+0.934·10⁸",
        "0.014·10⁸",
    ]
    assert parameter(9.9e6, "b4_per_m4", 1.4e6, row[0].power) == "0.099·10⁸"
    assert parameter(9.9e6, "b4_per_m4", None, row[0].power) == "0.099·10⁸"
    assert sigma(1.4e6, "b4_per_m4", row[0].power) == "0.014·10⁸"
    assert [unit(name) for name in ("f_m", "g_y", "k1")] == ["mm", "", ""]


@pytest.mark.parametrize("start_value", [0.0, -0.0, 4e3, -4e3])
def test_a_zero_has_no_power_of_ten(start_value):
    rows = [parameter(start_value, "b4_per_m4", sigma_si, 8) for sigma_si in (1.4e6, None)]
    assert rows[0] == "0.000"
    assert (rows[1] == "0") == (start_value == 0)
    assert grouped("-0.00e+08") == "0.00"
    assert grouped("-0.01e+08") == f"{MINUS}0.01·10⁸"


@given(
    st.floats(allow_nan=False, min_value=-1e12, max_value=1e12),
    st.floats(min_value=1e-9, max_value=1e9),
    st.sampled_from([1e5, 1e7]),
)
def test_a_value_stops_within_the_second_digit_of_its_sigma_whatever_is_large(value, sigma, large):
    text = to_second_digit(value, sigma, large)
    assert abs(float(text) - value) <= 0.05 * sigma + abs(value) * 1e-12
    assert ("e" in text) == (abs(float(text)) >= large)


@pytest.mark.parametrize(
    ("name", "letters"),
    [("f_m", "f "), ("m0_px", "m 0"), ("g_y", "g y"), ("k1", "k 1"), ("tilt_rad", "tilt_rad ")],
)
def test_a_symbol_is_a_letter_and_its_index_and_a_word_stays_whole(name, letters):
    assert quantity(name).letters == tuple(letters.split(" "))
    assert {len(item.letters[0]) for item in QUANTITIES.values()} == {1}


def test_a_large_value_and_its_reach_share_one_power_of_ten():
    assert with_reach(1.033e8, 1.4e6, 1.4e6) == "(1.033 ± 0.014)·10⁸"
    assert with_reach(-2.1e8, 3 * 1.9e6, 1.9e6) == f"({MINUS}2.100 ± 0.057)·10⁸"
    assert with_reach(0.0, 4.2e7, 1.4e7) == "(0.0 ± 4.2)·10⁷"
    assert with_reach(16.0265, 0.0011, 0.0011) == "16.0265 ± 0.0011"


@given(
    st.floats(allow_nan=False, min_value=-1e12, max_value=1e12),
    st.floats(min_value=1e-6, max_value=1e9),
    st.sampled_from([1.0, 3.0]),
)
def test_value_and_reach_are_written_alike(value, sigma, times):
    text = with_reach(value, times * sigma, sigma)
    left, right = text.split(" ± ")
    assert ("·10" in text) == text.startswith("(")
    assert "·10" not in left
    assert len(left.rpartition(".")[2]) == len(right.partition(")")[0].rpartition(".")[2]) or "." not in text


GIVEN = CalibrationSettings(match="given")
TRUTH = st16_truth(1)


def known(x):
    covariance = {"names": list(NAMES), "matrix": np.diag((1e-3 * SENSOR.typical_sigma) ** 2).tolist()}
    return as_read(a_set(parameters=dict(zip(NAMES, x.tolist(), strict=True)), covariance=covariance))


def make_frames(number, frames, catalogue):
    scenario = dataclasses.replace(validation_scenario(1), frames=frames)
    return simulate(scenario, np.random.default_rng(number), catalogue)


def scores(incumbent, candidate, number, catalogue, frames=30):
    telemetry = make_frames(number, frames, catalogue)
    return compute_validation_scores(telemetry, SENSOR, catalogue, incumbent, candidate, GIVEN).of_gate


def status(name, score, **entry):
    measured = Measurement(score.value, "", interval=score.interval)
    report = judge(parse_profile({"gates": [{"name": name, **entry}]}), {name: measured})
    return next(one.status for one in report.gates if one.name == name)


@pytest.mark.full
def test_a_set_exactly_at_the_limit_is_failed_no_more_often_than_once_in_forty_times_or_so(catalogue):
    better, worse = known(TRUTH), known(TRUTH + 0.02 * SENSOR.typical_sigma)
    limit = scores(better, worse, 1, catalogue, frames=1500)["validation-rms-incumbent"].value
    assert limit > 1.1
    failed = [
        status("validation-rms-incumbent", found["validation-rms-incumbent"], limit=limit, marginal=limit) == "FAIL"
        for found in (scores(better, worse, number, catalogue) for number in range(100, 160))
    ]
    assert np.mean(failed) <= 0.07  # measured over 200 sets: 0.01 of 30 frames, 0.03 of 100


def test_a_set_as_good_as_the_incumbent_is_never_failed_by_the_default_and_a_worse_one_always(catalogue):
    rng = np.random.default_rng(3)
    for number in range(12):
        alike = [known(TRUTH + 0.005 * SENSOR.typical_sigma * rng.normal(size=8)) for _ in range(2)]
        found = scores(*alike, number, catalogue)
        assert {status(name, found[name]) for name in found} <= {"PASS", "MARGINAL"}
        worse = scores(alike[0], known(TRUTH + 0.3 * SENSOR.typical_sigma), number, catalogue)
        assert status("validation-rms-incumbent", worse["validation-rms-incumbent"]) == "FAIL"


def test_a_set_that_loses_frames_and_stars_fails_against_the_incumbent_and_the_other_way_round_passes(catalogue):
    good, lost = known(TRUTH), ground_set(SENSOR)
    forwards, back = scores(good, lost, 5, catalogue), scores(lost, good, 5, catalogue)
    for name in ("availability-incumbent", "matched-stars-incumbent"):
        assert status(name, forwards[name]) == "FAIL"
        assert status(name, back[name]) == "PASS"
        assert back[name].value == pytest.approx(-forwards[name].value)


def in_runs(rng, n, share, length):
    return np.repeat(rng.random(n // length) < share, length)


@pytest.mark.parametrize("length", [1, 5])
def test_equal_availability_is_called_worse_for_sure_no_more_often_than_chance_allows(length):
    rng = np.random.default_rng(7)
    failed = 0
    for _ in range(150):
        before, after = in_runs(rng, 200, 0.8, length), in_runs(rng, 200, 0.8, length)
        score = change_of_share(before, after, rng)
        failed += status("availability-incumbent", score, limit=0.0, marginal=0.0) == "FAIL"
    assert failed / 150 < 0.06


def test_availability_that_truly_falls_is_called_worse():
    rng = np.random.default_rng(8)
    changes = [change_of_share(in_runs(rng, 400, 0.95, 5), in_runs(rng, 400, 0.6, 5), rng) for _ in range(30)]
    answers = [status("availability-incumbent", score) for score in changes]
    assert answers.count("FAIL") >= 27
    assert set(answers) <= {"FAIL", "MARGINAL"}


@pytest.mark.parametrize(("frames", "widest"), [(20, 0.17), (100, 0.04), (400, 0.01)])
def test_where_no_frame_changed_sides_the_change_is_known_no_better_than_so_many_frames_tell(frames, widest):
    available = np.ones(frames, np.bool_)
    score = change_of_share(available, available, np.random.default_rng(9))
    low, high = score.interval
    assert score.value == 0
    assert -low == pytest.approx(high)
    assert 0.7 * widest < high < widest


def test_a_runs_own_validation_gives_the_scores_that_seeing_the_frames_again_gives(catalogue):
    scenario = dataclasses.replace(calibration_scenario(1), frames=20)
    telemetry = simulate(scenario, np.random.default_rng(11), catalogue)
    validation = make_frames(12, 20, catalogue)
    result = calibrate(telemetry, SENSOR, catalogue, GIVEN, validation=validation)
    own, written, known = take_scores(result), result.to_dict(), assess_calibration(result, SENSOR)
    assert own == compute_validation_scores(validation, SENSOR, catalogue, ground_set(SENSOR), known, GIVEN)
    incumbent = ground_set(SENSOR)
    by_result, by_frames = (
        assess(result, SENSOR, incumbent, parse_profile({}), frames) for frames in (None, (validation, catalogue))
    )
    assert by_result == by_frames
    assert take_scores(dataclasses.replace(result, validation=None)) is None
    kept = dataclasses.replace(result.shadow.validation, frames=result.shadow.validation.frames[1:])
    assert take_scores(dataclasses.replace(result, shadow=Shadow(validation=kept))) is None
    assert take_scores(changed(result, validation={"intervals": {"rms_ratio": []}})) is None
    del written["validation"]["intervals"]["rms_ratio"]
    assert take_scores(parse_calibration(written)) is None


def test_calibrations_of_good_telemetry_pass_and_are_not_blocked_however_few_their_frames(catalogue):
    profile = parse_profile({})
    for number in range(6):
        scenario = dataclasses.replace(calibration_scenario(1), frames=(4, 12, 40)[number % 3])
        telemetry = simulate(scenario, np.random.default_rng(20 + number), catalogue)
        result = calibrate(telemetry, SENSOR, catalogue, GIVEN, validation=make_frames(30 + number, 20, catalogue))
        report = assess(result, SENSOR, ground_set(SENSOR), profile)
        assert report.blocking == [], number
        assert "FAIL" not in {one.status for one in report.gates}


@pytest.mark.parametrize(
    ("removed", "expected"),
    [(0, "PASS"), (10, "PASS"), (11, "MARGINAL"), (50, "MARGINAL"), (51, "FAIL"), (225, "FAIL")],
)
def test_a_file_whose_identities_are_removed_in_numbers_does_not_pass(removed, expected):
    result = a_result(removed_of=RemovedOf(proposed=500, removed=removed))
    report = judge(parse_profile({}), measure(gate_inputs(result=result)))
    assert next(one.status for one in report.gates if one.name == "identities") == expected


def test_a_chi_square_that_only_follows_the_last_frames_is_told_so_by_gate_and_verdict_and_no_other_is():
    noise = ProcessNoise(per="frame", source="given", sigma=Values({"f_m": 0.01}), sentence="")
    high = ChiSquareTest(value=1220.0, dof=1000, lower=0.91, upper=1.09, consistent=False)
    result = a_result(method="sqrf", chi2_per_dof=1.22, chi2=high, process_noise=noise)
    seen_by_tests = [dataclasses.replace(one, noticed=one.name == "chi_square") for one in result.tests]
    cases = {
        "of the last state alone": (result, True),
        "without process noise": (dataclasses.replace(result, process_noise=None), False),
        "of the best fit too": (dataclasses.replace(result, tests=seen_by_tests), False),
        "within its bounds": (dataclasses.replace(result, chi2_per_dof=1.02), False),
    }
    for case, (one, is_told) in cases.items():
        found = measure_chi_square(gate_inputs(result=one))
        mark = next(mark for mark in make_verdict_marks(one) if mark.name == "chi_square")
        assert (LAST_FRAMES in found.sentence, LAST_FRAMES in mark.detail) == (is_told, is_told), case
        assert (found.value, found.bounds) == (one.chi2_per_dof, (0.91, 1.09)), case
