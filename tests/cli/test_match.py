"""`boresight match`: the same rows with other stars, what it prints, writes and refuses."""

import csv
import json

import numpy as np
import pytest

from boresight.telemetry.read.readers import read_telemetry
from tests.cli.conftest import assert_refused


def blanked(source, target, share, rng):
    with source.open() as file:
        rows = list(csv.DictReader(file))
    truth = [row["star_id"] for row in rows]
    for row in rows:
        row["star_id"] = row["star_id"] if rng.random() > share else ""
        row["note"] = f'row {row["frame"]}, "kept"'
    with target.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
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
    done = match(source, out)
    assert done.exit_code == 0, done.stderr
    before, after = read_telemetry(source), read_telemetry(out)
    for name, values in vars(before).items():
        if isinstance(values, np.ndarray) and name != "star_id":
            np.testing.assert_array_equal(getattr(after, name), values, err_msg=name)
    assert {name: cells.to_pylist() for name, cells in after.unknown.items()} == {
        name: cells.to_pylist() for name, cells in before.unknown.items()
    }


def test_a_row_off_the_detector_keeps_its_place_and_has_no_star(match, half, tmp_path):
    source, out = half[0], tmp_path / "matched.csv"
    with source.open() as file:
        rows = list(csv.DictReader(file))
    named = [k for k, row in enumerate(rows) if row["star_id"]][7]
    rows[named]["row_px"] = "-5.5"
    with source.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    done = match(source, out, "--json", tmp_path / "match.json")
    assert done.exit_code == 0, done.stderr
    with out.open() as file:
        written = list(csv.DictReader(file))
    assert [row["note"] for row in written] == [row["note"] for row in rows]
    assert written[named]["star_id"] == ""
    document = json.loads((tmp_path / "match.json").read_text())
    assert [(star["row"], star["off_px"]) for star in document["stars_off_detector"]["rows"]] == [(named + 2, 5.0)]
    assert document["removed_reasons"]["its centroid is off the detector"] == 1
    assert "off the detector" in done.stdout


def test_the_columns_keep_their_places_and_an_unmatched_star_is_an_empty_cell(match, half, tmp_path):
    match(half[0], tmp_path / "matched.csv")
    with half[0].open() as before, (tmp_path / "matched.csv").open() as after:
        rows = list(csv.DictReader(before)), list(csv.DictReader(after))
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
    with half[0].open() as file:
        rows = list(csv.DictReader(file))
    with (tmp_path / "bare.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, [key for key in rows[0] if key != "star_id"], extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    done = match(tmp_path / "bare.csv", tmp_path / "out.csv", "--parameters", simulated / "truth.json")
    assert done.exit_code == 0, done.stderr
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
    done = match(half[0], half[0])
    assert_refused(done, "never overwritten")
    assert half[0].read_bytes() == before


@pytest.mark.parametrize(
    ("name", "sentence"), [("out.txt", "says no format"), ("no/out.csv", "does not exist"), (".", "is a folder")]
)
def test_a_place_that_cannot_be_written_is_refused_before_the_work(match, half, tmp_path, name, sentence):
    done = match(half[0], tmp_path / name)
    assert_refused(done, sentence, lines=1)


def test_real_stars_keep_their_names_and_the_others_have_reasons(boresight, real_sky, tmp_path):
    words = ("match", real_sky / "esa-5-frames.csv", "--sensor", real_sky / "esa.sensor.json")
    found = json.loads(boresight(*words, "--out", tmp_path / "out.csv", "--json", "-").stdout)
    assert found["kept"] >= 0.95 * found["given"]
    assert sum(found["removed_reasons"].values()) == found["removed"]
    assert found["valid_frames"] == found["frames"] == 5


def test_telemetry_of_another_camera_is_said_to_be_that(boresight, simulated, half, tmp_path):
    document = json.loads((simulated / "sensor.json").read_text())
    document["initial"]["f_m"] *= 1.6
    (tmp_path / "narrow.json").write_text(json.dumps(document))
    done = boresight("match", half[0], "--sensor", tmp_path / "narrow.json", "--out", tmp_path / "matched.csv")
    assert done.exit_code == 0, done.stderr
    assert "given identities agree with this sensor" in done.stdout
