"""`boresight calibrate` and `check`: every setting has its option and reaches the estimator; what they print, write and refuse."""

import hashlib
import json
import subprocess
import sys

import click
import orjson
import pytest

from benchmarks.stars import write_synthetic
from boresight.calibration.options import OPTIONS, CalibrationSettings
from boresight.cli.calibrate import Choice
from boresight.cli.calibrate import calibrate as command
from boresight.simulation.sensors import st16_sensor
from boresight.telemetry.sensors import sensor_document
from tests.cli.conftest import assert_refused


def calibrate(boresight, folder, *words):
    return boresight("calibrate", folder / "calibration.csv", "--sensor", folder / "sensor.json", *words)


def test_the_table_shows_every_parameter_with_sigma_and_what_the_fit_is_worth(boresight, simulated):
    done = calibrate(boresight, simulated)
    assert done.exit_code == 0
    for word in ("f  ", "m0 ", "g_y", "sigma", "RMS arc error", "condition number", "weakest direction", "converged"):
        assert word in done.stdout
    assert done.stderr == ""


def test_the_columns_are_aligned(boresight, simulated):
    table = calibrate(boresight, simulated).stdout.split("\n\n")[1].splitlines()
    assert len(table) == 9
    assert {len(line) for line in table} == {len(table[0])}


def test_json_on_standard_output_is_nothing_but_json(boresight, simulated):
    done = calibrate(boresight, simulated, "--json", "-")
    assert json.loads(done.stdout)["schema"] == "boresight.calibration/1"


def test_the_result_names_the_bytes_it_was_made_from(calibration_result, simulated):
    for role, name in (("telemetry", "calibration.csv"), ("sensor", "sensor.json"), ("validation", "validation.csv")):
        expected = hashlib.sha256((simulated / name).read_bytes()).hexdigest()
        assert calibration_result["inputs"]["sha256s"][role] == expected


def test_the_estimate_is_within_five_sigma_of_the_truth(calibration_result, simulated):
    truth = json.loads((simulated / "truth.json").read_text())
    for name, value in calibration_result["parameters"].items():
        assert abs(value - truth[name]) < 5 * calibration_result["sigma"][name]


@pytest.mark.parametrize("words", [("--method", "guess"), ("--variant", "r"), ("--linearisations", "0"), ("--wrong",)])
def test_a_choice_that_does_not_exist_is_wrong_usage(boresight, simulated, words):
    done = calibrate(boresight, simulated, *words)
    assert done.exit_code == 2
    assert done.stdout == ""


def test_a_parameter_of_another_camera_is_refused_in_one_line(boresight, simulated):
    done = calibrate(boresight, simulated, "--free", "k1")
    assert done.exit_code == 1
    assert done.stderr.startswith("boresight: ")
    assert "'k1'" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_missing_file_is_refused_in_one_line(boresight, simulated):
    done = boresight("calibrate", simulated / "absent.csv", "--sensor", simulated / "sensor.json")
    assert_refused(done, "absent.csv", lines=1)


def test_the_first_ten_faults_of_a_file_are_listed_a_line_each(boresight, simulated, tmp_path):
    lines = (simulated / "calibration.csv").read_text().splitlines()
    cells = [line.split(",") for line in lines[1:]]
    for row in cells[:12]:
        row[2] = "north"
    bad = tmp_path / "bad.csv"
    bad.write_text("\n".join([lines[0], *(",".join(row) for row in cells)]) + "\n")
    done = boresight("calibrate", bad, "--sensor", simulated / "sensor.json")
    assert done.exit_code == 1
    refusal, *faults = done.stderr.splitlines()
    assert refusal.startswith("boresight: ")
    assert 1 <= len(faults) <= 11
    assert "row 2" in faults[0]
    assert "row_px" in faults[0]


def test_a_result_that_could_not_be_written_is_refused_before_the_work(boresight, simulated, tmp_path):
    done = calibrate(boresight, simulated, "--json", tmp_path / "no" / "result.json")
    assert_refused(done, "does not exist")


def test_real_stars_determine_focal_length_and_b2(boresight, real_sky):
    fields = ("calibrate", real_sky / "esa-5-frames.csv", "--sensor", real_sky / "esa.sensor.json", "--json", "-")
    both = json.loads(boresight(*fields, "--free", "f_m,b2_per_m2").stdout)
    alone = json.loads(boresight(*fields, "--free", "f_m").stdout)
    assert both["sigma"]["f_m"] < 6.9e-6
    assert both["rms_arc_rad"]["final"] < alone["rms_arc_rad"]["final"]


def test_real_stars_leave_principal_point_and_tilt_weak_and_the_terminal_says_so(boresight, real_sky):
    done = boresight("calibrate", real_sky / "esa-5-frames.csv", "--sensor", real_sky / "esa.sensor.json")
    assert "n0 and a1 move together" in done.stdout
    assert "m0 and a2 move together" in done.stdout


OF_PAGES_ONLY = {"replay_frames_per_s"}  # a pace to watch at


def test_every_setting_has_an_option():
    options = {option.name for option in command.params if isinstance(option, Choice)}
    assert options == set(CalibrationSettings().document()) - OF_PAGES_ONLY


def test_the_help_names_every_word_and_every_default_by_group(boresight):
    text = boresight("calibrate", "--help").stdout
    flat = " ".join(text.replace("-\n", "-").split())
    assert [line for line in text.splitlines() if line.endswith(":") and line[0] != " "][-6:] == [
        "Files and output:", "Method:", "Matching:", "Of the batch:", "Of the filters:", "Of svd and angular:"
    ]  # fmt: skip
    for name, option in ((name, option) for name, option in OPTIONS.items() if option.kind == "word"):
        listed = f"Choose from {', '.join(option.words)}. [default: {getattr(CalibrationSettings(), name)}]"
        assert listed.replace(" ", "") in flat.replace(" ", "")
    assert "[default: 1.345]" in text


def test_what_is_not_given_keeps_the_default_of_the_settings(boresight, simulated):
    settings = json.loads(calibrate(boresight, simulated, "--json", "-").stdout)["inputs"]["settings"]
    assert settings == CalibrationSettings().document()


@pytest.mark.parametrize(
    ("words", "kept"),
    [
        (("--robust", "huber", "--huber-threshold", "2"), {"robust": "huber", "huber_threshold": 2.0}),
        (("--error", "cosine"), {"error": "cosine"}),
        (
            ("--method", "ukf", "--variant", "q", "--process-noise", "0.1", "--forgetting-factor", "0.99"),
            {"method": "ukf", "process_noise_sigma": 0.1, "forgetting_factor": 0.99},
        ),
        (
            ("--method", "svd", "--star-model", "1", "--singular-values", "3,2,1", "--gain-form", "gain"),
            {"method": "svd", "star_model": 1, "singular_values": [1, 2, 3], "gain_form": "gain"},
        ),
        (("--method", "angular"), {"method": "angular"}),
        (
            ("--method", "ekf", "--variant", "q", "--free", "f_m, b2_per_m2", "--linearisations", "1"),
            {"method": "ekf", "variant": "q", "free": ["f_m", "b2_per_m2"], "linearisations": 1},
        ),
    ],
)
def test_a_choice_reaches_the_estimator(boresight, simulated, words, kept):
    result = json.loads(calibrate(boresight, simulated, "--json", "-", *words).stdout)
    assert result["status"] == "converged"
    assert kept.items() <= result["inputs"]["settings"].items()


def test_matching_choices_are_read(boresight, simulated):
    words = ("--match", "given", "--match-rule", "flight", "--flight-tolerance-urad", "90", "--leave-out-doubles")
    done = calibrate(boresight, simulated, "--json", "-", "--match-parameters", "baseline", *words)
    settings = json.loads(done.stdout)["inputs"]["settings"]
    assert (settings["match_rule"], settings["flight_tolerance_urad"]) == ("flight", 90.0)
    assert (settings["match_parameters"], settings["leave_out_doubles"]) == ("baseline", True)


def test_choices_that_exclude_one_another_are_wrong_usage(boresight, simulated):
    done = calibrate(boresight, simulated, "--json", "-", "--method", "sqrf", "--robust", "huber")
    assert done.exit_code == click.UsageError.exit_code
    assert "Robust loss is the batch's" in done.stderr


def _calibrated(boresight, folder, method):
    words = ("calibrate", folder / "esa-5-frames.csv", "--sensor", folder / "esa.sensor.json", "--json", "-")
    return json.loads(boresight(*words, "--free", "f_m,b2_per_m2", "--method", method).stdout)


@pytest.mark.parametrize("method", ["svd", "angular"])
def test_real_stars_give_the_focal_length_and_b2_that_their_arcs_give(boresight, real_sky, method):
    found, arcs = (_calibrated(boresight, real_sky, each) for each in (method, "batch"))
    assert found["status"] == "converged"
    assert found["rms_arc_rad"]["final"] == pytest.approx(arcs["rms_arc_rad"]["final"], rel=0.02)
    for name in ("f_m", "b2_per_m2"):
        assert abs(found["parameters"][name] - arcs["parameters"][name]) < 2.5 * arcs["sigma"][name]
        assert found["sigma"][name] == pytest.approx(arcs["sigma"][name], rel=0.1)


def test_the_gain_form_of_all_pairs_runs_on_real_stars_and_says_how(boresight, real_sky):
    words = ("calibrate", real_sky / "esa-5-frames.csv", "--sensor", real_sky / "esa.sensor.json", "--json", "-")
    choices = ("--free", "f_m,b2_per_m2", "--match", "given", "--method", "angular", "--gain-form")
    gain, information = (json.loads(boresight(*words, *choices, form).stdout) for form in ("gain", "information"))
    for name in ("f_m", "b2_per_m2"):
        assert gain["parameters"][name] == pytest.approx(information["parameters"][name], rel=1e-6)
        assert gain["sigma"][name] == pytest.approx(information["sigma"][name], rel=1e-6)
    assert any("exposures have more than 2,000 pairs" in sentence for sentence in gain["advice"])
    assert not any("pairs" in sentence for sentence in information["advice"])


#: Of the server, the workers, the charts, and of parts of libraries that are slow to load.
UNUSED = {
    "plotly", "distributed", "dask", "fastapi", "starlette", "jinja2", "alembic", "pandas", "scipy.optimize", "scipy.stats",
}  # fmt: skip
CALIBRATION = """
import sys
from boresight.cli import main
main(sys.argv[1:], standalone_mode=False)
print("|".join(sorted(sys.modules)))
"""


@pytest.fixture
def loaded(tmp_path):
    (tmp_path / "sensor.json").write_bytes(orjson.dumps(sensor_document(st16_sensor(1))))
    write_synthetic(tmp_path / "set.parquet", 60)
    words = ("calibrate", "set.parquet", "--sensor", "sensor.json", "--match", "given", "--json", "out.json")
    done = subprocess.run(
        [sys.executable, "-c", CALIBRATION, *words], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    return set(done.stdout.splitlines()[-1].split("|"))


def test_a_calibration_loads_neither_server_nor_workers_nor_charts(loaded):
    assert loaded & UNUSED == set()
