"""Lost in space: the attitude is right under wrong parameters, for both parities, or there is none."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.attitude import conjugate, product, rotation_vector, to_matrix, wahba
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.sky import identification
from boresight.sky.apparent import apparent_directions
from boresight.sky.identification import field_of_view_deg, identify
from boresight.telemetry.read.readers import read_telemetry
from boresight.telemetry.schema import find_exposures
from boresight.telemetry.sensors import read_sensor

pytest.importorskip("tetra3rs", reason="the lost-in-space extra is not installed")

MOST_OFF_RAD = np.radians(0.2)
TOWARDS_ORION = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("patterns")


def answers(number, parity, frames, catalogue, folder, x=None):
    scenario = replace(calibration_scenario(number, frames), blanked_share=0.0)
    sensor = replace(scenario.sensor, parity=parity)
    telemetry = simulate(replace(scenario, sensor=sensor), np.random.default_rng(number), catalogue)
    camera = CAMERA_MODELS[sensor.camera_model]
    x = sensor.initial if x is None else x
    field = field_of_view_deg(camera, x, sensor.rows, sensor.columns, sensor.pixel_pitch_m)
    s_d = camera.directions(x, telemetry.row_px, telemetry.col_px, sensor.pixel_pitch_m)
    star = catalogue.find_index(telemetry.star_id)
    s_i = apparent_directions(catalogue, star, telemetry.time_utc, telemetry.velocity_m_s)
    starts = np.append(find_exposures(telemetry).start, len(telemetry))
    told = []
    for rows in map(slice, starts[:-1], starts[1:]):
        true = star[rows] >= 0
        q = identify(s_d[rows], telemetry.magnitude[rows], parity, field, folder)
        known = wahba(s_d[rows][true], s_i[rows][true], np.full(true.sum(), 1e-4), parity)
        off = np.nan if q is None else np.linalg.norm(rotation_vector(product(q, conjugate(known.quaternion))))
        told.append((true.sum(), q is not None, off))
    return np.array(told)


@pytest.mark.parametrize(("number", "parity"), [*((number, 1) for number in range(1, 7)), (3, -1)])
def test_under_a_ground_calibration_rich_fields_of_either_parity_are_recognised_and_none_wrongly(
    number, parity, catalogue, folder
):
    stars, solved, off = answers(number, parity, 25, catalogue, folder).T
    assert (off[solved == 1] < MOST_OFF_RAD).all()
    assert solved[stars >= 8].mean() > 0.95


def test_with_the_true_parameters_the_attitude_is_good_to_minutes_of_arc(catalogue, folder):
    truth = calibration_scenario(2).truth
    stars, solved, off = answers(2, 1, 10, catalogue, folder, truth).T
    assert solved[stars >= 8].all()
    assert off[solved == 1].max() < np.radians(0.05)


def test_five_frames_of_the_real_sky_are_recognised_with_a_nominal_lens(folder, real_sky):
    sensor, telemetry = read_sensor(real_sky / "esa.sensor.json"), read_telemetry(real_sky / "esa-5-frames.csv")
    camera, x, pitch = CAMERA_MODELS[sensor.camera_model], sensor.initial, sensor.pixel_pitch_m
    field = field_of_view_deg(camera, x, sensor.rows, sensor.columns, pitch)
    s_d = camera.directions(x, telemetry.row_px, telemetry.col_px, pitch)
    ra, dec = telemetry.ra_rad, telemetry.dec_rad
    s_i = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    starts = np.append(find_exposures(telemetry).start, len(telemetry))
    for rows in map(slice, starts[:-1], starts[1:]):
        named = np.isfinite(ra[rows])
        known = wahba(s_d[rows][named], s_i[rows][named], np.full(named.sum(), 1e-4), sensor.parity)
        q = identify(s_d[rows], telemetry.magnitude[rows], sensor.parity, field, folder)
        assert np.linalg.norm(rotation_vector(product(q, conjugate(known.quaternion)))) < np.radians(0.05)


def random_field(seed, n):
    place = np.random.default_rng(seed).uniform(-0.17, 0.17, (n, 2)) * [0.75, 1.0]
    s = np.column_stack([place, np.ones(n)])
    return s / np.linalg.norm(s, axis=1, keepdims=True)


def test_neither_chance_nor_fewer_than_four_stars_are_recognised(folder):
    fields = [*(random_field(seed, 12) for seed in range(30)), *(random_field(1, n) for n in range(4))]
    assert [identify(field, None, 1, 20.0, folder) for field in fields] == [None] * 34


def test_the_mirror_image_of_the_sky_is_not_taken_for_it(catalogue, folder):
    ra, dec = (angle[catalogue.magnitude < 5.0] for angle in (catalogue.ra_rad, catalogue.dec_rad))
    s_i = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    orion = (s_i @ TOWARDS_ORION.T)[s_i[:, 1] > np.cos(np.radians(9.0))]
    mirrored = orion * [1, -1, 1]
    for parity, right, wrong in ((1, orion, mirrored), (-1, mirrored, orion)):
        found = to_matrix(identify(right, None, parity, 20.0, folder))
        np.testing.assert_allclose(found, TOWARDS_ORION, atol=MOST_OFF_RAD)
        assert identify(wrong, None, parity, 20.0, folder) is None


def test_magnitudes_may_be_missing_and_stars_behind_are_passed_over(folder):
    s = random_field(2, 8)
    s[0] *= -1
    s[1] = np.nan
    assert identify(s, np.full(8, np.nan), 1, 20.0, folder) is None


def test_the_table_of_patterns_is_made_once_and_again_when_it_is_damaged(tmp_path, monkeypatch):
    identification._loaded.cache_clear()
    identify(random_field(3, 6), None, 1, 30.0, tmp_path)
    (kept,) = tmp_path.iterdir()
    good = kept.read_bytes()
    identification._loaded.cache_clear()
    kept.write_bytes(good[:1000])
    identify(random_field(3, 6), None, 1, 30.0, tmp_path)
    assert kept.stat().st_size == len(good)
    identification._loaded.cache_clear()
    monkeypatch.setattr(identification, "_keep", lambda *_: pytest.fail("made again"))
    identify(random_field(3, 6), None, 1, 30.0, tmp_path)


def test_threads_that_ask_at_once_share_one_table(tmp_path, monkeypatch):
    identification._loaded.cache_clear()
    made, keep = [], identification._keep
    monkeypatch.setattr(identification, "_keep", lambda *arguments: (made.append(1), keep(*arguments)))
    threads = [threading.Thread(target=identify, args=(random_field(4, 6), None, 1, 35.0, tmp_path)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert made == [1]


def test_without_the_extra_one_sentence_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(identification.importlib.util, "find_spec", lambda _: None)
    assert not identification.available()
    with pytest.raises(RefusedInputError, match=r"pip install 'boresight\[lost-in-space\]'"):
        identify(random_field(5, 8), None, 1, 20.0, None)
