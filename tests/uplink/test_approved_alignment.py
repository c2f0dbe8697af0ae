"""The approved alignment of a set in its uplink package: as a file, and in the fields of a table that holds one."""

import json

import pytest

from boresight.errors import RefusedInputError
from boresight.uplink.package import make_files
from boresight.uplink.table_definition import decode, parse_definition
from boresight.verdicts.gates.measurements import NO_DEFINITION
from tests.uplink.packages import make_definition, make_inputs, make_sensor

APPROVED = {
    "id": 7, "result_sha256": "a" * 64, "from": "FM1", "to": "FM2", "run_a": 3, "run_b": 4, "verdict": "PASS",
    "reference_utc": "2026-11-21T07:00:00Z", "quaternion": [0.1, -0.2, 0.3, 0.927361849549570], "sigma_arcsec": [1.0, 1.0, 2.0],
    "request": {"id": 1, "signed_by": "Cy Approver"},
}  # fmt: skip


def test_a_package_lays_the_approved_alignment_into_the_table_and_is_refused_without_one():
    document = make_definition()
    begin = document["length_bytes"]
    turn = [
        {"name": name.upper(), "alignment": name, "offset_bytes": begin + 8 * place, "type": "float64"}
        for place, name in enumerate(("q_x", "q_y", "q_z", "q_w"))
    ]
    document |= {"length_bytes": begin + 32, "fields": [*document["fields"], *turn]}
    inputs = make_inputs(definition=document)
    with pytest.raises(RefusedInputError):
        make_files(inputs, signed=False)
    inputs["subject"]["alignment"] = APPROVED
    files = make_files(inputs, signed=False)
    definition = parse_definition(document, make_sensor())
    held = [one.value for one in decode(definition, files["table.bin"]).fields if one.field.alignment]
    assert held == APPROVED["quaternion"]
    told = json.loads(files["approved_alignment.json"])
    assert (told["id"], told["request"]["signed_by"], told["parameter_set"]) == (7, "Cy Approver", "PS-FM1-2")
    assert "backout/table.bin" not in files
    assert b"PS-FM1-1" in files["backout/table_missing.txt"]
    sheet, of_backout = (files[f"{place}verification_sheet.html"].decode() for place in ("", "backout/"))
    assert sheet.index("Save the on-board image") < sheet.index("inactive image")  # before anything is loaded
    assert "saved in step 2" in sheet
    assert "table_missing.txt" in of_backout
    assert NO_DEFINITION not in of_backout
    inputs["backout"]["alignment"] = APPROVED
    files = make_files(inputs, signed=False)
    assert "backout/table.bin" in files
    assert b"Save the on-board image" not in files["verification_sheet.html"]
