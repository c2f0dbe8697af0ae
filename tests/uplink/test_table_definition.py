"""Parameters become the bytes that the mission defined, other programs' files of them, and parameters again; a slip is refused."""

import copy
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
from boresight.uplink.table_definition import (
    alignment_numbers,
    crc_told,
    decode,
    encode,
    parse_definition,
    quantised,
    table_crc,
)
from boresight.uplink.table_files import table_files
from tests.effort import effort
from tests.refusals import has_code
from tests.uplink.packages import INITIAL, definitions, make_definition, make_sensor, make_set

PINHOLE = INITIAL["pinhole_radial"]


def _bitwise(content, width, poly, init, refin, refout, xorout):
    register, top = init, 1 << (width - 1)
    for byte in content:
        for place in range(8):
            bit = byte >> (place if refin else 7 - place) & 1
            carried = bool(register & top) != bool(bit)
            register = register << 1 & ((1 << width) - 1)
            register ^= poly if carried else 0
    if refout:
        register = int(f"{register:0{width}b}"[::-1], 2)
    return register ^ xorout


ALGORITHMS = {
    "CRC-16/ARC": (16, 0x8005, 0, True, True, 0),
    "CRC-16/CCITT-FALSE": (16, 0x1021, 0xFFFF, False, False, 0),
    "CRC-32": (32, 0x04C11DB7, 0xFFFFFFFF, True, True, 0xFFFFFFFF),
}


def _definition(document, model="pinhole_radial"):
    return parse_definition(document, make_sensor(model))


@pytest.mark.parametrize(
    ("name", "check"), [("CRC-16/ARC", 0xBB3D), ("CRC-16/CCITT-FALSE", 0x29B1), ("CRC-32", 0xCBF43926)]
)
def test_named_crcs_have_the_published_check_values(name, check):
    crc = _definition(make_definition(crc={"name": name})).crc
    assert crc.value(b"123456789") == check == _bitwise(b"123456789", *ALGORITHMS[name])
    assert int(crc.document()["check"], 16) == check


@given(st.binary(max_size=200), st.sampled_from(sorted(ALGORITHMS)))
def test_a_crc_is_that_of_its_definition_on_any_bytes(content, name):
    crc = _definition(make_definition(crc={"name": name})).crc
    assert crc.value(content) == _bitwise(content, *ALGORITHMS[name])


@given(
    st.binary(min_size=1, max_size=40),
    st.sampled_from([8, 16, 24, 32, 64]),
    st.data(),
)
def test_a_crc_of_the_missions_own_parameters_is_computed_by_them(content, width, data):
    number = st.integers(0, 2**width - 1)
    poly, init, xorout = (data.draw(number) for _ in range(3))
    refin, refout = data.draw(st.booleans()), data.draw(st.booleans())
    own = {"name": "own", "width": width, "poly": poly | 1, "init": init, "refin": refin, "refout": refout}
    crc = _definition(make_definition(crc=own | {"xorout": xorout})).crc
    assert crc.value(content) == _bitwise(content, width, poly | 1, init, refin, refout, xorout)


def test_a_table_is_the_bytes_that_struct_makes_in_either_order_fixed_point_or_inside_a_byte():
    document = make_definition()
    body = struct.pack(">H2s6f2s", 3, b"\xa5\xa5", *PINHOLE.values(), b"\xa5\xa5")
    crc = _bitwise(body[:30], *ALGORITHMS["CRC-16/CCITT-FALSE"])
    assert encode(_definition(document), PINHOLE) == body[:30] + struct.pack(">H", crc)
    document = make_definition(byte_order="little", crc=None)
    document["fields"][2] |= {"type": "int32", "scale": 1e-9}
    values = list(PINHOLE.values())
    expected = struct.pack("<H2sfi4f4s", 3, b"\xa5" * 2, values[0], 50_000_000, *values[2:], b"\xa5" * 4)
    assert encode(_definition(document), PINHOLE) == expected
    inside = make_definition(crc=None, length_bytes=32, fill=0)
    inside["fields"][0] = {"name": "FLAGS", "constant": 5, "offset_bits": 3, "type": "uint7"}
    assert encode(_definition(inside), PINHOLE)[:2] == (5 << 6).to_bytes(2, "big")


def test_a_number_that_does_not_fit_and_an_image_of_another_length_are_refused():
    document = make_definition()
    document["fields"][2] |= {"type": "int16", "scale": 1e-9}
    with pytest.raises(RefusedInputError, match=r"F_M cannot hold 0\.05: a int16 of scale 1e-09.* to 3\.2767e-05"):
        encode(_definition(document), PINHOLE)
    with pytest.raises(RefusedInputError, match=r"3 bytes.*32", check=has_code("wrong-image-size")):
        decode(_definition(make_definition()), b"abc")


@settings(max_examples=effort(30, 150), deadline=None)
@given(definitions())
def test_what_is_encoded_is_decoded_to_within_half_a_step(made):
    model, document = made
    definition, parameters = _definition(document, model), INITIAL[model]
    image = encode(definition, parameters)
    decoded = decode(definition, image)
    assert len(image) == document["length_bytes"]
    assert decoded.crc_ok
    for one in decoded.fields:
        number, field = parameters[one.field.parameter], one.field
        step = field.scale / 2 if not field.floating else 2.0**-24 * abs(number - field.offset)
        assert abs(one.value - number) <= step * (1 + 1e-9) + 1e-12 * max(abs(field.offset), abs(number))


@settings(max_examples=effort(12, 60), deadline=None)
@given(definitions(), st.data())
def test_a_flipped_bit_is_found_by_the_crc_and_named_by_its_field(made, data):
    model, document = made
    definition = _definition(document, model)
    image = encode(definition, INITIAL[model])
    field = data.draw(st.sampled_from(definition.fields))
    bit = data.draw(st.integers(field.bit, field.end - 1))
    flipped = int.from_bytes(image, "big") ^ 1 << (8 * len(image) - 1 - bit)
    before, after = decode(definition, image), decode(definition, flipped.to_bytes(len(image), "big"))
    named = [a.field.name for b, a in zip(before.fields, after.fields, strict=True) if b.hexadecimal != a.hexadecimal]
    assert after.crc_ok is False
    assert named == [field.name]


@settings(max_examples=effort(12, 60), deadline=None)
@given(definitions())
def test_what_the_table_holds_it_holds_for_ever(made):
    model, document = made
    definition = _definition(document, model)
    held = quantised(definition, INITIAL[model])
    assert encode(definition, held) == encode(definition, INITIAL[model])
    assert quantised(definition, held) == held


def test_a_crc_that_is_not_in_the_table_is_of_the_whole_image_and_cfe_tells_its_own():
    definition = _definition(make_definition(crc={"name": "CRC-16/ARC"}))
    image = encode(definition, PINHOLE)
    assert table_crc(definition, image) == _bitwise(image, *ALGORITHMS["CRC-16/ARC"])
    assert decode(definition, image).crc_ok is None
    with_cfe, without = (_definition(make_definition() | more) for more in ({"cfe": {"table_name": "A.B"}}, {}))
    image = encode(without, PINHOLE)
    assert crc_told(with_cfe, image)[1] == _bitwise(image, *ALGORITHMS["CRC-16/ARC"])
    assert crc_told(without, image)[1] == _bitwise(image[:30], *ALGORITHMS["CRC-16/CCITT-FALSE"])
    assert crc_told(_definition(make_definition(crc=None)), image) is None


IDS = {name: 4096 + place for place, name in enumerate(PINHOLE)}


def _field(**changed):
    def change(document):
        document["fields"][1] |= changed

    return change


def _crc(**changed):
    return lambda document: document["crc"].update(changed)


def _entry(key, value):
    return lambda document: document.update({key: value})


def _pus(**changed):
    return _entry("pus", {"parameter_ids": IDS} | changed)


WRONG = {
    "an unknown entry": (
        _entry("lenght_bytes", 3),
        "lenght_bytes is not an entry of a table definition: write length_bytes",
    ),
    "another schema": (_entry("schema", "x/2"), "schema is 'x/2'"),
    "no length": (lambda d: d.pop("length_bytes"), "length_bytes is missing"),
    "a length of parts": (_entry("length_bytes", 32.5), "length_bytes is 32.5"),
    "an order of no kind": (_entry("byte_order", "middle"), "byte_order is 'middle': choose big or little"),
    "no fields": (_entry("fields", []), "fields is not a list"),
    "an empty software version": (_entry("flight_software_version", ""), "flight_software_version is ''"),
    "a type of no kind": (_field(type="float16"), r"fields\[1\].type is 'float16'"),
    "too many bits": (_field(type="uint65"), r"fields\[1\].type is 'uint65'"),
    "an unknown parameter": (_field(parameter="focal"), r"fields\[1\].parameter is 'focal': choose s or f_m"),
    "a name for no ground system": (_field(name="F M"), r"fields\[1\].name is 'F M'"),
    "two places": (_field(offset_bits=3), r"fields\[1\] needs offset_bytes or offset_bits"),
    "a scale of zero": (_field(scale=0), r"fields\[1\].scale is 0"),
    "a scale that is no number": (_field(scale=float("nan")), r"fields\[1\].scale is nan"),
    "a value and a parameter": (_field(constant=3), "names a parameter and a constant"),
    "neither": (lambda d: d["fields"][1].pop("parameter"), r"fields\[1\].constant is missing"),
    "a constant that does not fit": (lambda d: d["fields"][0].update(constant=70000), "VERSION cannot hold 70000"),
    "part of a byte, little-endian": (_field(byte_order="little", type="int12"), "is little-endian, which needs"),
    "a float that begins inside a byte": (
        lambda d: d["fields"].__setitem__(1, {"name": "S", "parameter": "s", "offset_bits": 33, "type": "float32"}),
        "is a float32 that begins inside a byte",
    ),
    "two fields in one place": (
        _field(offset_bytes=0),
        "VERSION begins at bit 0, inside S|S begins at bit 0, inside VERSION",
    ),
    "a field past the end": (_field(offset_bytes=31), "past the 32 bytes of the table|inside"),
    "a name twice": (_field(name="version"), "is the name of 2 fields"),
    "a parameter twice": (_field(parameter="k1"), "the parameter s is in 0 fields"),
    "an unknown CRC": (_entry("crc", {"name": "CRC-15"}), "crc.name is not a known CRC: choose CRC-16/ARC"),
    "a known CRC with other parameters": (
        _crc(width=16, poly=3, init=0, refin=False, refout=False, xorout=0),
        "crc is called CRC-16/CCITT-FALSE but has other parameters",
    ),
    "a CRC with another check value": (_crc(check="0xBB3D"), "crc.check is 0xBB3D, but these parameters make 0x29B1"),
    "a CRC of itself": (_crc(over=[0, 32]), "inside the bytes that it covers"),
    "a CRC of what is not there": (_crc(over=[0, 99]), "crc.over is"),
    "a CRC of no width": (
        _entry("crc", {"name": "x", "width": 12, "poly": 3, "init": 0, "refin": False, "refout": False, "xorout": 0}),
        "crc.width is 12",
    ),
    "a table name too long for cFE": (_entry("cfe", {"table_name": "A." + "B" * 38}), "cfe.table_name is"),
    "a spacecraft of no number": (_entry("cfe", {"table_name": "A.B", "spacecraft_id": -1}), "cfe.spacecraft_id is -1"),
    "an identifier missing": (_pus(parameter_ids={"s": 1}), "pus.parameter_ids.f_m is missing"),
    "an identifier too large": (_pus(id_type="uint8"), "pus.parameter_ids.s is 4096: give a number of 8 bits"),
    "an identifier twice": (_pus(parameter_ids=IDS | {"s": 4097}), "gives one identifier to two parameters"),
    "an identifier of nothing": (_pus(parameter_ids=IDS | {"zoom": 3}), "names 'zoom', which is in no field"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_slip_is_refused_where_it_stands(name):
    change, sentence = WRONG[name]
    document = copy.deepcopy(make_definition())
    change(document)
    with pytest.raises(RefusedInputError, match=sentence):
        parse_definition(document, make_sensor())


def test_what_is_no_object_another_camera_s_table_or_a_type_without_a_pus_code_is_refused():
    document = make_definition()
    document["fields"][1] |= {"type": "uint20", "scale": 1e-3}
    parse_definition(document, make_sensor())
    refused = [(None, "one JSON object"), ([], "one JSON object"), ("x", "one JSON object"), (3, "one JSON object")]
    whole = r"not a whole number of bytes as TC\[20,3\] requires"
    for given_document, sentence in (*refused, (document | {"pus": {"parameter_ids": IDS}}, whole)):
        with pytest.raises(RefusedInputError, match=sentence):
            parse_definition(given_document, make_sensor())
    with pytest.raises(RefusedInputError, match=r"'s': .*f_m"):
        parse_definition(make_definition(), make_sensor("inverted_wang"))


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)
PLACES = [
    (key,) for key in ("table_id", "byte_order", "length_bytes", "fill", "fields", "crc", "cfe", "pus", "schema", "new")
]
PLACES += [
    ("fields", 1, key) for key in ("name", "parameter", "constant", "offset_bits", "type", "scale", "byte_order")
]
PLACES += [("crc", key) for key in ("name", "width", "poly", "offset_bytes", "over", "check")]


@settings(max_examples=effort(60, 300), deadline=None)
@given(st.sampled_from(PLACES), JUNK)
def test_whatever_stands_anywhere_is_read_or_refused_and_nothing_else(place, junk):
    document = copy.deepcopy(make_definition())
    inside = document
    for step in place[:-1]:
        inside = inside[step]
    inside[place[-1]] = junk
    try:
        definition = parse_definition(document, make_sensor())
    except RefusedInputError:
        return
    assert decode(definition, encode(definition, INITIAL["pinhole_radial"])).crc_ok is not False


CFE = {"table_name": "STR_APP.CAMERA", "spacecraft_id": 66, "processor_id": 1, "application_id": 9}


def _defined(**others):
    return parse_definition(make_definition(**others), make_sensor())


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
        (lambda file: file[:-1], "contains 31 bytes and says 32"),
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
    definition = parse_definition(document, make_sensor(model))
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
    document = make_definition(kind="float64")
    document["fields"][1] |= {"type": kind, "scale": 0.5}
    assert type_code(parse_definition(document, make_sensor()).fields[1]) == code


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
    sensor = make_sensor()
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
    text = camera_files(make_sensor(), INITIAL["pinhole_radial"], "PS-FM 1-1")["camera_info.yaml"].decode()
    K, P = _matrix(text, "camera_matrix").reshape(3, 3), _matrix(text, "projection_matrix").reshape(3, 4)
    for line in ("camera_name: PS_FM_1_1\n", "image_width: 1024\n", "distortion_model: plumb_bob\n"):
        assert line in text
    np.testing.assert_array_equal(P, np.column_stack([K, np.zeros(3)]))
    parameters = INITIAL["pinhole_radial"] | {"k1": 1e-07, "k2": 2.5e-9}
    text = camera_files(make_sensor(), parameters, "x")["camera_opencv.yaml"].decode()
    yaml_float = re.compile(r"[-+]?[0-9][0-9_]*\.[0-9]*([eE][-+][0-9]+)?")
    assert "[1.0e-07, 2.5e-09, 0.0, 0.0, 0.0]" in text
    assert all(yaml_float.fullmatch(word) for line in re.findall(r"data: \[(.*?)\]", text) for word in line.split(", "))


@pytest.mark.parametrize(
    ("model", "parity", "reason"),
    [
        ("inverted_wang", -1, "distorts from the detector to the sky"),
        ("inverted_wang", 1, "an approximation would be a different camera"),
        ("pinhole_radial", 1, "would be left-handed"),
    ],
)
def test_a_camera_that_is_none_of_theirs_is_refused_with_the_reason(model, parity, reason):
    files = camera_files(make_sensor(model, parity), INITIAL[model], "PS-FM1-1")
    assert list(files) == ["camera_files.txt"]
    assert files["camera_files.txt"].startswith(b"Refused")
    assert reason in files["camera_files.txt"].decode()


FOUND = {"sentence": "Loading these parameters turns the reported attitude by 4.1 arcsec.", "c_sd_update": [[1.0]]}


def aligned(started_from):
    subject = make_set("inverted_wang", 2, 1e-6, run={"started_from": started_from["document"]["parameters"]})
    subject["document"]["alignment"] = FOUND
    return subject


def test_only_a_turn_against_the_replaced_set_is_given_and_another_withheld_with_the_reason():
    before, other, plain = (
        make_set("inverted_wang", 1),
        make_set("inverted_wang", 1, 5e-6),
        make_set("inverted_wang", 2),
    )
    sets = ((aligned(before), before), (aligned(make_set("inverted_wang", 0)), other), (plain, before))
    told, withheld, unknown = (json.loads(alignment_json(*pair)) for pair in sets)
    assert told["alignment"] == FOUND
    assert told["use"].startswith("C_SD_new = C_SD_old c_sd_update")
    assert withheld["alignment"] is None
    assert "not those of PS-FM1-1" in withheld["sentence"]
    assert unknown["sentence"].startswith("No attitude was compared")


def _aligned(*names):
    document = make_definition()
    begin = document["length_bytes"]
    fields = [
        {"name": f"TURN_{name.upper()}", "alignment": name, "offset_bytes": begin + 8 * place, "type": "float64"}
        for place, name in enumerate(names)
    ]
    return {**document, "length_bytes": begin + 8 * len(names), "fields": [*document["fields"], *fields]}


def test_a_table_may_hold_an_alignment_beside_the_parameters():
    quaternion = np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
    numbers = alignment_numbers(quaternion)
    definition = _definition(_aligned("q_x", "q_y", "q_z", "q_w", "c_12", "c_31"))
    assert definition.is_aligned
    image = encode(definition, PINHOLE, numbers)
    held = {one.field.alignment: one.value for one in decode(definition, image).fields if one.field.alignment}
    assert held == {name: numbers[name] for name in held}
    assert len(held) == 6
    x, y, z, w = quaternion
    assert held["c_12"] == pytest.approx(2 * (x * y - z * w))
    assert decode(definition, image).values == quantised(definition, PINHOLE)


def test_a_table_that_holds_an_alignment_is_not_written_without_one():
    with pytest.raises(RefusedInputError):
        encode(_definition(_aligned("q_x")), PINHOLE)
    twice = _aligned("q_x")
    twice["fields"][-1]["constant"] = 1
    for wrong in (twice, _aligned("q_v")):
        with pytest.raises(RefusedInputError):
            _definition(wrong)
