"""`boresight sensor new` writes a sensor file that calibrates, or tells every fault; `--site` puts a sensor on the ground."""

import json

import numpy as np
import pytest
from astropy.io import fits

from tests.images.conftest import folder, hard_images, night  # noqa: F401 - fixtures

NUMBERS = ("--rows", "768", "--columns", "1024", "--pixel-pitch-um", "6.9", "--focal-length-mm", "35")


def test_a_few_numbers_make_a_sensor_file_and_one_that_exists_is_kept(boresight, tmp_path):
    out = tmp_path / "sensor.json"
    done = boresight("sensor", "new", *NUMBERS, "--site", "latitude_deg=52.2,longitude_deg=4.4", "--out", out)
    assert done.exit_code == 0
    document = json.loads(out.read_text())
    assert document["camera_model"] == "brown_conrady"
    assert document["site"] == {"latitude_deg": 52.2, "longitude_deg": 4.4}
    again = boresight("sensor", "new", *NUMBERS, "--model", "inverted_wang", "--out", out)
    assert again.exit_code == 1
    assert json.loads(out.read_text()) == document
    printed = boresight("sensor", "new", "--sheet", "st-16", "--out", "-")
    assert json.loads(printed.stdout)["detector"]["rows"] == 1944


def test_every_fault_is_a_line(boresight, tmp_path):
    words = ("--rows", "7", "--columns", "many", "--parity", "up", "--site", "latitude_deg=95", "--model", "brwn")
    done = boresight("sensor", "new", *words, "--out", tmp_path / "x.json")
    assert done.exit_code == 1
    told = [line.strip() for line in done.stderr.splitlines() if line.startswith("  ")]
    for name in ("rows", "columns", "parity", "latitude_deg", "brwn", "pixel_pitch_um", "focal_length_mm"):
        assert sum(name in line for line in told) == 1, (name, told)
    assert not (tmp_path / "x.json").exists()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--rows", "0"), "rows"),
        (("--columns", "abc"), "columns"),
        (("--sheet", "ST16"), "Sinclair ST-16"),
        (("--sheet", "Nonsense"), "Sinclair ST-16"),
        (("--parity", "0"), "parity"),
        (("--model", "browny"), "brown_conrady"),
        (("--field-of-view-deg", "200"), "field"),
        (("--focal-length-mm", "3500000"), "focal"),
        (("--pixel-pitch-um", "0.0069"), "pitch"),
    ],
)
def test_one_fault_is_told_and_what_was_meant(boresight, tmp_path, words, named):
    done = boresight("sensor", "new", *NUMBERS, *words, "--out", tmp_path / "x.json")
    assert done.exit_code == 1
    assert named in done.stderr
    assert "unexpected" not in done.stderr


def test_a_wrong_site_and_one_with_a_server_are_refused(boresight, tmp_path):
    out = tmp_path / "sensor.json"
    boresight("sensor", "new", *NUMBERS, "--out", out)
    for words in (
        ("--site", "lattude_deg=5"),
        ("--site", "52"),
        ("--site", "latitude_deg=5,longitude_deg=6", "--server", "http://x"),
    ):
        done = boresight("calibrate", tmp_path / "none.csv", "--sensor", out, *words)
        assert done.exit_code == 1
        assert "site" in done.stderr


def test_the_real_field_calibrates_by_a_data_sheet_alone(boresight, real_sky, tmp_path):
    out, found = tmp_path / "sensor.json", tmp_path / "found.json"
    boresight("sensor", "new", *NUMBERS, "--out", out)
    done = boresight("calibrate", real_sky / "esa-5-frames.csv", "--sensor", out, "--json", found)
    assert done.exit_code == 0
    document = json.loads(found.read_text())
    assert document["exposures"] == 5
    assert abs(document["parameters"]["f_m"] - 0.0353) < 2e-5


@pytest.mark.full
def test_images_alone_make_a_sensor_file_that_calibrates(boresight, folder, night, tmp_path):  # noqa: F811 - a fixture
    images, out, found = sorted(folder.glob("*.fits")), tmp_path / "sensor.json", tmp_path / "found.json"
    done = boresight("sensor", "new", "--images", *images, "--processes", "1", "--out", out)
    assert done.exit_code == 0, done.stderr
    document = json.loads(out.read_text())
    assert document["detector"] == {"rows": 480, "columns": 640, "pixel_pitch_m": pytest.approx(5e-6)}
    assert document["parity"] == night.sensor.parity
    true_px = night.truth[1] / night.sensor.pixel_pitch_m
    assert document["initial"]["f_m"] / 5e-6 == pytest.approx(true_px, rel=0.01)
    done = boresight("calibrate", *images, "--sensor", out, "--processes", "1", "--json", found)
    assert done.exit_code == 0, done.stderr
    calibration = json.loads(found.read_text())
    assert calibration["status"] == "converged"
    for name, value in calibration["parameters"].items():
        assert abs(value - document["initial"][name]) < 3 * document["typical_sigma"][name]


def test_images_without_stars_and_what_is_no_image_are_refused_in_a_sentence(boresight, tmp_path):
    rng = np.random.default_rng(1)
    for k in range(2):
        fits.writeto(tmp_path / f"{k}.fits", rng.normal(100, 10, (128, 160)).round().astype(np.uint16))
    out = tmp_path / "sensor.json"
    for words in (
        ("--images", tmp_path / "0.fits", tmp_path / "1.fits"),
        ("--images", tmp_path / "table.csv"),
        ("--images", tmp_path / "0.raw", "--raw-bits", "12"),
        ("--images", tmp_path / "0.fits", "--telemetry", tmp_path / "t.csv"),
    ):
        (tmp_path / "0.raw").write_bytes(b"12")
        done = boresight("sensor", "new", *words, "--out", out)
        assert done.exit_code == 1
        assert len([line for line in done.stderr.splitlines() if " ..." not in line]) == 1, done.stderr
        assert not out.exists()


def test_a_sensor_file_is_called_json_and_nothing_else_is_written(boresight, tmp_path):
    words = ("--rows", 960, "--columns", 1280, "--pixel-pitch-um", 3.75, "--focal-length-mm", 12)
    refused = boresight("sensor", "new", *words, "--out", tmp_path / "camera.txt")
    assert refused.exit_code == 1
    assert list(tmp_path.iterdir()) == []
