"""The table as other programs' files: cFE, OpenC3, PUS service 20, OpenCV's and ROS's cameras, and the turn of C_SD."""

import csv
import io
import json
import re
import shlex
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.uplink import cfe
from boresight.uplink.camera_files import camera_files
from boresight.uplink.parameter_files import alignment_json
from boresight.uplink.parameter_service import application_data, type_code
from boresight.uplink.table_definition import encode, parse_definition
from boresight.uplink.table_files import table_files
from tests.effort import effort
from tests.uplink.packages import INITIAL, definition_of, definitions, sensor_of, set_of

PINHOLE = INITIAL["pinhole_radial"]
CFE = {"table_name": "STR_APP.CAMERA", "spacecraft_id": 66, "processor_id": 1, "application_id": 9}
IDS = {name: 4096 + place for place, name in enumerate(PINHOLE)}


def _defined(**others):
    return parse_definition(definition_of(**others), sensor_of())


def test_a_cfe_file_has_the_headers_that_cfe_reads_big_endian_whatever_the_table_is():
    definition = _defined(cfe=CFE | {"description": "Star tracker camera"})
    content = table_files(definition, PINHOLE, "PS-FM1-1")["table.tbl"]
    primary = struct.pack(">IIIIIIII32s", 0x63464531, 8, 64, 66, 1, 9, 0, 0, b"Star tracker camera")
    secondary = struct.pack(">III40s", 0, 0, 32, b"STR_APP.CAMERA")
    assert (len(primary), len(secondary)) == (64, 52)
    assert content == primary + secondary + encode(definition, PINHOLE)
    little = table_files(_defined(cfe=CFE, byte_order="little"), PINHOLE, "PS-" + "x" * 60)["table.tbl"]
    assert struct.unpack(">I", little[8:12]) == (64,)
    assert struct.unpack(">3I", little[64:76]) == (0, 0, 32)
    assert little[32:64] == b"PS-" + b"x" * 28 + b"\0"  # the set where the mission gave none, cut to its room
    assert "table.tbl" not in table_files(_defined(), PINHOLE, "PS")


def test_a_dump_comes_back_with_or_without_its_headers():
    definition = _defined(cfe=CFE)
    files = table_files(definition, PINHOLE, "PS")
    for content in (files["table.tbl"], files["table.bin"]):
        assert cfe.table_image(definition.cfe, 32, content) == files["table.bin"]


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda file: file[:80], "ends after 80 bytes"),
        (lambda file: file[:-1], "holds 31 bytes and says 32"),
        (lambda file: file.replace(b"CAMERA", b"CAMERB"), "is of the table 'STR_APP.CAMERB'"),
        (lambda file: file[:68] + b"\0\0\0\4" + file[72:], "says 32 from byte 4"),
    ],
)
def test_a_cfe_file_of_something_else_is_refused(damage, sentence):
    definition = _defined(cfe=CFE)
    content = damage(table_files(definition, PINHOLE, "PS")["table.tbl"])
    with pytest.raises(RefusedInputError, match=sentence):
        cfe.table_image(definition.cfe, 32, content)


def _rebuilt(text, length):
    image = 0
    for line in text.splitlines():
        words = shlex.split(line)
        if words[:1] != ["PARAMETER"]:
            continue
        bit, size, kind = int(words[2]), int(words[3]), words[4]
        default = words[5] if kind == "BLOCK" else words[7]
        if kind == "BLOCK":
            content = bytes.fromhex(default[2:]).rjust(size // 8, b"\0")
        elif kind == "FLOAT":
            content = struct.pack(">f" if size == 32 else ">d", float(default))
        else:
            assert int(words[5]) <= int(default) <= int(words[6])
            content = (int(default) % (1 << size)).to_bytes(-(-size // 8), "big")
        value = int.from_bytes(content[::-1] if words[-1] == "LITTLE_ENDIAN" else content, "big")
        image |= value << (8 * length - bit - size)
    return image.to_bytes(length, "big")


@settings(max_examples=effort(12, 60), deadline=None)
@given(definitions())
def test_openc3_s_definition_alone_makes_the_image(made):
    model, document = made
    definition = parse_definition(document, sensor_of(model))
    files = table_files(definition, INITIAL[model], "PS-FM1-1")
    assert _rebuilt(files["table_def.txt"].decode(), definition.length_bytes) == files["table.bin"]


def test_openc3_s_definition_is_in_its_words():
    lines = table_files(_defined(), PINHOLE, 'PS "FM1"')["table_def.txt"].decode().splitlines()
    assert lines[1] == 'TABLE "STR_CAM" BIG_ENDIAN KEY_VALUE "PS \'FM1\'"'
    assert lines[2] == '  PARAMETER VERSION 0 16 UINT 0 65535 3 "constant" BIG_ENDIAN'
    assert lines[3] == '  PARAMETER FILL_16 16 16 BLOCK 0xA5A5 "fill" BIG_ENDIAN'
    assert lines[4] == '  PARAMETER S 32 32 FLOAT MIN_FLOAT32 MAX_FLOAT32 1.0 "s" BIG_ENDIAN'
    assert all(re.match(r"  PARAMETER [A-Z]\w* \d+ \d+ (U?INT|FLOAT|BLOCK) ", line) for line in lines[2:])


def test_application_data_of_tc_20_3_is_count_identifiers_and_values():
    definition = _defined(pus={"parameter_ids": IDS, "count_type": "uint16"}, byte_order="little")
    data = application_data(definition.pus, definition.fields, PINHOLE)
    expected = struct.pack(">H", 6) + b"".join(struct.pack(">Hf", IDS[name], value) for name, value in PINHOLE.items())
    assert data == expected
    listed = list(csv.DictReader(io.StringIO(table_files(definition, PINHOLE, "PS")["pus_st20.csv"].decode())))
    assert bytes.fromhex(listed[-1]["raw_hex"]) == expected
    assert {(row["ptc"], row["pfc"]) for row in listed[:-1]} == {("5", "1")}


CODES = {"uint8": (3, 4), "uint16": (3, 12), "uint24": (3, 13), "int32": (4, 14), "int48": (4, 15), "uint64": (3, 16)}


@pytest.mark.parametrize(("kind", "code"), [*CODES.items(), ("float64", (5, 2))])
def test_types_are_told_by_the_codes_of_the_standard(kind, code):
    document = definition_of(kind="float64")
    document["fields"][1] |= {"type": kind, "scale": 0.5}
    assert type_code(parse_definition(document, sensor_of()).fields[1]) == code


def _matrix(text, name):
    body = text.split(f"{name}:", 1)[1]
    return np.array([float(number) for number in re.search(r"data: \[(.*?)\]", body)[1].split(",")])


def _opencv_projection(K, distortion, x, y, z):
    k1, k2, p1, p2, k3 = distortion
    a, b = x / z, y / z
    r2 = a**2 + b**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    c = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a**2)
    d = b * radial + p1 * (r2 + 2 * b**2) + 2 * p2 * a * b
    return K[0] * c + K[2], K[4] * d + K[5]


@settings(max_examples=effort(16, 80), deadline=None)
@given(
    st.floats(0.9, 1.1),
    st.floats(0.02, 0.2),
    st.floats(400, 600),
    st.floats(400, 600),
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    st.sampled_from(["camera_opencv.yaml", "camera_info.yaml"]),
)
def test_opencv_s_own_formula_finds_the_same_pixels(s, f, u0, v0, k1, k2, name):
    parameters = dict(zip(INITIAL["pinhole_radial"], (s, f, u0, v0, k1, k2), strict=True))
    sensor = sensor_of()
    text = camera_files(sensor, parameters, "PS-FM1-1")[name].decode()
    random = np.random.default_rng(1)
    tangents = random.uniform(-0.15, 0.15, (2, 500))
    s_d = np.stack([*tangents, np.ones(500)], axis=-1)  # rows, columns, boresight
    row, column = CAMERA_MODELS["pinhole_radial"].project(
        np.array(list(parameters.values())), s_d, sensor.pixel_pitch_m
    )
    theirs = _opencv_projection(
        _matrix(text, "camera_matrix"), _matrix(text, "distortion_coefficients"), s_d[:, 1], s_d[:, 0], s_d[:, 2]
    )
    np.testing.assert_allclose(theirs, (column, row), rtol=0, atol=1e-9)


def test_sizes_the_projection_and_exponents_are_written_as_ros_and_yaml_read_them():
    text = camera_files(sensor_of(), INITIAL["pinhole_radial"], "PS-FM 1-1")["camera_info.yaml"].decode()
    K, P = _matrix(text, "camera_matrix").reshape(3, 3), _matrix(text, "projection_matrix").reshape(3, 4)
    for line in ("camera_name: PS_FM_1_1\n", "image_width: 1024\n", "distortion_model: plumb_bob\n"):
        assert line in text
    np.testing.assert_array_equal(P, np.column_stack([K, np.zeros(3)]))
    parameters = INITIAL["pinhole_radial"] | {"k1": 1e-07, "k2": 2.5e-9}
    text = camera_files(sensor_of(), parameters, "x")["camera_opencv.yaml"].decode()
    yaml_float = re.compile(r"[-+]?[0-9][0-9_]*\.[0-9]*([eE][-+][0-9]+)?")
    assert "[1.0e-07, 2.5e-09, 0.0, 0.0, 0.0]" in text
    assert all(yaml_float.fullmatch(word) for line in re.findall(r"data: \[(.*?)\]", text) for word in line.split(", "))


@pytest.mark.parametrize(
    ("model", "parity", "reason"),
    [
        ("inverted_wang", -1, "distorts from the detector to the sky"),
        ("inverted_wang", 1, "an approximation is another camera"),
        ("pinhole_radial", 1, "would be left-handed"),
    ],
)
def test_a_camera_that_is_none_of_theirs_is_refused_with_the_reason(model, parity, reason):
    files = camera_files(sensor_of(model, parity), INITIAL[model], "PS-FM1-1")
    assert list(files) == ["camera_files.txt"]
    assert files["camera_files.txt"].startswith(b"Refused")
    assert reason in files["camera_files.txt"].decode()


FOUND = {"sentence": "Loading these parameters turns the reported attitude by 4.1 arcsec.", "c_sd_update": [[1.0]]}


def aligned(started_from):
    subject = set_of("inverted_wang", 2, 1e-6, run={"started_from": started_from["document"]["parameters"]})
    subject["document"]["alignment"] = FOUND
    return subject


def test_only_a_turn_against_the_replaced_set_is_given_and_another_withheld_with_the_reason():
    before, other, plain = set_of("inverted_wang", 1), set_of("inverted_wang", 1, 5e-6), set_of("inverted_wang", 2)
    sets = ((aligned(before), before), (aligned(set_of("inverted_wang", 0)), other), (plain, before))
    told, withheld, unknown = (json.loads(alignment_json(*pair)) for pair in sets)
    assert told["alignment"] == FOUND
    assert told["use"].startswith("C_SD_new = C_SD_old c_sd_update")
    assert withheld["alignment"] is None
    assert "not those of PS-FM1-1" in withheld["sentence"]
    assert unknown["sentence"].startswith("No attitude was compared")
