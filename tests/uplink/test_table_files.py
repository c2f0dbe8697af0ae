"""The table as other programs' files: cFE's headers, OpenC3's definition, the request of PUS service 20."""

import csv
import io
import re
import shlex
import struct

import pytest
from hypothesis import given, settings

from boresight.errors import RefusedInputError
from boresight.uplink import cfe
from boresight.uplink.parameter_service import application_data, type_code
from boresight.uplink.table_definition import encode, parse_definition
from boresight.uplink.table_files import table_files
from tests.effort import effort
from tests.uplink.tables import INITIAL, definition_of, definitions, sensor_of

PINHOLE = INITIAL["pinhole_radial"]
CFE = {"table_name": "STR_APP.CAMERA", "spacecraft_id": 66, "processor_id": 1, "application_id": 9}
IDS = {name: 4096 + place for place, name in enumerate(PINHOLE)}


def _defined(**others):
    return parse_definition(definition_of(**others), sensor_of())


def test_a_cfe_file_has_the_headers_that_cfe_reads():
    definition = _defined(cfe=CFE | {"description": "Star tracker camera"})
    content = table_files(definition, PINHOLE, "PS-FM1-1")["table.tbl"]
    primary = struct.pack(">IIIIIIII32s", 0x63464531, 8, 64, 66, 1, 9, 0, 0, b"Star tracker camera")
    secondary = struct.pack(">III40s", 0, 0, 32, b"STR_APP.CAMERA")
    assert (len(primary), len(secondary)) == (64, 52)
    assert content == primary + secondary + encode(definition, PINHOLE)


def test_cfe_s_headers_are_big_endian_whatever_the_table_is():
    content = table_files(_defined(cfe=CFE, byte_order="little"), PINHOLE, "PS")["table.tbl"]
    assert struct.unpack(">I", content[8:12]) == (64,)
    assert struct.unpack(">3I", content[64:76]) == (0, 0, 32)


def test_the_description_is_the_set_where_the_mission_gave_none_and_is_cut_to_its_room():
    content = table_files(_defined(cfe=CFE), PINHOLE, "PS-" + "x" * 60)["table.tbl"]
    assert content[32:64] == b"PS-" + b"x" * 28 + b"\0"


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


def test_without_cfe_there_is_no_cfe_file():
    assert "table.tbl" not in table_files(_defined(), PINHOLE, "PS")


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


@pytest.mark.parametrize(
    ("kind", "code"),
    [
        ("uint8", (3, 4)),
        ("uint16", (3, 12)),
        ("uint24", (3, 13)),
        ("int32", (4, 14)),
        ("int48", (4, 15)),
        ("uint64", (3, 16)),
        ("float64", (5, 2)),
    ],
)
def test_types_are_told_by_the_codes_of_the_standard(kind, code):
    document = definition_of(kind="float64")
    document["fields"][1] |= {"type": kind, "scale": 0.5}
    assert type_code(parse_definition(document, sensor_of()).fields[1]) == code
