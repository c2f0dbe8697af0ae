"""Sensors, table definitions and inputs of a package, as the store would gather them; run it and it prints a package's hash."""

import hashlib
import json
import sys

import numpy as np
from hypothesis import strategies as st

from boresight.cameras import CAMERA_MODELS
from boresight.telemetry.sensors import parse_sensor, sensor_document
from boresight.uplink.archive import canonical_bytes
from boresight.uplink.package import build_package

ROWS, PITCH = 1024, 1.5e-5


def make_initial(camera):
    """A lens of 50 mm that has something of every term."""
    x = camera.plain(0.05 / PITCH, 511.2, 512.3, PITCH) + 0.3 * np.array(camera.default_typical_sigma)
    return dict(zip(camera.parameter_names, x.tolist(), strict=True))


INITIAL = {name: make_initial(camera) for name, camera in CAMERA_MODELS.items()} | {  # two whose numbers tests name
    "pinhole_radial": {"s": 1.0, "f_m": 0.05, "u0_px": 512.3, "v0_px": 511.2, "k1": 0.01, "k2": -0.02},
    "inverted_wang": {"f_m": 0.016, "m0_px": 511.2, "n0_px": 512.3, "b4_per_m4": 1e6, "b2_per_m2": -40.0}
    | {"a1_rad": 0.001, "a2_rad": -0.002, "g_y": 1.0003},
}
INTEGERS = (f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 12, 16, 24, 31, 32, 37, 48, 64))
KINDS = ("float32", "float64", *INTEGERS)


def make_sensor(model="pinhole_radial", parity=-1, name="FM1"):
    camera = CAMERA_MODELS[model]
    return parse_sensor(
        {
            "name": name,
            "detector": {"rows": ROWS, "columns": ROWS, "pixel_pitch_m": PITCH},
            "camera_model": model,
            "parity": parity,
            "centroid_sigma_px": 0.1,
            "initial": INITIAL[model],
            "typical_sigma": dict(zip(camera.parameter_names, camera.default_typical_sigma, strict=True)),
        }
    )


def make_definition(model="pinhole_radial", kind="float32", **others):
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


SIGNATURE = {
    "printed_name": "Cy <b>Approver</b>",
    "decision": "APPROVE",
    "meaning": "I approve this set for baseline & <script>alert(1)</script>",
    "comment": "",
    "signed_utc": "2026-11-21T09:00:00.000000Z",
    "shown_sha256": "c" * 64,
    "console": None,
}
WAIVER = {
    "gate": "coverage",
    "code": "accepted-risk",
    "reason": "One corner has no stars in this arc of the orbit.",
    "printed_name": "Cy Approver",
    "made_utc": "2026-11-21T08:00:00.000000Z",
    "expires_utc": "2026-12-01T00:00:00.000000Z",
}
GATE = {"name": "coverage", "title": "Detector coverage", "status": "FAIL", "value": 0.4, "limit": 0.6, "unit": "1"}


def make_set(model, number, shift=0.0, ground_state="SUPERSEDED", **others):
    parameters = INITIAL[model] | {"f_m": INITIAL[model]["f_m"] + shift}
    names = list(parameters)
    document = {
        "name": f"PS-FM1-{number}",
        "camera_model": model,
        "parameters": parameters,
        "sigma": dict.fromkeys(names, 1e-6),
        "covariance": {"names": names, "matrix": [[1e-12 * (i == j) for j in names] for i in names]},
        "free": names,
        "alignment": None,
    }
    sha256 = hashlib.sha256(canonical_bytes(document)).hexdigest()
    base = {"id": number + 1, "name": document["name"], "sha256": sha256, "document": document}
    base |= {"created_utc": "2026-11-21T07:00:00.000000Z", "ground_state": ground_state}
    return base | {"run": None, "gates": None, "approval": None} | others


def make_inputs(model="pinhole_radial", definition=None, **others):
    approval = {"id": 1, "kind": "PROMOTION", "reason": "f moved", "submitted_by": "Ana", "needed": 2, "bound": {}}
    approval |= {"submitted_utc": "2026-11-21T08:30:00.000000Z", "signatures": [SIGNATURE]}
    gates = {"sha256": "d" * 64, "verdict": "FAIL", "words": "FAIL (1 gate waived)", "waived": ["coverage"]}
    gates |= {"waivers": [WAIVER], "document": {"gates": [GATE]}}
    document = make_definition(model) if definition is None else definition
    return {
        "sensor": sensor_document(make_sensor(model)),
        "simulated": False,
        "subject": make_set(model, 2, 1e-6, "APPROVED", approval=approval, gates=gates),
        "backout": make_set(model, 1, 0.0, "BASELINE"),
        "active": None,
        "definition": {"number": 1, "sha256": "e" * 64, "document": document} if document else None,
        "four_eyes": {"enforced": True, "kept": True, "sentence": "Four eyes."},
        "software": {"name": "Boresight", "version": "0.1.0"},
        "first_built": {"at_utc": "2026-11-21T09:30:00.000000Z", "audit_head": "f" * 64},
    } | others


if __name__ == "__main__":
    sys.stdout.write(hashlib.sha256(build_package(json.load(sys.stdin))).hexdigest())
