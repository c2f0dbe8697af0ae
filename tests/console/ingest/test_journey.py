"""A file is dropped into the watched folder of a real server with a real worker: what is made of it, and who decides."""

import dataclasses
import time

import numpy as np
import pytest

from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading
from boresight.simulation.scenes import calibration_scenario, simulate, validation_scenario
from boresight.telemetry.sensors import sensor_document
from boresight.telemetry.writing import write_csv
from tests.served import House, add_people, serving, settings_in

FRAMES = 40
DAY = np.timedelta64(1, "D")


def _pass(catalogue, folder, name, day, seed, *, moved_m=0.0, number=1, validation=False):
    """Write the telemetry of one pass, so many days later, with the focal length moved."""
    scenario = (validation_scenario if validation else calibration_scenario)(number)
    truth = scenario.truth.copy()
    truth[0] += moved_m
    orbit = dataclasses.replace(scenario.orbit, start_utc=scenario.orbit.start_utc + day * DAY)
    made = dataclasses.replace(scenario, frames=FRAMES, truth=truth, orbit=orbit)
    path = folder / name
    write_csv(simulate(made, np.random.default_rng(seed), catalogue), path)
    return path


class Mission:
    """A server that watches a folder, a sensor on it, and its people."""

    def __init__(self, house, watched, folder, catalogue):
        self.house, self.watched, self.folder, self.catalogue = house, watched, folder, catalogue
        ada = house.person("ada")
        document = {**sensor_document(calibration_scenario(1).sensor), "name": "ST-1"}
        self.sensor_id = ada.post("/api/v1/sensors", json=document).json()["id"]
        validation = _pass(catalogue, folder, "validation.csv", 0.25, 3, validation=True)
        answer = house.upload(ada, self.sensor_id, validation.read_bytes(), purpose="validation", file_name="v.csv")
        assert answer.status_code == 201, answer.text

    def made(self, name, day, seed, **changed):
        return _pass(self.catalogue, self.folder, name, day, seed, **changed)

    def drop(self, path):
        """Drop a file as a downlink does: written under another name, renamed when it is whole."""
        place = self.watched / "ST-1"
        place.mkdir(exist_ok=True)
        (place / f".{path.name}").write_bytes(path.read_bytes())
        (place / f".{path.name}").rename(place / path.name)

    def decisions(self):
        answer = self.house.person("victor").get("/api/v1/ingest-decisions", params={"sensor_id": self.sensor_id})
        return answer.json()["items"]

    def decided(self, name, seconds=90):
        """Wait until a file's decision is more than received."""
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            found = [one for one in self.decisions() if one["file_name"] == name]
            if found and found[0]["state"] != "CALIBRATING":
                return found[0]
            time.sleep(0.2)
        raise AssertionError(f"{name} was not decided on: {found}")

    def move(self, person, row, step, noun="ingest-policies", **body):
        headers = {"If-Match": f'"v{row["version"]}"'}
        kept = {"json": body} if body else {}
        return self.house.person(person).post(f"/api/v1/{noun}/{row['id']}:{step}", headers=headers, **kept)

    def enable(self, **rules):
        given = {"sensor_id": self.sensor_id, "rules": rules, "reason": "Two passes a day."}
        row = self.house.person("ada").post("/api/v1/ingest-policies", json=given).json()
        row = self.move("ada", row, "rehearse").json()
        answer = self.move("adele", row, "enable")
        assert answer.status_code == 200, answer.text
        return answer.json()

    def policy(self, row):
        return self.house.person("victor").get(f"/api/v1/ingest-policies/{row['id']}").json()


@pytest.fixture(scope="module")
def mission(tmp_path_factory, catalogue):
    folder = tmp_path_factory.mktemp("mission")
    watched = folder / "watched"
    watched.mkdir()
    settings = settings_in(
        folder / "data", workers="1", watch_folder=str(watched), watch_settle_s="0.5", login_attempts="1000"
    )
    add_people(settings)
    with serving(settings, catalogue) as (address, app):
        house = House(address, app, b"", {})
        yield Mission(house, watched, folder, catalogue)
        for client in house.opened:
            client.close()


def _promote(mission, request):
    """The second person signs, an operator promotes."""
    assert mission.house.sign("alan", request).status_code == 200
    row = mission.house.person("olga").get(f"/api/v1/parameter-sets/{request['parameter_set_id']}").json()
    answer = mission.move("olga", row, "promote", "parameter-sets", reason="Signed.")
    assert answer.status_code == 200, answer.text


def test_a_file_becomes_a_question_a_person_opens_the_request_and_the_next_pass_asks_nothing(mission):
    first = mission.made("pass-1.csv", 0, 1)
    mission.drop(first)
    time.sleep(3)
    assert mission.decisions() == []  # without a policy in force nothing is touched
    assert (mission.watched / "ST-1" / "pass-1.csv").exists()
    mission.enable(preset="first-calibration")
    found = mission.decided("pass-1.csv")
    assert (found["state"], found["evidence"]["reasons"][0]["code"]) == ("ASKED", "OUTSIDE")
    assert found["evidence"]["holds"]["statistic"] > found["evidence"]["holds"]["limit"]
    assert [one["answer"] for one in found["evidence"]["alternatives"]] == [
        "SUBMIT",
        "WAIT",
        "MORE DATA",
        "RECALIBRATE",
    ]
    assert sum(one["recommended"] for one in found["evidence"]["alternatives"]) == 1
    assert (mission.watched / "ST-1" / "done" / "pass-1.csv").read_bytes() == first.read_bytes()
    prepared = mission.house.person("victor").get(f"/api/v1/parameter-sets/{found['parameter_set_id']}").json()
    assert (prepared["ground_state"], prepared["created_by"]) == ("CANDIDATE", None)
    page = mission.house.person("ada").get(f"/ingest/{found['id']}", headers={"Accept": "text/html"}).text
    assert "answer-1" in page

    answer = mission.move("ada", found, "answer", "ingest-decisions", answer="SUBMIT", reason="It moved.")
    assert answer.status_code == 200, answer.text
    said = answer.json()
    assert (said["state"], said["answer"]) == ("ANSWERED", "SUBMIT")
    request = mission.house.person("alan").get(f"/api/v1/approvals/{said['approval_id']}").json()
    assert request["state"] == "OPEN"
    _promote(mission, request)

    mission.drop(mission.made("pass-2.csv", 1, 2))
    quiet = mission.decided("pass-2.csv")
    assert (quiet["state"], quiet["parameter_set_id"], quiet["evidence"]["reasons"][0]["code"]) == (
        "WITHIN FORECAST",
        None,
        "HOLDS",
    )
    with open_reading(mission.house.app.state.engine) as session:
        assert audit.verify(session).ok
