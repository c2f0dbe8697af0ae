"""`boresight evaluate` and `assess`: what they print, write and refuse; a refused verdict is an answer, not a failure."""

import json

import pytest

from boresight.verdicts.gates import GATES
from tests.cli.conftest import accepted, assert_refused


@pytest.fixture
def evaluate(boresight, simulated):
    words = ("evaluate", simulated / "validation.csv", "--sensor", simulated / "sensor.json")
    return lambda *more: boresight(*words, *more)


@pytest.fixture
def written(evaluate, tmp_path):
    def run(document, *more):
        path = tmp_path / "parameters.json"
        path.write_text(document if isinstance(document, str) else json.dumps(document))
        return evaluate("--parameters", path, *more)

    return run


def test_the_calibration_makes_sensor_four_available_and_the_tolerance_is_said(evaluate, calibration):
    done = accepted(evaluate("--parameters", calibration))
    assert "422 µrad (simulated flight tolerance)" in done.stdout
    for word in ("availability", "matched star ratio", "RMS arc error", "95 %", "frames not available"):
        assert word in done.stdout


def test_the_json_is_the_contracts(evaluate, calibration):
    found = json.loads(evaluate("--parameters", calibration, "--json", "-").stdout)
    assert found["schema"] == "boresight.evaluation/1"
    assert found["availability"]["initial"] < 0.6
    assert found["availability"]["final"] > 0.95
    assert found["matched_star_ratio"] > 1
    assert found["rms_arc_rad"]["final"] < found["rms_arc_rad"]["initial"] / 3
    assert found["common_pairs"] > 0
    assert found["match"] == "rematch"
    low, high = found["intervals"]["rms_arc_rad"]["final"]
    assert low < found["rms_arc_rad"]["final"] < high


def test_the_same_question_gets_the_same_answer(evaluate, calibration):
    first, second = (evaluate("--parameters", calibration, "--json", "-").stdout for _ in range(2))
    assert first == second


def test_parameters_may_be_a_calibration_a_plain_object_or_one_inside(
    written, evaluate, calibration_result, calibration, simulated
):
    values = calibration_result["parameters"]
    answers = [
        json.loads(run.stdout)["rms_arc_rad"]["final"]
        for run in (
            evaluate("--parameters", calibration, "--match", "given", "--json", "-"),
            written(values, "--match", "given", "--json", "-"),
            written({"parameters": values}, "--match", "given", "--json", "-"),
        )
    ]
    assert answers[0] == answers[1] == answers[2]
    accepted(evaluate("--parameters", simulated / "truth.json", "--match", "given"))


def test_against_replaces_the_sensor_files_parameters(evaluate, calibration, simulated):
    found = json.loads(
        evaluate("--parameters", calibration, "--against", simulated / "truth.json", "--json", "-").stdout
    )
    assert found["rms_ratio"] == pytest.approx(1, abs=0.05)
    assert found["availability"]["initial"] == found["availability"]["final"]


def test_a_wider_tolerance_accepts_more(evaluate, simulated):
    words = ("--parameters", simulated / "truth.json", "--match", "given", "--json", "-")
    counts = [
        json.loads(evaluate(*words, "--flight-tolerance-urad", tolerance).stdout)["matched_stars"]["initial"]
        for tolerance in (100, 422, 5000)
    ]
    assert counts[0] < counts[1] < counts[2]


def test_shadow_lists_the_frames_that_one_would_lose(evaluate, calibration):
    done = evaluate("--parameters", calibration, "--shadow")
    assert "lost by" in done.stdout
    assert "frames that the old ones lose and lose no frame that the old ones solve" in done.stdout
    found = json.loads(evaluate("--parameters", calibration, "--shadow", "--json", "-").stdout)["shadow"]
    assert len(found["frames"]) == found["frames_in_set"]


@pytest.mark.parametrize("words", [("--match", "guess"), ("--flight-tolerance-urad", "-5"), ("--wrong",)])
def test_a_choice_that_does_not_exist_is_wrong_usage(evaluate, calibration, words):
    done = evaluate("--parameters", calibration, *words)
    assert done.exit_code == 2
    assert done.stdout == ""


def test_parameters_must_be_named(evaluate):
    assert evaluate().exit_code == 2


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda values: values.pop("b4_per_m4"), "lacks b4_per_m4: give every parameter of inverted_wang"),
        (lambda values: values.update(k1=1.0), "gives 'k1', which is not a parameter"),
        (lambda values: values.update(f_m=-0.016), "gives f_m as -0.016, expected a number"),
        (lambda values: values.update(f_m=16.0), "a field of view of 0.025"),
        (lambda values: values.update(g_y=None), "gives g_y as None, expected a number"),
        (lambda values: values.update(g_y=True), "gives g_y as True, expected a number"),
    ],
)
def test_parameters_that_are_not_this_sensors_are_refused_in_one_line(written, calibration_result, change, sentence):
    values = dict(calibration_result["parameters"])
    change(values)
    assert_refused(written(values), sentence, lines=1)


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ("{", "is not JSON"),
        ("[1]", "is not a JSON object"),
        ({"camera_model": "pinhole_radial", "parameters": {}}, "uses the camera model pinhole_radial"),
        ({"status": "diverged", "parameters": {}}, "is a calibration that diverged"),
        ({"parameters": 3}, "has `parameters` that are not an object"),
    ],
)
def test_a_file_that_holds_no_parameters_is_refused_in_one_line(written, document, sentence):
    assert_refused(written(document), sentence, lines=1)


@pytest.mark.parametrize("covariance", [{"names": ["f_m"], "matrix": [[-1.0]]}, {"names": ["f_m"], "matrix": 3}, 7])
def test_a_covariance_that_is_none_is_refused(written, calibration_result, covariance):
    done = written({"parameters": calibration_result["parameters"], "covariance": covariance})
    assert_refused(done, code="damaged-covariance")


def test_a_missing_file_is_refused_in_one_line(evaluate, tmp_path):
    assert_refused(evaluate("--parameters", tmp_path / "absent.json"), "absent.json", code="no-such-file")


@pytest.fixture
def assess(boresight, simulated, calibration):
    words = ("assess", calibration, "--sensor", simulated / "sensor.json")
    return lambda *more: boresight(*words, *more)


@pytest.fixture
def stored(tmp_path):
    def write(document, name="document.json"):
        path = tmp_path / name
        path.write_text(document if isinstance(document, str) else json.dumps(document))
        return path

    return write


def rounded(value):
    if isinstance(value, float):
        return float(f"{value:.9g}")
    if isinstance(value, dict):
        return {key: rounded(one) for key, one in value.items()}
    return [rounded(one) for one in value] if isinstance(value, list) else value


def test_every_gate_is_a_line_with_its_limit_and_the_verdict_comes_last(assess):
    done = accepted(assess())
    lines = done.stdout.splitlines()
    for word in ("Finite values", "Validation RMS vs baseline", "Parameter shift", "× noise", "≤\u202f3.00", "95 %"):
        assert word in done.stdout
    assert lines[-1] == "ST16-4: NO-DATA"
    assert any(line.startswith("Quantisation NO-DATA: There is no table definition") for line in lines)


def test_the_json_is_the_report_and_held_out_frames_give_what_the_calibrations_own_validation_gives(assess, simulated):
    own = json.loads(assess("--json", "-").stdout)
    seen = json.loads(assess("--validate", simulated / "validation.csv", "--json", "-").stdout)
    assert own["schema"] == "boresight.gate-report/1"
    assert (own["verdict"], own["blocking"], len(own["gates"])) == ("NO-DATA", [], len(GATES))
    assert rounded(own) == rounded(seen)


def test_a_verdict_of_fail_is_exit_zero_and_names_the_gates_that_would_block(assess, stored):
    profile = stored({"gates": [{"name": "parameter-shift", "limit": 0.1, "marginal": 0.1}]})
    done = accepted(assess("--profile", profile))
    assert done.stdout.splitlines()[-1] == "ST16-4: FAIL; it would be blocked by parameter-shift"


def test_a_set_against_itself_has_not_moved_and_against_better_parameters_it_fails(
    boresight, assess, simulated, calibration, stored
):
    itself = json.loads(assess("--against", calibration, "--json", "-").stdout)
    shift = next(gate for gate in itself["gates"] if gate["name"] == "parameter-shift")
    rms = next(gate for gate in itself["gates"] if gate["name"] == "validation-rms-incumbent")
    assert (shift["value"], rms["status"]) == (0, "NO-DATA")
    ground = json.loads((simulated / "sensor.json").read_text())["initial"]
    worse = json.loads(calibration.read_text()) | {"parameters": ground}
    words = ("assess", stored(worse), "--sensor", simulated / "sensor.json", "--against", calibration)
    report = json.loads(boresight(*words, "--validate", simulated / "validation.csv", "--json", "-").stdout)
    assert {gate["name"] for gate in report["gates"] if gate["status"] == "FAIL"} >= {
        "validation-rms-incumbent",
        "availability-incumbent",
        "matched-stars-incumbent",
    }


@pytest.mark.parametrize(
    ("option", "document", "words"),
    [
        ("--profile", "{", "is not JSON: give a gate profile"),
        ("--profile", [1], "is not a JSON object: give a gate profile"),
        ("--profile", {"gates": [{"name": "beauty"}]}, "There is no gate 'beauty'"),
        ("--against", {"f_m": 0.016}, "lacks m0_px"),
        ("--validate", "frame,exposure\n", "no rows"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(assess, stored, option, document, words):
    name = "frames.csv" if option == "--validate" else "document.json"
    done = assess(option, stored(document, name))
    assert done.exit_code == 1
    assert done.stdout == ""
    assert words in done.stderr


def test_what_is_no_calibration_is_refused(boresight, simulated):
    done = boresight("assess", simulated / "truth.json", "--sensor", simulated / "sensor.json")
    assert_refused(done, "truth.json", "(status", code="incomplete-calibration")
