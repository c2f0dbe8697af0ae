"""Sensors and table definitions, fixed ones and random ones."""

from hypothesis import strategies as st

from boresight.cameras import CAMERA_MODELS
from boresight.telemetry.sensors import parse_sensor

INITIAL = {
    "pinhole_radial": {"s": 1.0, "f_m": 0.05, "u0_px": 512.3, "v0_px": 511.2, "k1": 0.01, "k2": -0.02},
    "inverted_wang": {
        "f_m": 0.016,
        "m0_px": 511.2,
        "n0_px": 512.3,
        "b4_per_m4": 1e6,
        "b2_per_m2": -40.0,
        "a1_rad": 0.001,
        "a2_rad": -0.002,
        "g_y": 1.0003,
    },
}
KINDS = (
    "float32",
    "float64",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 12, 16, 24, 31, 32, 37, 48, 64)),
)


def sensor_of(model="pinhole_radial", parity=-1, name="FM1"):
    camera = CAMERA_MODELS[model]
    return parse_sensor(
        {
            "name": name,
            "detector": {"rows": 1024, "columns": 1024, "pixel_pitch_m": 1.5e-5},
            "camera_model": model,
            "parity": parity,
            "centroid_sigma_px": 0.1,
            "initial": INITIAL[model],
            "typical_sigma": dict(zip(camera.parameter_names, camera.default_typical_sigma, strict=True)),
        }
    )


def definition_of(model="pinhole_radial", kind="float32", **others):
    fields = [{"name": "VERSION", "constant": 3, "offset_bytes": 0, "type": "uint16"}]
    size = 8 if kind == "float64" else 4
    for place, name in enumerate(INITIAL[model]):
        fields.append({"name": name.upper(), "parameter": name, "offset_bytes": 4 + size * place, "type": kind})
    length = 8 + size * len(INITIAL[model])
    return {
        "table_id": "STR_CAM",
        "flight_software_version": "4.2.1",
        "length_bytes": length,
        "fill": 0xA5,
        "fields": fields,
        "crc": {"name": "CRC-16/CCITT-FALSE", "offset_bytes": length - 2},
    } | others


@st.composite
def definitions(draw):
    model = draw(st.sampled_from(sorted(INITIAL)))
    fields, bit = [], 0
    for name in draw(st.permutations(list(INITIAL[model]))):
        kind = draw(st.sampled_from(KINDS))
        bits = int("".join(letter for letter in kind if letter.isdigit()))
        bit += draw(st.integers(0, 20))
        order = "little" if bits in {8, 16, 32, 64} and draw(st.booleans()) else "big"
        if order == "little" or kind.startswith("float"):
            bit = -(-bit // 8) * 8
        field = {"name": name.upper(), "parameter": name, "offset_bits": bit, "type": kind, "byte_order": order}
        fields.append(field | draw(scales(INITIAL[model][name], kind, bits)))
        bit += bits
    length = -(-bit // 8) + draw(st.integers(0, 5))
    crc = draw(st.sampled_from(["CRC-16/ARC", "CRC-16/CCITT-FALSE", "CRC-32"]))
    document = {"table_id": "T", "flight_software_version": "1", "fill": draw(st.integers(0, 255)), "fields": fields}
    document["crc"] = {"name": crc, "offset_bytes": length, "byte_order": draw(st.sampled_from(["big", "little"]))}
    return model, document | {"length_bytes": length + 4}


@st.composite
def scales(draw, number, kind, bits):
    if kind.startswith("float"):
        return {"scale": draw(st.sampled_from([1.0, 0.001, 1e6]))} if draw(st.booleans()) else {}
    raw = draw(st.integers(0, 2 ** min(bits - 1, 50) - 1))
    scale = draw(st.sampled_from([1e-3, 2.0**-20, 0.7]))
    return {"scale": scale, "offset": number - scale * raw}
