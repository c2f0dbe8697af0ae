"""A package is the same bytes wherever and whenever it is built, and everything in it agrees with everything else."""

import csv
import hashlib
import io
import json
import os
import re
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import pytest

from boresight.errors import RefusedInputError
from boresight.uplink.package import build_package
from tests.uplink.packages import GATE, INITIAL, definition_of, inputs_of, set_of

ROOT = Path(__file__).resolve().parents[2]
MODELS = sorted(INITIAL)
IDS = {name: 4096 + place for place, name in enumerate(INITIAL["pinhole_radial"])}


def _files(inputs):
    with zipfile.ZipFile(io.BytesIO(build_package(inputs))) as packed:
        assert packed.testzip() is None
        return {name: packed.read(name) for name in packed.namelist()}


def _rows(content):
    return list(csv.DictReader(io.StringIO(content.decode())))


@pytest.fixture(scope="module", params=MODELS)
def files(request):
    return _files(inputs_of(request.param))


def test_processes_in_other_places_build_the_same_bytes_and_other_inputs_make_others():
    content, hashes = build_package(inputs_of()), set()
    assert content != build_package(inputs_of() | {"backout": set_of("pinhole_radial", 0)})
    command = [sys.executable, "-m", "tests.uplink.packages"]
    for seed, zone, language in (
        ("0", "UTC", "C.UTF-8"),
        ("42", "Asia/Kathmandu", "C"),
        ("7", "America/Caracas", "C.UTF-8"),
    ):
        environment = os.environ | {"PYTHONHASHSEED": seed, "TZ": zone, "LC_ALL": language}
        environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(ROOT / "backend")])
        given = {"input": json.dumps(inputs_of()), "env": environment, "cwd": ROOT}
        hashes.add(subprocess.run(command, **given, capture_output=True, text=True, check=True).stdout)
    assert hashes == {hashlib.sha256(content).hexdigest()}


def test_the_archive_knows_no_clock_and_no_machine():
    with zipfile.ZipFile(io.BytesIO(build_package(inputs_of()))) as packed:
        entries = packed.infolist()
    assert {entry.date_time for entry in entries} == {(1980, 1, 1, 0, 0, 0)}
    assert {(entry.compress_type, entry.create_system) for entry in entries} == {(zipfile.ZIP_STORED, 3)}
    assert [entry.filename for entry in entries] == sorted(entry.filename for entry in entries)


def test_sums_name_every_file_and_the_way_back_has_the_same_files_of_the_other_set(files):
    listed = dict(line.split("  ")[::-1] for line in files["SHA256SUMS"].decode().splitlines())
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in files.items() if name != "SHA256SUMS"}
    assert listed == hashes
    assert hashes["parameter_set.json"] == json.loads(files["MANIFEST.json"])["parameter_set"]["sha256"]
    top = {name for name in files if "/" not in name} - {"MANIFEST.json", "SHA256SUMS", "table_definition.json"}
    assert {name.removeprefix("backout/") for name in files if name.startswith("backout/")} == top
    rows, back = _rows(files["parameters.csv"]), _rows(files["backout/parameters.csv"])
    assert [(row["old"], row["new"]) for row in rows] == [(row["new"], row["old"]) for row in back]


@pytest.mark.parametrize("model", MODELS)
def test_it_can_be_built_again_of_its_own_manifest(model):
    content = build_package(inputs_of(model))
    manifest = json.loads(_files(inputs_of(model))["MANIFEST.json"])
    assert build_package(manifest["inputs"]) == content


def test_the_sheet_marks_a_gate_that_is_only_observed():
    inputs = inputs_of()
    said = []
    for observed in (False, True):
        gates = inputs["subject"]["gates"] | {"document": {"gates": [GATE | {"observe_only": observed}]}}
        sheet = _files(inputs | {"subject": inputs["subject"] | {"gates": gates}})["verification_sheet.html"]
        said.append(b"<td>FAIL (observed only)</td>" in sheet)
    assert said == [False, True]


def test_what_is_active_on_board_is_there_too_where_it_is_neither():
    files = _files(inputs_of() | {"active": set_of("pinhole_radial", 0, -1e-6)})
    manifest = json.loads(files["MANIFEST.json"])
    assert json.loads(files["on_board/parameters.json"])["parameter_set"]["name"] == "PS-FM1-0"
    assert "PS-FM1-0 is recorded as active" in manifest["backout"]["sentence"]


def test_parameters_json_says_what_its_numbers_mean_and_parameters_csv_has_their_arithmetic(files):
    document = json.loads(files["parameters.json"])
    names = [parameter["name"] for parameter in document["parameters"]]
    assert names == list(INITIAL[document["camera_model"]])
    assert {step.split(" = ")[0] for step in document["equation"]["steps"]} >= {"B"}
    assert all({"value", "sigma", "unit", "symbol", "estimated", "on_board"} <= set(p) for p in document["parameters"])
    assert document["covariance"]["names"] == names
    assert "row 0, column 0" in document["conventions"]["pixel_origin"]
    held = {row["parameter"]: row for row in _rows(files["table_report.csv"])}
    for row in _rows(files["parameters.csv"]):
        old, new, sigma = (float(row[key]) for key in ("old", "new", "sigma"))
        assert float(row["delta"]) == new - old
        assert float(row["three_sigma"]) == 3 * sigma
        assert float(row["delta_over_sigma"]) == (new - old) / sigma
        assert (row["raw_hex"], row["on_board"]) == (held[row["name"]]["hex"], held[row["name"]]["value"])


def test_the_hex_text_is_the_image_and_quantisation_is_small_for_single_precision(files):
    lines = [line.partition(": ")[2].replace(" ", "") for line in files["table.hex.txt"].decode().splitlines()]
    assert bytes.fromhex("".join(lines)) == files["table.bin"]
    document = json.loads(files["quantisation.json"])
    assert 0 < document["max_px"] < 1e-3
    assert document["sentence"].startswith("The table's number format moves a star by at most")


def test_the_manifest_names_the_crc_with_all_its_parameters():
    document = definition_of() | {"crc": {"name": "CRC-32"}}
    files = _files(inputs_of(definition=document))
    crc = json.loads(files["MANIFEST.json"])["tables"]["."]["crc"]
    assert int(crc["value"], 16) == zlib.crc32(files["table.bin"])
    assert (crc["width"], crc["poly"], crc["check"]) == (32, "0x04C11DB7", "0xCBF43926")


def test_the_sheet_escapes_what_people_wrote_and_has_changes_signatures_waivers_and_steps(files):
    sheet = files["verification_sheet.html"].decode()
    assert "<script" not in sheet
    assert "Cy &lt;b&gt;Approver&lt;/b&gt;" in sheet
    assert "default-src &#39;none&#39;" in sheet or "default-src 'none'" in sheet
    assert not re.search(r"(?:src|href)=", sheet)
    crc = json.loads(files["MANIFEST.json"])["tables"]["."]["crc"]["value"]
    people = ("2026-11-21T09:00:00.000000Z", "I approve this set", "WAIVED", "One corner has no stars")
    steps = (f". {step}</td>" for step in ("Check the package", "Load", "Check", "Activate", "Dump", "Compare"))
    for word in (*people, crc, "4.2.1", *steps):
        assert word in sheet


def test_without_a_definition_nothing_is_made_up_and_a_way_back_that_does_not_fit_is_refused():
    files = _files(inputs_of() | {"definition": None})
    assert not [name for name in files if "table" in name or "pus" in name or "quantisation" in name]
    assert all(row["type"] == "float64" for row in _rows(files["parameters.csv"]))
    assert json.loads(files["MANIFEST.json"])["flight_software_version"] is None
    document = definition_of()
    document["fields"][2] |= {"type": "uint16", "scale": 1e-9, "offset": 0.05}
    with pytest.raises(RefusedInputError, match="PS-FM1-1 does not fit into the table STR_CAM"):
        build_package(inputs_of(definition=document) | {"backout": set_of("pinhole_radial", 1, -1e-3)})


def test_pus_is_listed_only_where_it_is_configured(files):
    assert "pus_st20.csv" not in files
    listed = _rows(_files(inputs_of(definition=definition_of(pus={"parameter_ids": IDS})))["pus_st20.csv"])
    assert [row["parameter_id"] for row in listed[:-1]] == [f"0x{number:04X}" for number in IDS.values()]
    assert "decided by the on-board software" in listed[-1]["note"]


def test_a_simulated_sensor_is_said_to_be_one_and_the_way_back_is_named_with_its_crc(files):
    simulated = _files(inputs_of() | {"simulated": True})
    assert json.loads(simulated["MANIFEST.json"])["simulated"] is True
    assert b"SIMULATED: " in simulated["verification_sheet.html"]
    assert b"SIMULATED: " not in files["verification_sheet.html"]
    told = json.loads(files["MANIFEST.json"])["tables"]["backout/"]["crc_told"]["value"]
    assert "load the way back. backout/ is PS-FM1-1" in files["verification_sheet.html"].decode()
    assert told in files["verification_sheet.html"].decode()
    assert "load the way back" not in files["backout/verification_sheet.html"].decode()
