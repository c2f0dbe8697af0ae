"""The pages of importing: a profile saved, a file seen before it is stored."""

import html
import json
import re

from tests.sites import codes

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
    assert 'id="preview-title"' in shown.text
    assert "the number of the first pixel" in shown.text
    assert ada.get("/telemetry").count("/telemetry/") == before


def test_a_preview_recognises_the_profile_and_the_form_keeps_it_to_be_changed(site):
    ada = site.visitor("ada")
    ada.post("/import-profiles", document=json.dumps({**PROFILE, "name": "seen"}))
    data = {"csrf_token": ada.csrf_token, "sensor_id": "1", "purpose": "calibration", "profile": "", "preview": "1"}

    def preview(content):
        files = {"file": ("stars.csv", content)}
        return ada.send("POST", "/telemetry", data=data, files=files, headers={"Accept": "text/html"}).text

    shown = preview(b"F,X,Y\n1,11,21\n1,51,61\n")
    assert codes(shown) == ["previewed"]
    assert "seen, version 1; " in shown
    assert re.search(r'<option value="\d+" selected>seen, version 1</option>', shown)
    own = preview(b"frame,exposure,row_px,col_px\n0,0,20,10\n0,0,60,50\n")
    assert '<option value="contract" selected>' in own
    assert "No mapping profile reads stars.csv" in preview(b"apples,pears\n1,2\n")


def test_a_preview_drafts_a_profile_that_is_saved_and_chosen(site):
    ada = site.visitor("ada")
    data = {"csrf_token": ada.csrf_token, "sensor_id": "1", "purpose": "calibration", "profile": "", "preview": "1"}
    files = {"file": ("stars.txt", b"# frame x y\n0 255.5 475.25\n0 72.0 474.5\n1 155.75 211.5\n")}
    shown = ada.send("POST", "/telemetry", data=data, files=files, headers={"Accept": "text/html"}).text
    assert codes(shown)[:1] == ["drafted"]
    assert "whether its comment names the columns correctly: frame, x, y" in shown
    assert "475.25" in shown
    draft = html.unescape(re.search(r"<textarea id=\"document\"[^>]*>(.*?)</textarea>", shown, re.DOTALL).group(1))
    saved = ada.post("/import-profiles", document=draft)
    assert saved.status_code == 303
    assert re.search(r'<option value="\d+" selected>mine, version 1</option>', ada.get(saved.headers["location"]))
