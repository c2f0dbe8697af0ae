"""Parameters become the bytes that the mission defined and parameters again; a definition with a slip is refused by its place."""

import copy
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
from tests.uplink.packages import INITIAL, definition_of, definitions, sensor_of

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


def test_a_table_is_the_bytes_that_struct_makes_in_either_order_fixed_point_or_inside_a_byte():
    document = definition_of()
    body = struct.pack(">H2s6f2s", 3, b"\xa5\xa5", *PINHOLE.values(), b"\xa5\xa5")
    crc = _bitwise(body[:30], *ALGORITHMS["CRC-16/CCITT-FALSE"])
    assert encode(_definition(document), PINHOLE) == body[:30] + struct.pack(">H", crc)
    document = definition_of(byte_order="little", crc=None)
    document["fields"][2] |= {"type": "int32", "scale": 1e-9}
    values = list(PINHOLE.values())
    expected = struct.pack("<H2sfi4f4s", 3, b"\xa5" * 2, values[0], 50_000_000, *values[2:], b"\xa5" * 4)
    assert encode(_definition(document), PINHOLE) == expected
    inside = definition_of(crc=None, length_bytes=32, fill=0)
    inside["fields"][0] = {"name": "FLAGS", "constant": 5, "offset_bits": 3, "type": "uint7"}
    assert encode(_definition(inside), PINHOLE)[:2] == (5 << 6).to_bytes(2, "big")


def test_a_number_that_does_not_fit_and_an_image_of_another_length_are_refused():
    document = definition_of()
    document["fields"][2] |= {"type": "int16", "scale": 1e-9}
    with pytest.raises(RefusedInputError, match=r"F_M cannot hold 0\.05: a int16 of scale 1e-09.* to 3\.2767e-05"):
        encode(_definition(document), PINHOLE)
    with pytest.raises(RefusedInputError, match="has 3 bytes and the table STR_CAM has 32"):
        decode(_definition(definition_of()), b"abc")


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
    definition = _definition(definition_of(crc={"name": "CRC-16/ARC"}))
    image = encode(definition, PINHOLE)
    assert table_crc(definition, image) == _bitwise(image, *ALGORITHMS["CRC-16/ARC"])
    assert decode(definition, image).crc_ok is None
    with_cfe, without = (_definition(definition_of() | more) for more in ({"cfe": {"table_name": "A.B"}}, {}))
    image = encode(without, PINHOLE)
    assert crc_told(with_cfe, image)[1] == _bitwise(image, *ALGORITHMS["CRC-16/ARC"])
    assert crc_told(without, image)[1] == _bitwise(image[:30], *ALGORITHMS["CRC-16/CCITT-FALSE"])
    assert crc_told(_definition(definition_of(crc=None)), image) is None


IDS = {name: 4096 + place for place, name in enumerate(("s", "f_m", "u0_px", "v0_px", "k1", "k2"))}


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
        "lenght_bytes is no entry of a table definition: write length_bytes",
    ),
    "another schema": (_entry("schema", "x/2"), "schema is 'x/2'"),
    "no length": (lambda d: d.pop("length_bytes"), "length_bytes is missing"),
    "a length of parts": (_entry("length_bytes", 32.5), "length_bytes is 32.5"),
    "an order of no kind": (_entry("byte_order", "middle"), "byte_order is 'middle': choose big or little"),
    "no fields": (_entry("fields", []), "fields is no list"),
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
    "a parameter twice": (_field(parameter="k1"), "the parameter s lies in 0 fields"),
    "an unknown CRC": (_entry("crc", {"name": "CRC-15"}), "crc.name is no known CRC: choose CRC-16/ARC"),
    "a known CRC with other parameters": (
        _crc(width=16, poly=3, init=0, refin=False, refout=False, xorout=0),
        "crc is called CRC-16/CCITT-FALSE but has other parameters",
    ),
    "a CRC with another check value": (_crc(check="0xBB3D"), "crc.check is 0xBB3D, but these parameters make 0x29B1"),
    "a CRC of itself": (_crc(over=[0, 32]), "inside what it is taken of"),
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
    document = copy.deepcopy(definition_of())
    change(document)
    with pytest.raises(RefusedInputError, match=sentence):
        parse_definition(document, sensor_of())


def test_what_is_no_object_another_camera_s_table_or_a_type_without_a_pus_code_is_refused():
    document = definition_of()
    document["fields"][1] |= {"type": "uint20", "scale": 1e-3}
    parse_definition(document, sensor_of())
    refused = [(None, "one JSON object"), ([], "one JSON object"), ("x", "one JSON object"), (3, "one JSON object")]
    whole = r"TC\[20,3\] cannot be made of whole bytes"
    for given_document, sentence in (*refused, (document | {"pus": {"parameter_ids": IDS}}, whole)):
        with pytest.raises(RefusedInputError, match=sentence):
            parse_definition(given_document, sensor_of())
    with pytest.raises(RefusedInputError, match="parameter is 's': choose f_m"):
        parse_definition(definition_of(), sensor_of("inverted_wang"))


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
    document = copy.deepcopy(definition_of())
    inside = document
    for step in place[:-1]:
        inside = inside[step]
    inside[place[-1]] = junk
    try:
        definition = parse_definition(document, sensor_of())
    except RefusedInputError:
        return
    assert decode(definition, encode(definition, INITIAL["pinhole_radial"])).crc_ok is not False
