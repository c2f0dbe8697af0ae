"""Parameters become the bytes that the mission defined, and bytes become parameters again."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.uplink.table_definition import (
    crc_told,
    decode,
    encode,
    parse_definition,
    quantised,
    table_crc,
)
from tests.effort import effort
from tests.uplink.tables import INITIAL, definition_of, definitions, sensor_of

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
    return parse_definition(document, sensor_of(model))


@pytest.mark.parametrize(
    ("name", "check"), [("CRC-16/ARC", 0xBB3D), ("CRC-16/CCITT-FALSE", 0x29B1), ("CRC-32", 0xCBF43926)]
)
def test_named_crcs_have_the_published_check_values(name, check):
    crc = _definition(definition_of(crc={"name": name})).crc
    assert crc.value(b"123456789") == check == _bitwise(b"123456789", *ALGORITHMS[name])
    assert int(crc.document()["check"], 16) == check


@given(st.binary(max_size=200), st.sampled_from(sorted(ALGORITHMS)))
def test_a_crc_is_that_of_its_definition_on_any_bytes(content, name):
    crc = _definition(definition_of(crc={"name": name})).crc
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
    crc = _definition(definition_of(crc=own | {"xorout": xorout})).crc
    assert crc.value(content) == _bitwise(content, width, poly | 1, init, refin, refout, xorout)


def test_a_table_is_the_bytes_that_struct_makes():
    document = definition_of()
    body = struct.pack(">H2s6f2s", 3, b"\xa5\xa5", *PINHOLE.values(), b"\xa5\xa5")
    crc = _bitwise(body[:30], *ALGORITHMS["CRC-16/CCITT-FALSE"])
    assert encode(_definition(document), PINHOLE) == body[:30] + struct.pack(">H", crc)


def test_little_endian_and_fixed_point_are_the_bytes_that_struct_makes():
    document = definition_of(byte_order="little", crc=None)
    document["fields"][2] |= {"type": "int32", "scale": 1e-9}
    values = list(PINHOLE.values())
    expected = struct.pack("<H2sfi4f4s", 3, b"\xa5" * 2, values[0], 50_000_000, *values[2:], b"\xa5" * 4)
    assert encode(_definition(document), PINHOLE) == expected


def test_a_field_may_begin_and_end_inside_a_byte():
    document = definition_of(crc=None, length_bytes=32, fill=0)
    document["fields"][0] = {"name": "FLAGS", "constant": 5, "offset_bits": 3, "type": "uint7"}
    image = encode(_definition(document), PINHOLE)
    assert image[:2] == (5 << 6).to_bytes(2, "big")


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


def test_a_crc_that_is_not_in_the_table_is_taken_of_the_whole_image():
    definition = _definition(definition_of(crc={"name": "CRC-16/ARC"}))
    image = encode(definition, PINHOLE)
    assert table_crc(definition, image) == _bitwise(image, *ALGORITHMS["CRC-16/ARC"])
    assert decode(definition, image).crc_ok is None


def test_a_number_that_does_not_fit_is_refused_with_what_does():
    document = definition_of()
    document["fields"][2] |= {"type": "int16", "scale": 1e-9}
    with pytest.raises(RefusedInputError, match=r"F_M cannot hold 0\.05: a int16 of scale 1e-09.* to 3\.2767e-05"):
        encode(_definition(document), PINHOLE)


def test_an_image_of_another_length_is_refused():
    with pytest.raises(RefusedInputError, match="has 3 bytes and the table STR_CAM has 32"):
        decode(_definition(definition_of()), b"abc")


def test_cfe_tells_its_own_crc_of_the_whole_image_and_others_tell_the_table_s():
    with_cfe, without = (_definition(definition_of() | more) for more in ({"cfe": {"table_name": "A.B"}}, {}))
    image = encode(without, PINHOLE)
    assert crc_told(with_cfe, image)[1] == _bitwise(image, *ALGORITHMS["CRC-16/ARC"])
    assert crc_told(without, image)[1] == _bitwise(image[:30], *ALGORITHMS["CRC-16/CCITT-FALSE"])
    assert crc_told(_definition(definition_of(crc=None)), image) is None
