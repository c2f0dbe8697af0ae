"""Inputs of a package, as the store would gather them, of any camera model; run as a program it prints a package's hash."""

import hashlib
import json
import sys

from boresight.telemetry.sensors import sensor_document
from boresight.uplink.archive import canonical_bytes
from boresight.uplink.package import build_package
from tests.uplink.tables import INITIAL, definition_of, sensor_of

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


def set_of(model, number, shift=0.0, ground_state="SUPERSEDED", **others):
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


def inputs_of(model="pinhole_radial", definition=None, **others):
    approval = {"id": 1, "kind": "PROMOTION", "reason": "f moved", "submitted_by": "Ana", "needed": 2, "bound": {}}
    approval |= {"submitted_utc": "2026-11-21T08:30:00.000000Z", "signatures": [SIGNATURE]}
    gates = {"sha256": "d" * 64, "verdict": "FAIL", "words": "FAIL (1 gate waived)", "waived": ["coverage"]}
    gates |= {"waivers": [WAIVER], "document": {"gates": [GATE]}}
    document = definition_of(model) if definition is None else definition
    return {
        "sensor": sensor_document(sensor_of(model)),
        "simulated": False,
        "subject": set_of(model, 2, 1e-6, "APPROVED", approval=approval, gates=gates),
        "backout": set_of(model, 1, 0.0, "BASELINE"),
        "active": None,
        "definition": {"number": 1, "sha256": "e" * 64, "document": document} if document else None,
        "four_eyes": {"enforced": True, "kept": True, "sentence": "Four eyes."},
        "software": {"name": "Boresight", "version": "0.1.0"},
        "first_built": {"at_utc": "2026-11-21T09:30:00.000000Z", "audit_head": "f" * 64},
    } | others


if __name__ == "__main__":
    sys.stdout.write(hashlib.sha256(build_package(json.load(sys.stdin))).hexdigest())
