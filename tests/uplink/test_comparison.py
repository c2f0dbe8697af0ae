"""A dump against what was sent: whatever differs is named, down to the bit, and nothing else is."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.telemetry.sensors import parse_sensor
from boresight.uplink.comparison import FILL, compare
from boresight.uplink.table_definition import encode, parse_definition

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
    assert comparison.sentence == "All 32 bytes are as they were sent."
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
    assert (damaged.crc_ok, "altered in memory or on the way down" in damaged.sentence) == (False, True)
    sentence = compare(DEFINITION, SENT, bytes(255 - byte for byte in SENT)).sentence
    assert sentence.startswith("32 of 32 bytes differ: all bits of byte 0 (mask 0xFF), in VERSION; ")
    assert "; and 29 more." in sentence


@pytest.mark.parametrize("dump", [b"", SENT[:-1], SENT + b"\0"])
def test_a_dump_of_another_length_is_refused_with_both_lengths(dump: bytes) -> None:
    with pytest.raises(RefusedInputError, match=f"{len(dump)} bytes .* has 32"):
        compare(DEFINITION, SENT, dump)
