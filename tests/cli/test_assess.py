"""`boresight assess`: what it prints, writes and refuses; a refused verdict is an answer, not a failure."""

import json

import pytest


@pytest.fixture
def assess(boresight, simulated, calibration):
    words = ("assess", calibration, "--sensor", simulated / "sensor.json")
    return lambda *more: boresight(*words, *more)


@pytest.fixture
def written(tmp_path):
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
    done = assess()
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    for word in ("Finite values", "Validation RMS, to incumbent", "Parameter shift", "× noise", "≤\u202f3.00", "95 %"):
        assert word in done.stdout
    assert lines[-1] == "ST16-4: NO-DATA"
    assert any(line.startswith("Quantisation NO-DATA: There is no table definition") for line in lines)


def test_the_json_is_the_report_and_held_out_frames_give_what_the_calibrations_own_validation_gives(assess, simulated):
    own = json.loads(assess("--json", "-").stdout)
    seen = json.loads(assess("--validate", simulated / "validation.csv", "--json", "-").stdout)
    assert own["schema"] == "boresight.gate-report/1"
    assert (own["verdict"], own["blocking"], len(own["gates"])) == ("NO-DATA", [], 18)
    assert rounded(own) == rounded(seen)


def test_a_verdict_of_fail_is_exit_zero_and_names_the_gates_that_would_block(assess, written):
    profile = written({"gates": [{"name": "parameter-shift", "limit": 0.1, "marginal": 0.1}]})
    done = assess("--profile", profile)
    assert done.exit_code == 0
    assert done.stdout.splitlines()[-1] == "ST16-4: FAIL; it would be blocked by parameter-shift"


def test_a_set_against_itself_has_not_moved_and_against_better_parameters_it_fails(
    boresight, assess, simulated, calibration, written
):
    itself = json.loads(assess("--against", calibration, "--json", "-").stdout)
    shift = next(gate for gate in itself["gates"] if gate["name"] == "parameter-shift")
    rms = next(gate for gate in itself["gates"] if gate["name"] == "validation-rms-incumbent")
    assert (shift["value"], rms["status"]) == (0, "NO-DATA")
    ground = json.loads((simulated / "sensor.json").read_text())["initial"]
    worse = json.loads(calibration.read_text()) | {"parameters": ground}
    words = ("assess", written(worse), "--sensor", simulated / "sensor.json", "--against", calibration)
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
        ("--against", {"f_m": 0.016}, "gives no m0_px"),
        ("--validate", "frame,exposure\n", "no rows"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(assess, written, option, document, words):
    name = "frames.csv" if option == "--validate" else "document.json"
    done = assess(option, written(document, name))
    assert done.exit_code == 1
    assert done.stdout == ""
    assert words in done.stderr


def test_what_is_no_calibration_is_refused(boresight, simulated):
    done = boresight("assess", simulated / "truth.json", "--sensor", simulated / "sensor.json")
    assert done.exit_code == 1
    assert "truth.json is no whole calibration (schema" in done.stderr
