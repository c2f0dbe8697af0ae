"""`boresight sensor new` writes a sensor file that calibrates, or tells every fault; `--site` puts a sensor on the ground."""

import json

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
    done = boresight("sensor", "new", "--rows", "7", "--model", "brwn", "--out", tmp_path / "x.json")
    assert done.exit_code == 1
    lines = done.stderr.splitlines()
    assert sum(line.startswith("  ") for line in lines) == 5
    assert not (tmp_path / "x.json").exists()


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
