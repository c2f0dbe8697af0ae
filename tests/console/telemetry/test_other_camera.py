"""A set of another sensor's camera is noticed as it is uploaded, offered to that sensor, and kept where it is meant to be."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest

from boresight.calibration.diagnosis.diagnose import sample_exposures
from boresight.calibration.diagnosis.other_camera import (
    BORDER,
    MOST_EXPOSURES,
    TOO_LIKELY,
    KnownCamera,
    _count_places,
    _log_chance,
    _Stars,
    find_other_cameras,
)
from boresight.calibration.diagnosis.trials import Bench
from boresight.calibration.options import CalibrationSettings
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.db.sessions import open_reading
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.sensors import read_sensor, sensor_document
from boresight.telemetry.writing import write_csv

SECONDS = 20.0  # of an upload on a busy machine; the table of star patterns is made before
NAMES = ("star_id", "ra_rad", "dec_rad", "quaternion")


def _camera(name, focal=1.0, size=None):
    """An ST-16 with another lens, or with the middle of its detector."""
    sensor = st16_sensor(1)
    x = sensor.initial.copy()
    x[0] *= focal
    if size is None:
        return replace(sensor, name=name, initial=x)
    x[1:3] = size / 2
    return replace(sensor, name=name, initial=x, rows=size, columns=size)


WIDE, LONG, SMALL = _camera("WIDE"), _camera("LONG", focal=1.6), _camera("SMALL", size=1024)
CAMERAS = {one.name: one for one in (WIDE, LONG, SMALL)}
LIMITS = {"WIDE": 4.9, "LONG": 5.4, "SMALL": 6.0}  # so that each sees stars enough


@pytest.fixture(scope="module")
def sets(catalogue):
    def simulated(sensor, truth, limit):
        scenario = replace(
            calibration_scenario(1), frames=40, sensor=sensor, truth=truth, magnitude_limit=limit, blanked_share=0.0
        )
        return simulate(scenario, np.random.default_rng(7), catalogue)

    own = {name: simulated(sensor, sensor.initial, LIMITS[name]) for name, sensor in CAMERAS.items()}
    return own | {number: simulated(st16_sensor(number), st16_truth(number), 4.9) for number in (1, 2)}


def _unnamed(telemetry):
    return replace(telemetry, **dict.fromkeys(NAMES))


def _find(telemetry, own, others, catalogue, folder=None):
    sample, _ = sample_exposures(telemetry, MOST_EXPOSURES)
    known = [KnownCamera(number, sensor, measured) for number, (sensor, measured) in enumerate(others)]
    return find_other_cameras(sample, KnownCamera(99, *own), known, catalogue, folder)


def _found(telemetry, own, others, catalogue, folder=None):
    found = _find(telemetry, own, others, catalogue, folder)
    return [] if found is None else [one.sensor.name for one in found.cameras]


@pytest.fixture(scope="module")
def folder(sets, catalogue, catalogue_folder):
    """The table of star patterns of each camera, as a diagnosis of one of its sets made it."""
    for name, sensor in CAMERAS.items():
        Bench(sets[name], sensor, catalogue, CalibrationSettings(), catalogue_folder).prepare()
    return catalogue_folder


@pytest.mark.few(1)
@pytest.mark.parametrize("of", CAMERAS)
@pytest.mark.parametrize("sent_to", CAMERAS)
@pytest.mark.parametrize("are_named", [True, False])
def test_a_set_is_of_the_camera_that_saw_it(sets, catalogue, folder, of, sent_to, are_named):
    others = [(sensor, None) for name, sensor in CAMERAS.items() if name != sent_to]
    telemetry = sets[of] if are_named else _unnamed(sets[of])
    found = _found(telemetry, (CAMERAS[sent_to], None), others, catalogue, folder)
    assert found == ([] if of == sent_to else [of])


@pytest.mark.parametrize(("of", "sent_to"), [(1, 2), (2, 1)])
def test_cameras_of_one_design_are_told_apart_once_both_were_measured(sets, catalogue, of, sent_to):
    measured = {number: (st16_sensor(number), st16_truth(number)) for number in (of, sent_to)}
    ground = {number: (st16_sensor(number), None) for number in (of, sent_to)}
    assert _found(sets[of], measured[sent_to], [measured[of]], catalogue) == [st16_sensor(of).name]
    assert _found(sets[of], measured[of], [measured[sent_to]], catalogue) == []
    assert _found(sets[of], ground[sent_to], [measured[of]], catalogue) == []  # its own camera is not known so well
    assert _found(sets[of], measured[sent_to], [ground[of]], catalogue) == []


def test_wrong_names_and_a_lens_that_nobody_has_point_to_no_sensor(sets, catalogue):
    others = [(LONG, None), (SMALL, None)]
    some = sets["LONG"].star_id.copy()
    some[::4] = np.roll(some, 40)[::4]
    assert _found(replace(sets["LONG"], star_id=some), (WIDE, None), others, catalogue) == ["LONG"]
    nonsense = replace(sets["LONG"], star_id=np.roll(sets["LONG"].star_id, 40))
    assert _found(nonsense, (WIDE, None), others, catalogue) == []
    assert _found(sets["LONG"], (WIDE, None), [(_camera("TELE", focal=2.8), None)], catalogue) == []


@pytest.mark.parametrize("others", [[], [(_camera("TELE", focal=2.8), None)]], ids=["alone", "beside another"])
def test_a_set_of_a_camera_that_nobody_registered_is_told_to_be_of_none_and_a_good_or_a_wrongly_named_one_is_not(
    sets, catalogue, others
):
    known = [KnownCamera(number, sensor, measured) for number, (sensor, measured) in enumerate(others)]

    def find(telemetry):
        sample, _ = sample_exposures(telemetry, MOST_EXPOSURES)
        return find_other_cameras(sample, KnownCamera(99, WIDE), known, catalogue)

    assert find(sets["LONG"]).cameras == ()
    assert "times" in find(sets["LONG"]).why
    assert find(sets["WIDE"]) is None
    assert find(replace(sets["WIDE"], star_id=np.roll(sets["WIDE"].star_id, 40))) is None


@pytest.mark.parametrize("n", [5, 40])
def test_evenly_spread_centroids_span_no_more_of_a_side_as_often_as_the_law_of_their_range_says(n):
    draws = np.ptp(np.random.default_rng(3).random((20_000, n)), axis=1)
    for probability in (0.02, 0.3, 0.8):
        f = np.quantile(draws, probability)
        said = 10 ** _log_chance((1 - 2 * BORDER) * f, n)
        assert abs(said - probability) < 4 * np.sqrt(probability * (1 - probability) / len(draws)) + 1e-4


def test_a_detector_that_is_only_spanned_too_little_is_no_certain_sign_of_another_one(sets, catalogue):
    small = _find(sets["SMALL"], (WIDE, None), [(SMALL, None)], catalogue)
    assert [one.sensor.name for one in small.cameras] == ["SMALL"]
    assert not small.is_certain
    assert _find(sets["LONG"], (WIDE, None), [(LONG, None)], catalogue).is_certain


def test_stars_that_are_seen_again_at_their_places_count_once(sets):
    one = sets["WIDE"].exposure == sets["WIDE"].exposure[0]
    places = np.stack([sets["WIDE"].row_px, sets["WIDE"].col_px])[:, one]
    again = _Stars(*np.tile(places, 30), *np.empty((2, 0), int), np.empty(0))
    assert _count_places(again, np.arange(places.shape[1] * 30)) == places.shape[1]


def test_many_stars_inside_the_border_of_a_detector_are_likely_and_those_of_a_smaller_one_are_not():
    assert _log_chance(1 - 2 * BORDER, 1_000_000) > TOO_LIKELY
    assert _log_chance(0.985, 873) > TOO_LIKELY
    assert _log_chance(0.9, 873) < TOO_LIKELY


@pytest.mark.parametrize("number", [2, 3])
def test_a_real_star_field_sent_to_another_sensor_is_offered_to_its_own(real_sky, catalogue, number):
    telemetry, sensor = read_telemetry(real_sky / "esa-5-frames.csv"), read_sensor(real_sky / "esa.sensor.json")
    others = [(sensor, None), (LONG, None)]
    assert _found(telemetry, (st16_sensor(number), None), others, catalogue) == [sensor.name]
    assert _found(telemetry, (sensor, None), [(st16_sensor(number), None)], catalogue) == []


@pytest.fixture
def write(tmp_path):
    def written(telemetry, *, are_named=True):
        write_csv(telemetry if are_named else _unnamed(telemetry), tmp_path / "set.csv")
        return (tmp_path / "set.csv").read_bytes()

    return written


@pytest.fixture(scope="session")  # as long as the house: a second pair of the same lenses would be offered as well
def registered(house):
    """A sensor with the wide and one with the long lens, whose names no other test has."""
    house.person("ada").timeout = 120.0
    made = {}
    for sensor in (WIDE, LONG):
        document = {**sensor_document(sensor), "name": f"{sensor.name}-{time.time_ns()}"}
        made[sensor.name] = house.person("ada").post("/api/v1/sensors", json=document).json()
    return made


@pytest.mark.few(1)
@pytest.mark.parametrize("are_named", [True, False])
def test_rest_refuses_a_set_of_another_camera_and_names_the_sensor(house, sets, registered, write, are_named):
    wide, long = registered["WIDE"]["id"], registered["LONG"]["id"]
    ada, content = house.person("ada"), write(sets["LONG"], are_named=are_named)
    house.upload(ada, wide, content)  # the first loads compiled loops and makes the table of star patterns
    begun_s = time.monotonic()
    answer = house.upload(ada, wide, content)
    assert time.monotonic() - begun_s < SECONDS
    assert answer.status_code == 422
    fault = answer.json()["errors"][0]
    assert fault["column"] == "sensor_id"
    assert f"{long} is {registered['LONG']['name']}" in fault["detail"]
    assert registered["LONG"]["name"] in answer.json()["detail"]
    assert house.upload(ada, long, content).status_code == 201
    kept = house.upload(ada, wide, content, keep_here="1")
    assert kept.status_code == 201
    finding = next(one for one in kept.json()["quality"]["findings"] if one["code"] == "OTHER_CAMERA")
    assert finding["severity"] == "CAUTION"
    assert registered["LONG"]["name"] in finding["sentence"]


def test_the_page_offers_the_sensor_whose_it_is_and_sends_the_same_form_there(house, sets, registered, write):
    ada, wide, long = house.person("ada"), registered["WIDE"]["id"], registered["LONG"]["id"]
    form = {"csrf_token": ada.headers["X-CSRF-Token"], "sensor_id": str(wide), "purpose": "validation"}
    content = write(replace(sets["LONG"], magnitude=None))  # other bytes than those of REST
    files = {"file": ("pass.csv", content)}

    def send(**pressed):
        return ada.post("/telemetry", data={**form, **pressed}, files=files, headers={"Accept": "text/html"})

    refused = send()
    assert refused.status_code == 422
    offered = re.findall(r'<button form="upload" name="(instead|keep_here)" value="(\d+)"', refused.text)
    assert offered[0] == ("instead", str(long))
    assert offered[-1] == ("keep_here", "1")
    assert f'<option value="{wide}" selected>' in refused.text  # nothing of the form is lost
    with open_reading(house.app.state.engine) as session:
        stored = {}
        for name, value in (offered[0], offered[-1]):
            answer = send(**{name: value})
            assert answer.status_code == 303, answer.text
            number = int(re.search(r"/telemetry/(\d+)", answer.headers["location"])[1])
            stored[name] = number
    with open_reading(house.app.state.engine) as session:
        rows = {name: session.get_one(TelemetrySet, number) for name, number in stored.items()}
        assert {name: row.sensor_id for name, row in rows.items()} == {"instead": long, "keep_here": wide}
        assert {row.purpose for row in rows.values()} == {"validation"}
