"""`boresight calibrate` and `check`: what they print, write and refuse."""

import hashlib
import json

import pytest


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


def test_the_choices_reach_the_estimator(boresight, simulated):
    words = ("--method", "ekf", "--variant", "q", "--free", "f_m, b2_per_m2", "--linearisations", "1", "--json", "-")
    result = json.loads(calibrate(boresight, simulated, *words).stdout)
    assert (result["method"], result["variant"], result["free"]) == ("ekf", "q", ["f_m", "b2_per_m2"])
    assert result["inputs"]["settings"]["linearisations"] == 1


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
    assert done.exit_code == 1
    assert done.stderr.count("\n") == 1
    assert "absent.csv" in done.stderr


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
    assert done.exit_code == 1
    assert "does not exist" in done.stderr


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
