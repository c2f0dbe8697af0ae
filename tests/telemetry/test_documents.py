"""JSON documents that nobody writes by hand (deep, with endless numbers, of a million fields) are refused in words, soon."""

import json
import time

import pytest

from boresight.calibration.parameter_file import read_document
from boresight.errors import RefusedInputError
from boresight.telemetry.read.formats import parse_json
from boresight.telemetry.sensors import read_sensor

HOSTILE = {
    "an integer of 5,000 digits": '{"name": ' + "9" * 5000 + "}",
    "arrays 100,000 deep": '{"name": ' + "[" * 100_000 + "]" * 100_000 + "}",
    "arrays 500 deep": '{"name": ' + "[" * 500 + "]" * 500 + "}",
    "objects 500 deep": '{"name": ' * 500 + "1" + "}" * 500,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_document_that_cannot_be_one_is_not_json(name):
    with pytest.raises(json.JSONDecodeError):
        parse_json(HOSTILE[name])


def test_a_document_may_be_as_deep_as_ours_are():
    text = "[" * 32 + "]" * 32
    assert json.dumps(parse_json(text)) == text


@pytest.mark.parametrize("read", [read_sensor, read_document], ids=["sensor", "parameters"])
@pytest.mark.parametrize("name", HOSTILE)
def test_files_of_such_are_refused(read, name, tmp_path):
    path = tmp_path / "hostile.json"
    path.write_text(HOSTILE[name])
    with pytest.raises(RefusedInputError, match="not JSON"):
        read(path)


def test_a_sensor_file_of_a_hundred_thousand_fields_is_refused_in_no_time(tmp_path):
    path = tmp_path / "wide.json"
    path.write_text(json.dumps({f"detectors{k}": k for k in range(100_000)}))
    began = time.process_time()
    with pytest.raises(RefusedInputError) as caught:
        read_sensor(path)
    assert time.process_time() - began < 2.0
    assert any("100,000 fields" in str(fault) for fault in caught.value.faults)
