"""Packages and tables from the command line."""

import hashlib
import json
import subprocess
import zipfile

import pytest

from boresight.console.fleet import service as sensors
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.db.sessions import open_writing
from tests.stores import open_migrated, url_in

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
    assert read.exit_code == 1
    assert "CRC of table.bin is not that of its bytes" in read.stderr


def test_a_definition_that_is_no_json_is_refused(boresight, files):
    (files / "definition.json").write_text("{")
    assert "definition.json is not JSON" in _table(boresight, files, "decode", files / "x").stderr
