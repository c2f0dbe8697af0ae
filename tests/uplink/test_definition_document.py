"""A table definition with a slip in it is refused, and the refusal names the place."""

import copy

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.uplink.table_definition import decode, encode, parse_definition
from tests.effort import effort
from tests.uplink.tables import INITIAL, definition_of, sensor_of

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


@pytest.mark.parametrize("document", [None, [], "x", 3])
def test_what_is_no_object_is_refused(document):
    with pytest.raises(RefusedInputError, match="one JSON object"):
        parse_definition(document, sensor_of())


def test_a_type_that_pus_has_no_code_for_is_refused_there_only():
    document = definition_of()
    document["fields"][1] |= {"type": "uint20", "scale": 1e-3}
    parse_definition(document, sensor_of())
    with pytest.raises(RefusedInputError, match=r"TC\[20,3\] cannot be made of whole bytes"):
        parse_definition(document | {"pus": {"parameter_ids": IDS}}, sensor_of())


def test_the_table_of_another_camera_is_refused():
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
