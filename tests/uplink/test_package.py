"""A package is the same bytes wherever it is built and agrees with itself; a dump is compared with it bit by bit and by meaning."""

import csv
import hashlib
import io
import json
import math
import os
import re
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.figures.example_calibration import get_example_calibrations
from boresight.telemetry.sensors import parse_sensor
from boresight.uplink.comparison import FILL, compare
from boresight.uplink.package import build_package
from boresight.uplink.parameter_service import ATOMICITY
from boresight.uplink.table_definition import encode, parse_definition
from tests.refusals import has_code
from tests.uplink.packages import GATE, INITIAL, make_definition, make_inputs, make_set

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
    return _files(make_inputs(request.param))


@pytest.mark.full
def test_processes_in_other_places_build_the_same_bytes_and_other_inputs_make_others():
    content, hashes = build_package(make_inputs()), set()
    assert content != build_package(make_inputs() | {"backout": make_set("pinhole_radial", 0)})
    command = [sys.executable, "-m", "tests.uplink.packages"]
    for seed, zone, language in (
        ("0", "UTC", "C.UTF-8"),
        ("42", "Asia/Kathmandu", "C"),
        ("7", "America/Caracas", "C.UTF-8"),
    ):
        environment = os.environ | {"PYTHONHASHSEED": seed, "TZ": zone, "LC_ALL": language}
        environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(ROOT / "backend")])
        given = {"input": json.dumps(make_inputs()), "env": environment, "cwd": ROOT}
        hashes.add(subprocess.run(command, **given, capture_output=True, text=True, check=True).stdout)
    assert hashes == {hashlib.sha256(content).hexdigest()}


def test_the_archive_knows_no_clock_and_no_machine():
    with zipfile.ZipFile(io.BytesIO(build_package(make_inputs()))) as packed:
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
    content = build_package(make_inputs(model))
    manifest = json.loads(_files(make_inputs(model))["MANIFEST.json"])
    assert build_package(manifest["inputs"]) == content


def test_the_sheet_marks_a_gate_that_is_only_observed():
    inputs = make_inputs()
    said = []
    for observed in (False, True):
        gates = inputs["subject"]["gates"] | {"document": {"gates": [GATE | {"observe_only": observed}]}}
        sheet = _files(inputs | {"subject": inputs["subject"] | {"gates": gates}})["verification_sheet.html"]
        said.append(b"<td>FAIL (observe only)</td>" in sheet)
    assert said == [False, True]


def test_what_is_active_on_board_is_there_too_where_it_is_neither():
    files = _files(make_inputs() | {"active": make_set("pinhole_radial", 0, -1e-6)})
    manifest = json.loads(files["MANIFEST.json"])
    assert json.loads(files["on_board/parameters.json"])["parameter_set"]["name"] == "PS-FM1-0"
    assert "The set recorded as active on board is PS-FM1-0" in manifest["backout"]["sentence"]


def test_parameters_json_says_what_its_numbers_mean_and_parameters_csv_has_their_arithmetic(files):
    document = json.loads(files["parameters.json"])
    names = [parameter["name"] for parameter in document["parameters"]]
    assert names == list(INITIAL[document["camera_model"]])
    assert document["equation"]["steps"] == list(CAMERA_MODELS[document["camera_model"]].equations.steps)
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
    document = make_definition() | {"crc": {"name": "CRC-32"}}
    files = _files(make_inputs(definition=document))
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
    files = _files(make_inputs() | {"definition": None})
    assert not [name for name in files if "table" in name or "pus" in name or "quantisation" in name]
    assert all(row["type"] == "float64" for row in _rows(files["parameters.csv"]))
    assert json.loads(files["MANIFEST.json"])["flight_software_version"] is None
    document = make_definition()
    document["fields"][2] |= {"type": "uint16", "scale": 1e-9, "offset": 0.05}
    with pytest.raises(RefusedInputError, match=r"PS-FM1-1.*STR_CAM", check=has_code("does-not-fit")):
        build_package(make_inputs(definition=document) | {"backout": make_set("pinhole_radial", 1, -1e-3)})


def test_pus_is_listed_only_where_it_is_configured(files):
    assert "pus_st20.csv" not in files
    listed = _rows(_files(make_inputs(definition=make_definition(pus={"parameter_ids": IDS})))["pus_st20.csv"])
    assert [row["parameter_id"] for row in listed[:-1]] == [f"0x{number:04X}" for number in IDS.values()]
    assert ATOMICITY in listed[-1]["note"]


def test_a_simulated_sensor_is_said_to_be_one_and_the_way_back_is_named_with_its_crc(files):
    simulated = _files(make_inputs() | {"simulated": True})
    assert json.loads(simulated["MANIFEST.json"])["simulated"] is True
    assert b"SIMULATED: " in simulated["verification_sheet.html"]
    assert b"SIMULATED: " not in files["verification_sheet.html"]
    told = json.loads(files["MANIFEST.json"])["tables"]["backout/"]["crc_told"]["value"]
    assert "load the back-out table. backout/ is PS-FM1-1" in files["verification_sheet.html"].decode()
    assert told in files["verification_sheet.html"].decode()
    assert "back-out table" not in files["backout/verification_sheet.html"].decode()


SENSOR = parse_sensor(
    {
        "name": "ST-1",
        "detector": {"rows": 1944, "columns": 2592, "pixel_pitch_m": 2.2e-6},
        "camera_model": "pinhole_radial",
        "parity": 1,
        "centroid_sigma_px": 0.15,
        "initial": {"s": 1.0, "f_m": 0.016, "u0_px": 1295.5, "v0_px": 971.5, "k1": 0.01, "k2": 0.0},
        "typical_sigma": {"s": 1e-3, "f_m": 1e-4, "u0_px": 20.0, "v0_px": 20.0, "k1": 0.05, "k2": 0.5},
    }
)
VALUES = {"s": 1.0, "f_m": 0.016, "u0_px": 1290.25, "v0_px": 970.75, "k1": 0.0123, "k2": -0.25}
# byte 0..1 version, 2..3 fill, f_m 4..7, u0 8..11 fixed point, v0 12..19 little-endian, k1 20..23, k2 24..27, s in
# 12 bits of bytes 28 and 29, four bits of fill, CRC 30..31
DEFINITION = parse_definition(
    {
        "table_id": "STR_CAM",
        "flight_software_version": "4.2.1",
        "byte_order": "big",
        "length_bytes": 32,
        "fill": 0xA5,
        "fields": [
            {"name": "VERSION", "constant": 3, "offset_bytes": 0, "type": "uint16"},
            {"name": "FOCAL", "parameter": "f_m", "offset_bytes": 4, "type": "float32"},
            {"name": "U0", "parameter": "u0_px", "offset_bytes": 8, "type": "uint32", "scale": 2**-16},
            {"name": "V0", "parameter": "v0_px", "offset_bytes": 12, "type": "float64", "byte_order": "little"},
            {"name": "K1", "parameter": "k1", "offset_bytes": 20, "type": "float32"},
            {"name": "K2", "parameter": "k2", "offset_bytes": 24, "type": "float32"},
            {"name": "S", "parameter": "s", "offset_bits": 224, "type": "uint12", "scale": 2**-10},
        ],
        "crc": {"name": "CRC-16/CCITT-FALSE", "offset_bytes": 30, "over": [0, 30]},
    },
    SENSOR,
)
SENT = encode(DEFINITION, VALUES)
PLACES = (
    (0, 16, "VERSION"), (16, 32, FILL), (32, 64, "FOCAL"), (64, 96, "U0"), (96, 160, "V0"), (160, 192, "K1"),
    (192, 224, "K2"), (224, 236, "S"), (236, 240, FILL),
)  # fmt: skip


def flipped(*bits: int) -> bytes:
    image = int.from_bytes(SENT, "big")
    for bit in bits:
        image ^= 1 << (8 * len(SENT) - 1 - bit)
    return image.to_bytes(len(SENT), "big")


def where(bit: int) -> str:
    return next((name for first, end, name in PLACES if first <= bit < end), "CRC")


def test_what_was_sent_matches_itself_and_without_a_stored_crc_a_difference_has_no_cause() -> None:
    comparison = compare(DEFINITION, SENT, SENT)
    assert comparison.matches
    assert comparison.sentence == "All 32 bytes match what was sent."
    assert comparison.document()["fields"] == []
    plain = parse_definition({key: value for key, value in DEFINITION.document.items() if key != "crc"}, SENSOR)
    sent = encode(plain, VALUES)
    altered = compare(plain, sent, sent[:-1] + bytes([sent[-1] ^ 1]))
    assert altered.sentence == "1 of 32 bytes differs: bit 7 of byte 31 (mask 0x01), in fill."


@given(bit=st.integers(0, 8 * len(SENT) - 1))
def test_any_single_flipped_bit_is_found_and_named(bit: int) -> None:
    comparison = compare(DEFINITION, SENT, flipped(bit))
    assert not comparison.matches
    (only,) = comparison.differing
    assert (only.offset, only.bits) == (bit // 8, (bit % 8,))
    assert only.expected ^ only.found == 0x80 >> bit % 8
    field = where(bit)
    named = only.fields[0]
    assert named == field if field != "CRC" else "CRC" in named.upper()
    assert f"bit {bit % 8} of byte {bit // 8} (mask 0x{0x80 >> bit % 8:02X}), in {named}" in comparison.sentence
    assert [one.expected.field.name for one in comparison.fields] == [field] * (field not in {FILL, "CRC"})
    assert comparison.crc_ok is False


@given(bits=st.sets(st.integers(0, 8 * len(SENT) - 1), min_size=1))
def test_every_flipped_bit_is_counted_once_and_nothing_else_is(bits: set[int]) -> None:
    comparison = compare(DEFINITION, SENT, flipped(*bits))
    assert {8 * one.offset + bit for one in comparison.differing for bit in one.bits} == bits
    touched = {where(bit) for bit in bits} - {FILL, "CRC"}
    assert {one.expected.field.name for one in comparison.fields} == touched


def test_a_field_is_shown_with_value_and_hex_on_both_sides_and_what_json_has_no_number_for_in_words() -> None:
    document = compare(DEFINITION, SENT, flipped(8 * 5 + 3)).document()
    (field,) = document["fields"]
    found = struct.unpack(">f", struct.pack(">I", struct.unpack(">I", struct.pack(">f", 0.016))[0] ^ 0x00100000))[0]
    assert (field["name"], field["parameter"], field["offset_bytes"]) == ("FOCAL", "f_m", 4)
    assert (field["expected_hex"], field["found_hex"]) == (SENT[4:8].hex().upper(), flipped(43)[4:8].hex().upper())
    assert math.isclose(field["expected"], 0.016, rel_tol=1e-7)
    assert field["found"] == found
    sides = {"expected_hex": f"{SENT[5]:02X}", "found_hex": f"{SENT[5] ^ 0x10:02X}"}
    assert document["bytes"] == [{"offset": 5, "bits": [3], "fields": ["FOCAL"], **sides}]
    infinite = SENT[:4] + struct.pack(">f", math.inf) + SENT[8:]
    (field,) = compare(DEFINITION, SENT, infinite).document()["fields"]
    assert (field["found"], field["found_hex"]) == ("inf", "7F800000")


def test_other_values_are_told_from_damage_by_the_dumps_own_crc_and_many_differences_are_counted() -> None:
    other = compare(DEFINITION, SENT, encode(DEFINITION, VALUES | {"f_m": 0.0161}))
    assert (other.crc_ok, "other values were loaded" in other.sentence) == (True, True)
    damaged = compare(DEFINITION, SENT, flipped(100))
    assert (damaged.crc_ok, "altered in memory or during downlink" in damaged.sentence) == (False, True)
    sentence = compare(DEFINITION, SENT, bytes(255 - byte for byte in SENT)).sentence
    assert sentence.startswith("32 of 32 bytes differ: all bits of byte 0 (mask 0xFF), in VERSION; ")
    assert "; and 29 more." in sentence


@pytest.mark.parametrize("dump", [b"", SENT[:-1], SENT + b"\0"])
def test_a_dump_of_another_length_is_refused_with_both_lengths(dump: bytes) -> None:
    with pytest.raises(RefusedInputError, match=f"{len(dump)} bytes .* has 32"):
        compare(DEFINITION, SENT, dump)


def test_what_the_camera_leaves_travels_as_a_table_with_sigmas_that_says_what_it_is():
    spline = get_example_calibrations()["batch"].to_dict()["trust"]["residual_spline"] | {"structure": True}
    subject = make_set("pinhole_radial", 2, 1e-6, "APPROVED")
    subject["document"]["residual_spline"] = spline
    files = _files(make_inputs(subject=subject))
    table, rows = json.loads(files["correction_table.json"]), _rows(files["correction_table.csv"])
    assert table["schema"] == "boresight.correction-table/1"
    assert table["parameter_set"] == {"name": subject["name"], "sha256": subject["sha256"]}
    assert set(table["units"]) == {"places", "displacements", "sigma"}
    assert len(rows) == len(table["row_px"]) * len(table["col_px"])
    n = len(table["col_px"])
    for i, j in ((0, 0), (3, 5), (-1, -1)):
        row = rows[(i % len(table["row_px"])) * n + j % n]
        assert [float(row["row_px"]), float(row["col_px"])] == [table["row_px"][i], table["col_px"][j]]
        for name in ("d_row_px", "sigma_row_px", "d_col_px", "sigma_col_px"):
            assert float(row[name]) == table[name][i][j]
    assert json.loads(files["MANIFEST.json"])["correction_table"]["files"] == [
        "correction_table.json",
        "correction_table.csv",
    ]
    assert "correction_table.json" not in {name.rpartition("/")[2] for name in _files(make_inputs())}
