"""Where a command writes: packages, tables, `-` for standard output, and no name that promises another format."""

import csv
import hashlib
import io
import json
import subprocess
import sys
import zipfile

import pytest

from boresight.console.fleet import service as sensors
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.db.sessions import open_writing
from boresight.sky import identification
from tests.cli.conftest import assert_refused
from tests.stores import open_migrated, url_in


def in_folder(folder, *words):
    return subprocess.run(
        [sys.executable, "-m", "boresight", *map(str, words)], cwd=folder, capture_output=True, timeout=120, check=False
    )


def test_a_report_goes_to_standard_output_and_no_file_is_made(calibration, tmp_path):
    done = in_folder(tmp_path, "report", calibration, "--out", "-")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(b"<!doctype html>")
    assert done.stdout.rstrip().endswith(b"</html>")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["report.pdf", "report.PDF", "report.docx", "report.json", "report.txt"])
def test_a_report_is_html_and_no_other_ending_is_written(boresight, calibration, tmp_path, name):
    done = boresight("report", calibration, "--out", tmp_path / name)
    assert_refused(done, ".html", lines=1)
    assert ("print it to PDF" in done.stderr) == name.lower().endswith(".pdf")
    assert list(tmp_path.iterdir()) == []


def test_matches_go_to_standard_output_as_csv_and_the_counts_to_standard_error(boresight, simulated):
    words = ("match", simulated / "calibration.csv", "--sensor", simulated / "sensor.json")
    done = boresight(*words, "--out", "-")
    assert done.exit_code == 0, done.stderr
    with (simulated / "calibration.csv").open() as file:
        given = list(csv.DictReader(file))
    found = list(csv.DictReader(io.StringIO(done.stdout)))
    assert [(row["frame"], row["row_px"]) for row in found] == [(row["frame"], row["row_px"]) for row in given]
    assert "frames valid" in done.stderr
    both = boresight(*words, "--out", "-", "--json", "-")
    assert (both.exit_code, both.stdout) == (1, "")


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".jsonl", ".html", ".pdf", ".zip"])
@pytest.mark.parametrize("command", ["calibrate", "check", "match", "evaluate"])
def test_json_is_not_written_under_the_name_of_another_format(boresight, simulated, tmp_path, command, ending):
    words = {"match": ("--out", tmp_path / "out.csv"), "evaluate": ("--parameters", simulated / "truth.json")}
    done = boresight(
        command,
        simulated / "calibration.csv",
        "--sensor",
        simulated / "sensor.json",
        *words.get(command, ()),
        "--json",
        tmp_path / f"result{ending}",
    )
    assert_refused(done, "end the name with .json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ("match", "CALIBRATION", "--sensor", "SENSOR", "--out", "out.txt"),
        ("convert", "SENSOR", "--sensor", "SENSOR", "--to", "pinhole_radial", "--out", "out.csv"),
        ("audit", "export", "--out", "log.csv"),
        ("backup", "--out", "all.json"),
        ("backup", "--out", "-"),
        ("export", "PS-FM1-0", "--out", "package.json"),
        ("simulate", "st16-1", "--out", "-"),
        ("reproduce", "wu", "--quick", "--out", "-"),
    ],
)
def test_a_place_that_cannot_hold_what_is_written_is_refused_in_one_line(
    store, simulated, tmp_path, monkeypatch, words
):
    monkeypatch.chdir(tmp_path)
    files = {"CALIBRATION": simulated / "calibration.csv", "SENSOR": simulated / "sensor.json"}
    done = store(*(files.get(word, word) for word in words))
    assert_refused(done, lines=1)
    assert "unexpected" not in done.stderr
    assert not {"-", "out.txt", "out.csv", "log.csv", "all.json", "package.json"} & {
        path.name for path in tmp_path.iterdir()
    }


@pytest.fixture
def nameless(simulated, tmp_path):
    with (simulated / "calibration.csv").open() as file:
        rows = list(csv.DictReader(file))
    kept = [name for name in rows[0] if name != "star_id" and not name.startswith("q_")]
    path = tmp_path / "nameless.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, kept, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(row for row in rows if int(row["frame"]) < 10)
    return path


def test_where_the_extra_is_missing_and_needed_every_command_says_how_to_install_it(
    boresight, simulated, nameless, tmp_path, monkeypatch
):
    monkeypatch.setattr(identification.importlib.util, "find_spec", lambda _: None)
    how = "pip install 'boresight[lost-in-space]'"
    sensor = ("--sensor", simulated / "sensor.json")
    calibrated = boresight("calibrate", nameless, *sensor, "--json", tmp_path / "result.json")
    matched = boresight("match", nameless, *sensor, "--out", tmp_path / "out.csv")
    evaluated = boresight("evaluate", nameless, *sensor, "--parameters", simulated / "truth.json")
    assert_refused(calibrated, how)
    assert how in json.loads((tmp_path / "result.json").read_text())["advice"][0]
    assert how in matched.stdout
    assert how in evaluated.stdout


def test_nobody_is_told_to_install_what_is_not_needed(boresight, simulated, monkeypatch):
    monkeypatch.setattr(identification.importlib.util, "find_spec", lambda _: None)
    done = boresight("calibrate", simulated / "calibration.csv", "--sensor", simulated / "sensor.json")
    assert done.exit_code == 0, done.stderr
    assert "pip install" not in done.stdout + done.stderr


@pytest.mark.parametrize("member", ["schema", "status", "parameters", "sensor"])
@pytest.mark.parametrize("command", ["report", "assess"])
def test_a_calibration_without_a_member_it_needs_is_refused_by_the_name_of_that_member(
    boresight, calibration, simulated, tmp_path, command, member
):
    document = json.loads(calibration.read_text())
    del document[member]
    cut = tmp_path / "cut.json"
    cut.write_text(json.dumps(document))
    more = ["--out", tmp_path / "report.html"] if command == "report" else ["--sensor", simulated / "sensor.json"]
    done = boresight(command, cut, *more)
    assert_refused(done, f"cut.json is no whole calibration ({member}")


INITIAL = {"s": 1.0, "f_m": 0.05, "u0_px": 512.3, "v0_px": 511.2, "k1": 0.01, "k2": -0.02}
SENSOR = {
    "name": "FM1",
    "detector": {"rows": 1024, "columns": 1024, "pixel_pitch_m": 1.5e-5},
    "camera_model": "pinhole_radial",
    "parity": -1,
    "centroid_sigma_px": 0.1,
    "initial": INITIAL,
    "typical_sigma": {"s": 1e-5, "f_m": 1e-7, "u0_px": 1.0, "v0_px": 1.0, "k1": 1e-2, "k2": 1e-1},
}
DEFINITION = {
    "table_id": "STR_CAM",
    "flight_software_version": "4.2.1",
    "length_bytes": 26,
    "fields": [
        {"name": name.upper(), "parameter": name, "offset_bytes": 4 * place, "type": "float32"}
        for place, name in enumerate(INITIAL)
    ],
    "crc": {"name": "CRC-16/ARC", "offset_bytes": 24},
}


@pytest.fixture
def files(tmp_path):
    for name, document in (("sensor", SENSOR), ("definition", DEFINITION), ("parameters", INITIAL)):
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
    return tmp_path


@pytest.fixture
def stocked(store, tmp_path):
    engine = open_migrated(url_in(tmp_path))
    with open_writing(engine) as session:
        sensors.register_sensor(session, COMMAND_LINE, SENSOR)
    engine.dispose()
    return store


def test_export_writes_the_same_package_each_time(stocked, tmp_path):
    first, again = tmp_path / "a.zip", tmp_path / "b.zip"
    done = stocked("export", "PS-FM1-0", "--out", first)
    stocked("export", "1", "--out", again)
    assert done.exit_code == 0
    assert hashlib.sha256(first.read_bytes()).hexdigest() in done.stdout
    assert first.read_bytes() == again.read_bytes()


def test_an_exported_package_verifies_with_sha256sum(stocked, tmp_path):
    stocked("export", "PS-FM1-0", "--out", tmp_path / "a.zip")
    with zipfile.ZipFile(tmp_path / "a.zip") as packed:
        packed.extractall(tmp_path / "out")
    checked = subprocess.run(["sha256sum", "-c", "SHA256SUMS"], cwd=tmp_path / "out", capture_output=True, check=False)
    assert checked.returncode == 0, checked.stdout


def test_export_names_what_it_cannot_find_and_what_has_no_table(stocked, tmp_path):
    unknown = stocked("export", "PS-FM1-9", "--out", tmp_path / "a.zip")
    other = stocked("export", "1", "--out", tmp_path / "a.zip", "--flight-software", "5")
    assert (unknown.exit_code, other.exit_code) == (1, 1)
    assert "no parameter set PS-FM1-9" in unknown.stderr
    assert "no table definition" in other.stderr


def _table(boresight, files, *words):
    sheets = ("--sensor", files / "sensor.json", "--definition", files / "definition.json")
    return boresight("table", *words, *sheets)


def test_a_table_is_written_and_read_without_a_store(boresight, files):
    image = files / "table.bin"
    written = _table(boresight, files, "encode", files / "parameters.json", "--out", image)
    read = _table(boresight, files, "decode", image)
    assert (written.exit_code, read.exit_code) == (0, 0)
    assert written.stdout.startswith(read.stdout.rstrip("\n"))
    assert "3D4CCCCD" in read.stdout
    assert "rounding moves a star by at most" in written.stdout


def test_a_damaged_table_is_refused_by_its_crc(boresight, files):
    image = files / "table.bin"
    _table(boresight, files, "encode", files / "parameters.json", "--out", image)
    damaged = bytearray(image.read_bytes())
    damaged[5] ^= 1
    image.write_bytes(damaged)
    read = _table(boresight, files, "decode", image)
    assert_refused(read, "CRC of table.bin is not that of its bytes")


def test_a_definition_that_is_no_json_is_refused(boresight, files):
    (files / "definition.json").write_text("{")
    assert "definition.json is not JSON" in _table(boresight, files, "decode", files / "x").stderr
