"""The pages of importing: a profile saved, a file seen before it is stored."""

import json

PROFILE = {
    "name": "pages",
    "frames": {"column": "F"},
    "row": {"column": "Y", "origin": 1},
    "col": {"column": "X", "origin": 1},
}


def test_a_profile_is_saved_archived_and_refused_with_what_was_typed(site):
    ada = site.visitor("ada")
    assert ada.post("/import-profiles", document=json.dumps(PROFILE)).status_code == 303
    assert "pages" in ada.get("/import-profiles")
    refused = ada.post("/import-profiles", document='{"name": "half')
    assert "is not JSON" in refused.text
    assert "half" in refused.text


def test_a_file_is_seen_before_it_is_stored(site):
    ada = site.visitor("ada")
    ada.post("/import-profiles", document=json.dumps({**PROFILE, "name": "seen"}))
    data = {"csrf_token": ada.csrf_token, "sensor_id": "1", "purpose": "calibration", "profile": "seen", "preview": "1"}
    files = {"file": ("stars.csv", b"F,X,Y\n1,11,21\n1,51,61\n")}
    before = ada.get("/telemetry").count("/telemetry/")
    shown = ada.send("POST", "/telemetry", data=data, files=files, headers={"Accept": "text/html"})
    assert shown.status_code == 200
    assert "First rows, and what they mean" in shown.text
    assert "the number of the first pixel" in shown.text
    assert ada.get("/telemetry").count("/telemetry/") == before
