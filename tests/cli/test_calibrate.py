"""`boresight calibrate`, `match`, `simulate` and `convert`: settings reach the estimator; what they print, write and refuse."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import orjson
import pytest
from click.shell_completion import ShellComplete

from benchmarks.stars import write_synthetic
from boresight.calibration.exports import EXPORT_FORMATS
from boresight.calibration.options import OPTIONS, CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.cli import main
from boresight.cli.calibrate import SettingOption
from boresight.cli.calibrate import calibrate as command
from boresight.disks import compute_digest
from boresight.simulation.sensors import st16_sensor, wu_sensor
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import sensor_document
from tests.cli.conftest import accepted, assert_refused, read_rows, write_rows


def calibrate(boresight, folder, *words):
    return boresight("calibrate", folder / "calibration.csv", "--sensor", folder / "sensor.json", *words)


def test_the_table_shows_every_parameter_with_sigma_and_what_the_fit_is_worth(boresight, simulated, monkeypatch):
    monkeypatch.setattr(
        "boresight.library.progress.PATIENCE_S", 600.0
    )  # on a busy machine it would say that it is at work
    done = accepted(calibrate(boresight, simulated))
    for word in ("f  ", "m0 ", "g_y", "sigma", "RMS arc error", "condition number", "weakest direction", "converged"):
        assert word in done.stdout
    assert done.stderr == ""


def test_the_columns_are_aligned(boresight, simulated):
    table = calibrate(boresight, simulated).stdout.split("\n\n")[1].splitlines()
    assert len(table) == 9
    assert {len(line) for line in table} == {len(table[0])}


def test_the_result_names_the_bytes_it_was_made_from(calibration_result, simulated):
    for role, name in (("telemetry", "calibration.csv"), ("sensor", "sensor.json"), ("validation", "validation.csv")):
        expected = hashlib.sha256((simulated / name).read_bytes()).hexdigest()
        assert calibration_result["inputs"]["sha256s"][role] == expected


def test_the_estimate_is_within_five_sigma_of_the_truth(calibration_result, simulated):
    truth = json.loads((simulated / "truth.json").read_text())
    for name, value in calibration_result["parameters"].items():
        assert abs(value - truth[name]) < 5 * calibration_result["sigma"][name]


@pytest.mark.parametrize("method", ["batch", "sqrf"])
def test_several_sets_are_one_calibration_that_knows_more_and_names_each(boresight, simulated, method):
    both = [simulated / "calibration.csv", simulated / "validation.csv", "--sensor", simulated / "sensor.json"]
    one, joint = (
        json.loads(accepted(boresight("calibrate", *words, "--method", method, "--json", "-")).stdout)
        for words in ([both[0], *both[2:]], both)
    )
    assert [Path(path).name for path in both[:2]] == [each["name"] for each in joint["inputs"]["passes"]]
    assert [each["sha256"] for each in joint["inputs"]["passes"]] == [
        joint["inputs"]["sha256s"][role] for role in ("telemetry_1", "telemetry_2")
    ]
    assert joint["stars"] > one["stars"]
    assert all(joint["sigma"][name] < one["sigma"][name] for name in one["free"])
    assert "passes" not in one["inputs"]


@pytest.mark.parametrize("method", ["batch", "sqrf"])
def test_a_prior_makes_sigmas_smaller_and_the_terminal_says_how_much_came_from_it(
    boresight, simulated, tmp_path, method
):
    sensor, former = ("--sensor", simulated / "sensor.json"), tmp_path / "former.json"
    accepted(boresight("calibrate", simulated / "calibration.csv", *sensor, "--json", former))
    words = ["calibrate", simulated / "validation.csv", *sensor, "--method", method]
    alone = json.loads(accepted(boresight(*words, "--json", "-")).stdout)
    done = accepted(boresight(*words, "--prior", former, "--json", tmp_path / "found.json"))
    found = json.loads((tmp_path / "found.json").read_text())
    assert all(found["sigma"][name] < alone["sigma"][name] for name in found["free"])
    assert all(0 < found["prior"]["share"][name] < 1 for name in found["free"])
    assert found["prior"]["sha256"] == found["inputs"]["sha256s"]["prior"] == compute_digest(former)
    assert "comes from former.json" in done.stdout
    assert_refused(
        boresight("calibrate", simulated / "calibration.csv", *sensor, "--prior", former), "already contains", lines=1
    )
    assert_refused(boresight(*words, "--prior", former, "--server", "http://127.0.0.1:9"), "server", lines=1)


def test_parameters_of_a_pass_are_told_pass_by_pass_and_the_numbers_are_the_last_ones(boresight, simulated, tmp_path):
    sets = [simulated / "calibration.csv", simulated / "validation.csv"]
    words = ["calibrate", *sets, "--sensor", simulated / "sensor.json", "--vary", "f_m", "--json", tmp_path / "a.json"]
    done = accepted(boresight(*words))
    found = json.loads((tmp_path / "a.json").read_text())
    states = found["variation"]["states"]
    assert [one["name"] for one in states] == ["calibration.csv", "validation.csv"]
    for name in found["free"]:
        assert abs(states[1]["parameters"][name] - found["parameters"][name]) < 0.05 * found["sigma"][name]
    assert "f_m: one value in each of 2 passes" in " ".join(done.stdout.split())
    assert_refused(boresight(*words[:2], *words[3:]), code="one-set-cannot-vary", lines=1)


def test_a_set_that_is_named_twice_is_refused_in_one_line(boresight, simulated, tmp_path):
    again = tmp_path / "again.csv"
    again.write_bytes((simulated / "calibration.csv").read_bytes())
    words = [simulated / "calibration.csv", again, "--sensor", simulated / "sensor.json"]
    assert_refused(boresight("calibrate", *words), "again.csv", "calibration.csv", code="same-file", lines=1)
    assert_refused(boresight("calibrate", *words[1:], words[0], "--server", "http://127.0.0.1:9"), "server", lines=1)


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
    assert_refused(calibrate(boresight, simulated, "--json", tmp_path / "no" / "result.json"), "does not exist")


def test_real_stars_leave_principal_point_and_tilt_weak_and_the_terminal_says_so(boresight, real_sky):
    done = boresight("calibrate", real_sky / "esa-5-frames.csv", "--sensor", real_sky / "esa.sensor.json")
    assert "n0 and a1 move together" in done.stdout
    assert "m0 and a2 move together" in done.stdout


OF_PAGES_ONLY = {"replay_frames_per_s"}  # a pace to watch at


def test_every_setting_has_an_option():
    options = {option.name for option in command.params if isinstance(option, SettingOption)}
    assert options == set(CalibrationSettings().document()) - OF_PAGES_ONLY


def test_the_help_names_every_word_and_every_default_by_group(boresight):
    text = boresight("calibrate", "--help").stdout
    flat = " ".join(text.replace("-\n", "-").split())
    assert [line for line in text.splitlines() if line.endswith(":") and line[0] != " "][-9:] == [
        "Files and output:", "Method:", "Matching:", "Joint calibration:", "Prior:", "Batch:", "Filters:", "Process noise:",
        "Singular values and all angular distances:"
    ]  # fmt: skip
    for name, option in ((name, option) for name, option in OPTIONS.items() if option.kind == "word"):
        listed = f"Choose from {', '.join(option.words)}. [default: {getattr(CalibrationSettings(), name)}]"
        assert listed.replace(" ", "") in flat.replace(" ", "")
    assert "[default: 1.345]" in text


def test_what_is_not_given_keeps_the_default_of_the_settings(boresight, simulated):
    result = json.loads(calibrate(boresight, simulated, "--json", "-").stdout)
    assert result["schema"] == "boresight.calibration/1"
    assert result["inputs"]["settings"] == CalibrationSettings().document()


@pytest.mark.few(3)
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
    done = calibrate(boresight, simulated, "--json", "-", "--method", "sqrf", "--match-parameters", "baseline", *words)
    settings = json.loads(done.stdout)["inputs"]["settings"]
    assert (settings["match_rule"], settings["flight_tolerance_urad"]) == ("flight", 90.0)
    assert (settings["match_parameters"], settings["leave_out_doubles"]) == ("baseline", True)


def test_choices_that_exclude_one_another_are_wrong_usage(boresight, simulated):
    done = calibrate(boresight, simulated, "--json", "-", "--method", "sqrf", "--robust", "huber")
    assert done.exit_code == click.UsageError.exit_code
    assert "Robust loss" in done.stderr


def test_a_choice_of_another_method_is_wrong_usage(boresight, simulated):
    done = calibrate(boresight, simulated, "--json", "-", "--method", "batch", "--variant", "q")
    assert done.exit_code == click.UsageError.exit_code
    assert "'variant'" in done.stderr


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


def test_a_built_in_scenario_writes_everything_a_calibration_needs(simulated):
    names = {path.name for path in simulated.iterdir()}
    assert names >= {"sensor.json", "truth.json", "scenario.json", "calibration.csv", "validation.csv"}


def test_a_scenario_file_gives_the_same_set_as_the_scenario_it_was_written_from(boresight, simulated, tmp_path):
    accepted(boresight("simulate", simulated / "scenario.json", "--out", tmp_path))
    assert (tmp_path / "calibration.csv").read_bytes() == (simulated / "calibration.csv").read_bytes()
    assert (tmp_path / "validation.csv").read_bytes() != (tmp_path / "calibration.csv").read_bytes()


def test_another_seed_gives_other_noise(boresight, simulated, tmp_path):
    boresight("simulate", simulated / "scenario.json", "--out", tmp_path, "--seed", "7")
    assert (tmp_path / "calibration.csv").read_bytes() != (simulated / "calibration.csv").read_bytes()


def test_parquet_is_written_on_request(boresight, tmp_path):
    boresight("simulate", "st16-1", "--out", tmp_path, "--frames", "5", "--format", "parquet")
    assert (tmp_path / "calibration.parquet").read_bytes()[:4] == b"PAR1"


@pytest.mark.parametrize("text", ["{", "[]", json.dumps({"sensor": 9})])
def test_a_bad_scenario_is_refused_in_one_line(boresight, tmp_path, text):
    scenario = tmp_path / "scenario.json"
    scenario.write_text(text)
    assert_refused(boresight("simulate", scenario, "--out", tmp_path / "out"), lines=1)


def test_an_unknown_name_is_refused_with_the_names_there_are(boresight, tmp_path):
    assert_refused(boresight("simulate", "st16-7", "--out", tmp_path), "st16-1")


LENS = {"s": 1.0, "f_m": 0.016, "u0_px": 970.0, "v0_px": 550.0, "k1": -0.05, "k2": 0.02}


@pytest.fixture
def lens(tmp_path):
    parameters, sensor = tmp_path / "lens.json", tmp_path / "sensor.json"
    parameters.write_text(json.dumps(LENS))
    sensor.write_text(json.dumps(sensor_document(wu_sensor())))
    return parameters, "--sensor", sensor, "--to", "inverted_wang"


def test_a_lens_goes_to_the_other_model_and_back(boresight, lens, tmp_path):
    out, sensor = tmp_path / "there.json", tmp_path / "there.sensor.json"
    done = accepted(boresight("convert", *lens, "--out", out, "--sensor-out", sensor))
    for word in ("misfit over the detector", "arcsec", "RMS", f"Wrote {out}", f"Wrote {sensor}"):
        assert word in done.stdout
    back = accepted(boresight("convert", out, "--sensor", sensor, "--to", "pinhole_radial", "--out", "-"))
    assert json.loads(back.stdout)["parameters"]["f_m"] == pytest.approx(0.016, rel=1e-6)


def test_a_misfit_over_what_is_allowed_is_refused_in_one_line_and_nothing_is_written(boresight, lens, tmp_path):
    done = boresight("convert", *lens, "--out", tmp_path / "out.json", "--allow-px", "1e-9")
    assert_refused(done, "px (", "1e-09 px", code="not-expressible", lines=1)
    assert not (tmp_path / "out.json").exists()


def test_what_is_read_is_not_written_over(boresight, lens):
    for place in (lens[0], lens[2]):
        before = place.read_bytes()
        assert_refused(boresight("convert", *lens, "--out", place), code="would-overwrite")
        assert place.read_bytes() == before


def test_a_calibration_keeps_its_covariance(boresight, calibration, simulated, tmp_path):
    words = ("convert", calibration, "--sensor", simulated / "sensor.json", "--to", "pinhole_radial")
    assert_refused(boresight(*words, "--out", tmp_path / "out.json"), "tilt")
    done = accepted(boresight(*words, "--out", tmp_path / "out.json", "--allow-px", "50"))
    assert "cannot represent" in done.stdout
    written = json.loads((tmp_path / "out.json").read_text())
    assert all(value > 0 for value in written["sigma"].values())


def blanked(source, target, share, rng):
    rows = read_rows(source)
    truth = [row["star_id"] for row in rows]
    for row in rows:
        row["star_id"] = row["star_id"] if rng.random() > share else ""
        row["note"] = f'row {row["frame"]}, "kept"'
    write_rows(target, rows)
    return truth


@pytest.fixture
def half(simulated, tmp_path):
    path = tmp_path / "half.csv"
    return path, blanked(simulated / "calibration.csv", path, 0.5, np.random.default_rng(1))


@pytest.fixture
def match(boresight, simulated):
    return lambda source, out, *more: boresight(
        "match", source, "--sensor", simulated / "sensor.json", "--out", out, *more
    )


@pytest.mark.parametrize("suffix", ["csv", "jsonl", "parquet"])
def test_the_rows_stay_in_their_order_with_every_other_column_as_it_was(match, half, tmp_path, suffix):
    source, out = half[0], tmp_path / f"matched.{suffix}"
    accepted(match(source, out))
    before, after = read_telemetry(source), read_telemetry(out)
    for name, values in vars(before).items():
        if isinstance(values, np.ndarray) and name != "star_id":
            np.testing.assert_array_equal(getattr(after, name), values, err_msg=name)
    assert {name: cells.to_pylist() for name, cells in after.unknown.items()} == {
        name: cells.to_pylist() for name, cells in before.unknown.items()
    }


def test_a_row_off_the_detector_keeps_its_place_and_has_no_star(match, half, tmp_path):
    source, out = half[0], tmp_path / "matched.csv"
    rows = read_rows(source)
    named = [k for k, row in enumerate(rows) if row["star_id"]][7]
    rows[named]["row_px"] = "-5.5"
    write_rows(source, rows)
    done = accepted(match(source, out, "--json", tmp_path / "match.json"))
    written = read_rows(out)
    assert [row["note"] for row in written] == [row["note"] for row in rows]
    assert written[named]["star_id"] == ""
    document = json.loads((tmp_path / "match.json").read_text())
    assert [(star["row"], star["off_px"]) for star in document["stars_off_detector"]["rows"]] == [(named + 2, 5.0)]
    assert document["removed_reasons"]["its centroid is off the detector"] == 1
    assert "off the detector" in done.stdout


def test_the_columns_keep_their_places_and_an_unmatched_star_is_an_empty_cell(match, half, tmp_path):
    match(half[0], tmp_path / "matched.csv")
    rows = read_rows(half[0]), read_rows(tmp_path / "matched.csv")
    assert list(rows[0][0]) == list(rows[1][0])
    assert {row["star_id"] for row in rows[1]} > {""}
    assert not {"0", "-1"} & {row["star_id"] for row in rows[1]}


def test_the_stars_that_were_taken_away_come_back(match, half, tmp_path):
    source, truth = half
    done = match(source, tmp_path / "matched.csv")
    found = read_telemetry(tmp_path / "matched.csv").star_id
    true = np.array([int(star or 0) for star in truth])
    named = true > 0
    assert np.mean(found[named] == true[named]) > 0.95
    assert np.sum((found > 0) & named & (found != true)) <= 0.005 * named.sum()
    assert "given" in done.stdout
    assert "given matches" in done.stdout


def test_a_file_without_stars_gets_the_column(match, simulated, half, tmp_path):
    rows = read_rows(half[0])
    write_rows(tmp_path / "bare.csv", rows, [key for key in rows[0] if key != "star_id"])
    done = accepted(match(tmp_path / "bare.csv", tmp_path / "out.csv", "--parameters", simulated / "truth.json"))
    assert (read_telemetry(tmp_path / "out.csv").star_id > 0).sum() > 0.8 * len(rows)
    assert "quaternion" in done.stdout


def test_the_json_counts_add_up_and_every_exposure_has_an_attitude_or_a_reason(match, half, tmp_path):
    found = json.loads(match(half[0], tmp_path / "out.csv", "--json", "-").stdout)
    assert found["schema"] == "boresight.matching/1"
    assert found["given"] == found["kept"] + found["changed"] + found["removed"]
    assert found["matched"] == found["kept"] + found["changed"] + found["added"]
    assert sum(found["unmatched_reasons"].values()) == found["rows"] - found["matched"]
    assert sum(found["removed_reasons"].values()) == found["removed"]
    assert sum(found["starts"].values()) == len(found["exposures"])
    assert sum(found["frame_reasons"].values()) == found["frames"] - found["valid_frames"]
    for exposure in found["exposures"]:
        assert exposure["valid"] == (exposure["reason"] is None)
        if exposure["valid"]:
            assert np.linalg.norm(exposure["quaternion"]) == pytest.approx(1)
            assert np.linalg.eigvalsh(exposure["attitude_covariance_rad2"]).min() > 0


def test_the_flight_check_keeps_fewer_stars_at_the_ground_calibration_and_all_at_the_truth(
    match, half, simulated, tmp_path
):
    out = tmp_path / "out.csv"
    counts = {
        words: json.loads(match(half[0], out, *words, "--json", "-").stdout)["matched"]
        for words in (("--flight",), (), ("--flight", "--parameters", simulated / "truth.json"))
    }
    ground, every, truth = counts.values()
    assert ground < 0.5 * every
    assert truth > 0.98 * every


def test_doubles_can_be_left_out(match, half, tmp_path):
    every, fewer = (
        json.loads(match(half[0], tmp_path / "out.csv", *words, "--json", "-").stdout)
        for words in ((), ("--leave-out-doubles",))
    )
    assert fewer["matched"] < every["matched"]
    assert any("left out" in phrase for phrase in fewer["unmatched_reasons"])


def test_the_telemetry_itself_is_never_overwritten(match, half):
    before = half[0].read_bytes()
    assert_refused(match(half[0], half[0]), "will not be overwritten")
    assert half[0].read_bytes() == before


@pytest.mark.parametrize(
    ("name", "sentence"), [("out.txt", "has no known format"), ("no/out.csv", "does not exist"), (".", "is a folder")]
)
def test_a_place_that_cannot_be_written_is_refused_before_the_work(match, half, tmp_path, name, sentence):
    assert_refused(match(half[0], tmp_path / name), sentence, lines=1)


@pytest.mark.full
def test_telemetry_of_another_camera_is_said_to_be_that(boresight, simulated, half, tmp_path):
    document = json.loads((simulated / "sensor.json").read_text())
    document["initial"]["f_m"] *= 1.6
    (tmp_path / "narrow.json").write_text(json.dumps(document))
    done = accepted(
        boresight("match", half[0], "--sensor", tmp_path / "narrow.json", "--out", tmp_path / "matched.csv")
    )
    assert "given identities agree with this sensor" in done.stdout


def test_choose_prints_its_sentence_and_writes_a_sensor_file_that_calibrates(boresight, simulated, tmp_path):
    out, answer = tmp_path / "chosen.json", tmp_path / "choice.json"
    words = (
        "choose",
        simulated / "calibration.csv",
        "--sensor",
        simulated / "sensor.json",
        "--out",
        out,
        "--json",
        answer,
    )
    done = accepted(boresight(*words))
    found = json.loads(answer.read_text())
    assert found["schema"] == "boresight.choice/1"
    assert found["sentence"] in done.stdout
    assert found["chosen"]["camera_model"] == "inverted_wang"
    again = accepted(
        boresight("calibrate", simulated / "calibration.csv", "--sensor", out, "--match", "given", "--json", "-")
    )
    calibrated = json.loads(again.stdout)
    assert calibrated["free"] == found["chosen"]["free"]
    for name, sigma in calibrated["sigma"].items():
        if sigma is not None:
            assert abs(calibrated["parameters"][name] - found["chosen"]["parameters"][name]) < sigma


def test_choose_keeps_the_sensor_file_that_it_reads(boresight, simulated):
    sensor = simulated / "sensor.json"
    before = sensor.read_bytes()
    assert_refused(
        boresight("choose", simulated / "calibration.csv", "--sensor", sensor, "--out", sensor), code="would-overwrite"
    )
    assert sensor.read_bytes() == before


def test_a_conversion_follows_what_the_camera_leaves_where_there_is_something(
    boresight, simulated, calibration, tmp_path
):
    words = (
        "convert",
        calibration,
        "--sensor",
        simulated / "sensor.json",
        "--to",
        "pinhole_radial",
        "--allow-px",
        "50",
    )
    assert_refused(boresight(*words, "--residual", "--out", tmp_path / "out.json"), code="no-residual-spline")
    document = json.loads(calibration.read_text(encoding="utf-8"))
    document["trust"]["residual_spline"]["test"]["p"] = 1e-9
    with_structure = tmp_path / "calibration.json"
    with_structure.write_text(json.dumps(document), encoding="utf-8")
    done = accepted(boresight("convert", with_structure, *words[2:], "--residual", "--out", tmp_path / "out.json"))
    assert "residual spline" in done.stdout
    told = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["conversion"]
    assert told["residual"]["p"] == 1e-9
    assert len(told["turn_rad"]) == 3


def test_a_pipe_gives_what_a_file_gives_and_takes_one_file_of_a_command(boresight, simulated):
    sensor, calibration = simulated / "sensor.json", simulated / "calibration.csv"
    text = calibration.read_bytes()
    piped = json.loads(accepted(boresight("check", "-", "--sensor", sensor, "--json", "-", stdin=text)).stdout)
    named = json.loads(accepted(boresight("check", calibration, "--sensor", sensor, "--json", "-")).stdout)
    assert piped == named
    assert_refused(boresight("check", "-", "--sensor", "-", stdin=text), lines=1)
    assert_refused(boresight("check", "-", "--sensor", sensor, stdin=b""), lines=1)


@pytest.mark.parametrize(
    ("words", "typed", "offered"),
    [
        (["calibrate"], "--method", {"batch", "sqrf", "ekf", "ukf", "svd", "angular"}),
        (["calibrate"], "--robust", {"none", "stars", "huber"}),
        (["user", "add"], "--role", {"viewer", "analyst", "operator", "approver", "administrator"}),
        (["convert"], "--to", set(CAMERA_MODELS) | set(EXPORT_FORMATS)),
    ],
)
def test_the_shell_completes_the_choices_of_an_option(words, typed, offered):
    complete = ShellComplete(main, {}, "boresight", "_BORESIGHT_COMPLETE")
    assert {item.value for item in complete.get_completions([*words, typed], "")} == offered


def test_a_format_is_written_by_its_ending_with_its_misfit_and_refused_by_another(boresight, simulated, tmp_path):
    sensor = simulated / "sensor.json"
    document = json.loads(sensor.read_text(encoding="utf-8"))
    parameters = tmp_path / "parameters.json"
    parameters.write_text(json.dumps(document["initial"]), encoding="utf-8")
    words = ("convert", parameters, "--sensor", sensor)
    out = tmp_path / "camera.xml"
    done = accepted(boresight(*words, "--to", "giant-owen", "--out", out, "--json", tmp_path / "told.json"))
    told = json.loads((tmp_path / "told.json").read_text(encoding="utf-8"))
    assert told["misfit_px"]["max"] <= told["allowed_px"]
    assert told["source"]["sha256"] in out.read_text(encoding="utf-8")
    assert "misfit over the detector" in done.stdout
    assert_refused(boresight(*words, "--to", "giant-owen", "--out", tmp_path / "camera.yaml"), ".xml or .json")
    assert_refused(boresight(*words, "--to", "fits-sip", "--out", tmp_path / "a.fits"), "--telemetry")
    assert_refused(
        boresight(*words, "--to", "giant-owen", "--out", out, "--sensor-out", tmp_path / "s.json"), "omit --sensor-out"
    )
    fits = tmp_path / "frames.fits"
    telemetry = simulated / "calibration.csv"
    done = accepted(boresight(*words, "--to", "fits-tpv", "--telemetry", telemetry, "--out", fits, "--allow-px", "1"))
    assert fits.read_bytes().startswith(b"SIMPLE  =")
