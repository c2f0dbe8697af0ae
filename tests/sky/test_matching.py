"""Stars matched to the catalogue, recognised without any attitude, and read from the catalogue's file."""

import dataclasses
import threading
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from benchmarks.stars import star_frames
from boresight.calibration.matching.rematch import ground_covariance, rematch
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.estimation.attitude import conjugate, product, rotation_vector, to_matrix, wahba
from boresight.estimation.blocks import computing_on
from boresight.kernels import matching as loops
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.simulation.sensors import st16_sensor, st16_truth
from boresight.sky import identification, matching
from boresight.sky.apparent import apparent_directions, days_since_j2000, earth_state
from boresight.sky.catalogue import SINGLE_STAR, Catalogue, load_catalogue
from boresight.sky.guide_stars import (
    DOUBLE,
    FAINTER_MAG,
    UNRELIABLE,
    GuideStars,
    ObserverMotion,
    close_pairs,
    compute_pulls,
    flag_stars,
    guide_stars,
    observer_motion,
    phrases,
    star_flags,
)
from boresight.sky.identification import field_of_view_deg, identify
from boresight.sky.matching import ROW_REASONS, STARTS, Detections, match
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.schema import find_exposures
from boresight.telemetry.sensors import read_sensor
from tests.effort import effort, few_of
from tests.exposures import SIGMA, Exposure

CONE = 0.26


def reason(words):
    (place,) = (place for place, phrase in enumerate(ROW_REASONS) if words in phrase)
    return place


@dataclass
class Image:
    detections: Detections
    sky: np.ndarray
    true: np.ndarray
    density: float = 1.0

    def match(self, minimum_stars=4, identify=None):
        order = np.argsort(self.sky[:, 2], kind="stable")
        n = len(order)
        stars = GuideStars(np.arange(1, n + 1)[order], self.sky[order], np.zeros((n, 3)), np.zeros(n), self.density)
        motion = ObserverMotion(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))
        return match(self.detections, stars, motion, CONE, minimum_stars, identify)

    def with_(self, **changes):
        return replace(self, detections=replace(self.detections, **changes))


def image(seed, n=12, named=12, false=0, extra=(), exact=False, noise=1.0, y=None):
    rng = np.random.default_rng(seed)
    field = Exposure(rng, n + false)
    sky = field.stars(np.zeros(11) if y is None else y)[:n]
    s = field.s + noise * SIGMA * np.einsum("nr,nra->na", rng.normal(size=(n + false, 2)), field.T)
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    true = np.r_[np.arange(1, n + 1), np.zeros(false, int)]
    given_id = np.where(np.arange(n + false) < named, true, 0)
    known = given_id > 0
    given_s = np.full((n + false, 3), np.nan)
    given_s[known] = sky[given_id[known] - 1]
    detections = Detections(
        frame_start=np.array([0, 1]), row_start=np.array([0, n + false]), s=s,
        G=field.G * (1e-6 if exact else 1.0), sigma_rad=field.sigma, star_id=given_id, given_s=given_s,
        own=np.zeros(n + false, np.bool_), quaternion=np.full((1, 4), np.nan), time_s=np.zeros(1),
    )  # fmt: skip
    beside = [np.atleast_2d(star(field, sky)) for star in extra]
    return Image(detections, np.concatenate([sky, *beside]), true)


def beside(k, sigmas, turn=0.0):
    def star(field, sky):
        c = sky[k] + sigmas * SIGMA * ([np.cos(turn), np.sin(turn)] @ field.T[k]) @ field.C
        return c / np.linalg.norm(c)

    return star


# One to one.


@settings(max_examples=effort(16, 80))
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(3, 14),
    named=st.integers(0, 14),
    false=st.integers(0, 4),
    companions=st.lists(st.tuples(st.integers(0, 2), st.floats(1.0, 30.0), st.floats(0, 6.28)), max_size=4),
    exact=st.booleans(),
)
def test_no_star_is_matched_twice_and_every_match_is_a_star_of_the_sky(seed, n, named, false, companions, exact):
    scene = image(seed, n, min(named, n), false, [beside(*star) for star in companions], exact)
    if named < 2:
        scene = scene.with_(quaternion=Rotation.from_matrix(np.eye(3)).as_quat()[None])
    answer = scene.match()
    found = answer.star_id > 0
    assert len(set(answer.star_id[found])) == found.sum()
    np.testing.assert_allclose(answer.s_i[found], scene.sky[answer.star_id[found] - 1])
    np.testing.assert_array_equal(found, answer.row_reason == loops.MATCHED)
    np.testing.assert_array_equal(found, np.isfinite(answer.s_i[:, 0]))
    np.testing.assert_array_equal(found, np.isfinite(answer.tolerance_rad))
    assert (answer.reason[0] == 0) == (found.sum() >= 4)
    assert np.isfinite(answer.C).all() or not found.any()


@settings(max_examples=effort(12, 40))
@given(seed=st.integers(0, 2**32), named=st.integers(4, 12), size=st.floats(0.0, 1.0))
def test_whatever_the_parameters_are_off_by_within_their_covariance_no_star_is_taken_for_another(seed, named, size):
    y = np.r_[np.zeros(3), size * np.random.default_rng(seed).normal(size=8)]
    answer = image(seed, 12, named, 2, y=y).match()
    assume(answer.reason[0] == 0)
    true = np.r_[np.arange(1, 13), 0, 0]
    assert np.isin(answer.star_id - true, [0, *-np.arange(1, 13)])[answer.star_id == 0].all()
    np.testing.assert_array_equal(answer.star_id[answer.star_id > 0], true[answer.star_id > 0])


# Every reason.


def test_false_detections_have_no_star_and_two_of_one_star_are_both_in_doubt():
    answer = image(1, 12, 6, false=1).match()
    assert answer.star_id.tolist() == [*range(1, 13), 0]
    assert answer.row_reason[12] == reason("no catalogue star")
    scene = image(3, 12, 8, exact=True, noise=0.0)
    s = scene.detections.s.copy()
    s[11] = s[10] + 1.0 * SIGMA * np.array([1.0, 0.0, -s[10, 0] / s[10, 2]])
    s[11] /= np.linalg.norm(s[11])
    answer = scene.with_(s=s).match()
    assert answer.row_reason[10] == answer.row_reason[11] == reason("equally well")


@pytest.mark.parametrize("apart", [1.5, 2.5, 8.0])
def test_a_second_star_makes_an_unnamed_detection_ambiguous_only_where_it_is_nearly_as_likely(apart):
    answer = image(2, 12, 8, extra=[beside(10, apart)], exact=True, noise=0.3).match()
    assert (np.delete(answer.star_id, 10) == np.delete(np.arange(1, 13), 10)).all()
    if apart < 8:
        assert answer.row_reason[10] == reason("equally well")
    else:
        assert answer.star_id[10] == 11


def test_two_stars_that_may_have_changed_places_are_called_ambiguous():
    scene, field = image(4, 5, 3), Exposure(np.random.default_rng(4), 5)
    # the second star lies where the three named ones leave the first most uncertain
    Lambda, _ = field.information(np.arange(5) < 3)
    _, axes = np.linalg.eigh(field.A[3] @ np.linalg.solve(Lambda, field.A[3].T))
    close = scene.sky[3] + 12 * SIGMA * axes[:, 1] @ field.T[3] @ field.C
    scene.sky[4] = close / np.linalg.norm(close)
    s, G = scene.detections.s.copy(), scene.detections.G.copy()
    s[4], G[4] = field.C @ scene.sky[4], G[3]
    wide, narrow = (scene.with_(s=s, G=scale * G).match() for scale in (4.0, 1e-6))
    assert wide.row_reason.tolist() == [loops.MATCHED] * 3 + [reason("equally well")] * 2
    assert narrow.star_id.tolist() == [1, 2, 3, 4, 5]


def test_in_a_gate_that_holds_chance_stars_nothing_is_taken():
    scene = image(5, 12, 4)
    scene.density = 1e9
    answer = scene.match()
    assert (answer.row_reason[4:] == reason("too wide")).any()
    assert set(answer.row_reason[4:]) <= {reason("too wide"), reason("no catalogue star")}


@pytest.mark.parametrize("exact", [True, False], ids=["refined", "ground"])
def test_a_wrong_name_disagrees_with_the_other_arcs(exact):
    scene = image(6, 12, 12, exact=exact)
    star_id, given_s = scene.detections.star_id.copy(), scene.detections.given_s.copy()
    star_id[[2, 9]], given_s[[2, 9]] = star_id[[9, 2]], given_s[[9, 2]]
    answer = scene.with_(star_id=star_id, given_s=given_s).match()
    np.testing.assert_array_equal(answer.star_id[answer.star_id > 0], scene.true[answer.star_id > 0])
    assert (answer.star_id[[2, 9]] != star_id[[2, 9]]).all()
    assert (answer.star_id > 0).sum() >= 10


def test_a_name_far_off_its_star_disagrees():
    scene = image(6, 12, 12, exact=True)
    given_s = scene.detections.given_s.copy()
    given_s[2] = given_s[9] + 1e-2
    answer = scene.with_(given_s=given_s / np.linalg.norm(given_s, axis=1, keepdims=True)).match()
    assert answer.star_id[2] in {0, 3}
    assert (np.delete(answer.star_id, 2) > 0).all()


def test_without_anything_there_is_no_attitude_and_too_few_stars_are_said_to_be_too_few():
    answer = image(7, 12, 0).match()
    assert (answer.row_reason == reason("no attitude")).all()
    assert answer.start[0] == STARTS.index("none")
    assert np.isnan(answer.C).all()
    scene = image(8, 6, 0)
    hinted = scene.with_(quaternion=Rotation.from_matrix(Exposure(np.random.default_rng(8), 6).C).as_quat()[None])
    assert hinted.match(4).reason[0] == 0
    answer = hinted.match(7)
    assert answer.reason[0] == 2
    assert (answer.row_reason == reason("too few other stars")).all()


# Lost in space.


def test_what_the_identification_answers_is_checked_by_matching():
    scene = image(9, 12, 0)
    right = Rotation.from_matrix(Exposure(np.random.default_rng(9), 12).C)
    off = Rotation.from_rotvec([0.01, -0.01, 0.02]) * right
    asked = []

    def identify(exposure, turn=off):
        asked.append(exposure)
        return turn.as_quat()

    answer = scene.match(identify=identify)
    assert asked == [0]
    assert answer.start[0] == STARTS.index("lost in space")
    assert answer.star_id.tolist() == list(range(1, 13))

    nonsense = scene.match(identify=lambda _: Rotation.from_rotvec([0.0, 1.0, 0.0]).as_quat())
    assert not (nonsense.star_id > 0).any()
    assert not (scene.match(identify=lambda _: None).star_id > 0).any()


SENSOR = st16_sensor(1)


@pytest.fixture(scope="module")
def matched():
    catalogue, rng = load_catalogue(None), np.random.default_rng(12)
    stars = star_frames(40, SENSOR, st16_truth(1), catalogue, rng)
    half_named = dataclasses.replace(stars, star_id=np.where(rng.random(len(stars)) < 0.5, stars.star_id, 0))
    P, settings = ground_covariance(SENSOR, 10.0), CalibrationSettings(match="rematch")
    return lambda: rematch(half_named, SENSOR, catalogue, SENSOR.initial, P, settings, None)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_blocks_and_threads_change_no_bit_of_the_matches(matched, monkeypatch, threads):
    whole = matched()
    monkeypatch.setattr(matching, "FRAMES", 7)
    with computing_on(threads):
        in_parts = matched()
    for field in dataclasses.fields(whole):
        np.testing.assert_array_equal(getattr(in_parts, field.name), getattr(whole, field.name), strict=True)
    assert (whole.star_id > 0).mean() > 0.9


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


@pytest.mark.full
@pytest.mark.parametrize("case", few_of([(1, 1), (3, -1), *((number, 1) for number in range(2, 7))], 2))
def test_under_a_ground_calibration_rich_fields_of_either_parity_are_recognised_and_none_wrongly(
    case, catalogue, folder
):
    number, parity = case
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


RAD_PER_MAS = np.pi / 180 / 3.6e6
SIRIUS, ALPHA_CENTAURI, VEGA, POLARIS = 32349, 71683, 91262, 11767
XI_URSAE_MAJORIS = 55203


def star(catalogue, hip):
    return int(catalogue.find_index(np.array([hip]))[0])


def same(one, other):
    pairs = ((getattr(one, field.name), getattr(other, field.name)) for field in fields(Catalogue))
    return all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs)


def test_the_colours_are_those_of_known_stars_and_unknown_where_the_catalogue_writes_none(catalogue):
    polaris, betelgeuse, sirius = catalogue.colour_bv[catalogue.find_index(np.array([11767, 27989, 32349]))]
    assert (polaris, betelgeuse, sirius) == (0.636, 1.500, 0.009)
    assert np.isnan(catalogue.colour_bv).sum() == 1143
    assert np.nanmin(catalogue.colour_bv) > -0.6


def test_the_catalogue_goes_down_to_the_magnitude_asked_for(catalogue):
    assert len(catalogue) == 117955
    assert len(load_catalogue(None, 8.0)) == 37622
    assert len(load_catalogue(None, 6.0)) == np.count_nonzero(catalogue.magnitude <= 6.0)
    none = load_catalogue(None, magnitude_limit=-5.0)
    assert (len(none), none.find_index(np.array([1, 2])).tolist()) == (0, [-1, -1])


@pytest.mark.parametrize("numbers", [[0, 3, 3, 7], [3, 7, 5_000_000]])
def test_a_number_is_found_where_it_stands_first_and_no_other(catalogue, numbers):
    few = catalogue.brighter_than(1.0)
    small = replace(few, **{one.name: getattr(few, one.name)[: len(numbers)] for one in fields(few)})
    small = replace(small, hip=np.array(numbers))
    asked = np.array([-(2**62), -1, 0, 1, 3, 7, 8, 9, 5_000_000, 2**62])
    expected = [numbers.index(one) if one in numbers else -1 for one in asked.tolist()]
    assert small.find_index(asked).tolist() == expected


def test_sirius_has_the_numbers_of_the_published_catalogue_in_which_most_stars_are_single(catalogue):
    k = star(catalogue, SIRIUS)
    assert np.degrees(catalogue.ra_rad[k]) == pytest.approx(101.28854105, abs=1e-6)
    assert np.degrees(catalogue.dec_rad[k]) == pytest.approx(-16.71314306, abs=1e-6)
    assert catalogue.parallax_rad[k] / RAD_PER_MAS == pytest.approx(379.21, abs=0.01)
    assert catalogue.pm_ra_cosdec_rad_yr[k] / RAD_PER_MAS == pytest.approx(-546.01, abs=0.01)
    assert catalogue.pm_dec_rad_yr[k] / RAD_PER_MAS == pytest.approx(-1223.07, abs=0.01)
    assert catalogue.magnitude[k] == pytest.approx(-1.09, abs=0.01)
    assert set(np.unique(catalogue.solution_type)) <= {0, 1, 3, 5, 7, 9}
    assert 0.9 < np.mean(catalogue.solution_type == SINGLE_STAR) < 1.0


@pytest.mark.parametrize("hip", [XI_URSAE_MAJORIS, 0, -1, 999_999, 115125])
def test_numbers_that_are_not_there_answer_minus_one(deep_catalogue, hip):
    assert star(deep_catalogue, hip) == -1


@given(hip=st.lists(st.integers(-5, 130_000), max_size=50))
def test_index_of_finds_each_star_under_its_own_number(catalogue, hip):
    hip = np.array(hip, dtype=np.int64)
    index = catalogue.find_index(hip)
    assert (catalogue.hip[index[index >= 0]] == hip[index >= 0]).all()
    assert not np.isin(hip[index < 0], catalogue.hip).any()


def test_each_magnitude_has_its_own_cache_of_what_the_package_holds_and_nothing_half_written(tmp_path, monkeypatch):
    folder = tmp_path / "catalogue"
    first, second = load_catalogue(folder, 6.0), load_catalogue(folder, 6.0)
    assert same(first, second)
    assert [path.suffix for path in folder.iterdir()] == [".npz"]
    assert len(load_catalogue(folder, 5.0)) < len(first)
    monkeypatch.setattr("boresight.sky.catalogue._read_package", lambda _: pytest.fail("the package was read again"))
    assert len(load_catalogue(folder, 6.0)) > 4000


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 half a file", b"\x93NUMPY"])
def test_a_damaged_cache_is_made_again(tmp_path, content):
    whole = load_catalogue(tmp_path, 6.0)
    cache = next(tmp_path.iterdir())
    cache.write_bytes(content)
    assert same(load_catalogue(tmp_path, 6.0), whole)
    assert cache.stat().st_size > 1000


def test_a_folder_that_cannot_be_made_means_no_cache(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_bytes(b"")
    assert len(load_catalogue(blocked / "catalogue", 6.0)) > 4000


ARCSEC = np.pi / 180 / 3600


def made(ra_rad, dec_rad, magnitude, **columns):
    n = len(ra_rad)
    columns = {"ra_rad": ra_rad, "dec_rad": dec_rad, "magnitude": magnitude, **columns}
    arrays = {field.name: np.zeros(n) for field in fields(Catalogue)} | {"solution_type": np.full(n, SINGLE_STAR)}
    return Catalogue(
        **arrays | {name: np.asarray(cells) for name, cells in columns.items()} | {"hip": np.arange(1, n + 1)}
    )


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 30), blend_arcsec=st.floats(1.0, 3000.0))
def test_the_flags_are_those_of_a_search_through_all_pairs(seed, n, blend_arcsec):
    rng = np.random.default_rng(seed)
    stars = made(
        0.02 * rng.random(n), 0.02 * rng.random(n), rng.uniform(0, 10, n), solution_type=rng.choice([1, 5, 7], n)
    )
    flags = star_flags(stars, blend_arcsec * ARCSEC)
    c = np.cos(stars.dec_rad)
    s = np.column_stack([c * np.cos(stars.ra_rad), c * np.sin(stars.ra_rad), np.sin(stars.dec_rad)])
    near = np.linalg.norm(s[:, None] - s[None], axis=2) <= 2 * np.sin(blend_arcsec * ARCSEC / 2)
    matters = stars.magnitude[None] - stars.magnitude[:, None] <= FAINTER_MAG
    expected = (near & matters & ~np.eye(n, dtype=bool)).any(axis=1)
    np.testing.assert_array_equal((flags & DOUBLE) > 0, expected)
    np.testing.assert_array_equal((flags & UNRELIABLE) > 0, stars.solution_type != SINGLE_STAR)
    some = rng.permutation(n)[: n // 2]
    np.testing.assert_array_equal(flag_stars(stars, some, blend_arcsec * ARCSEC), flags[some])


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 30), psf_arcsec=st.floats(1.0, 300.0))
def test_what_neighbours_draw_is_the_sum_of_a_search_through_all_pairs(seed, n, psf_arcsec):
    rng = np.random.default_rng(seed)
    stars = made(0.005 * rng.random(n), 0.005 * rng.random(n), rng.uniform(0, 10, n))
    c = np.cos(stars.dec_rad)
    s = np.column_stack([c * np.cos(stars.ra_rad), c * np.sin(stars.ra_rad), np.sin(stars.dec_rad)])
    d = np.linalg.norm(s[:, None] - s[None], axis=2)
    ratio = 10 ** (0.4 * (stars.magnitude[:, None] - stars.magnitude[None]))
    drawn = np.where(d <= 8 * psf_arcsec * ARCSEC, ratio * d * np.exp(-((d / (psf_arcsec * ARCSEC)) ** 2) / 4), 0)
    some = rng.permutation(n)[: n // 2]
    np.testing.assert_allclose(compute_pulls(stars, some, psf_arcsec * ARCSEC), drawn.sum(axis=1)[some], rtol=1e-9)


def test_a_companion_of_a_much_brighter_star_is_a_double_and_few_bright_ones_are(catalogue):
    pair = made(np.array([0.0, 20 * ARCSEC]), np.zeros(2), np.array([1.0, 6.0]))
    assert star_flags(pair, 30 * ARCSEC).tolist() == [0, DOUBLE]
    assert star_flags(pair, 10 * ARCSEC).tolist() == [0, 0]
    assert [phrases(flags) for flags in (0, UNRELIABLE | DOUBLE)] == [[], ["unreliable astrometry", "double"]]
    bright = star_flags(catalogue, 140 * ARCSEC)[catalogue.magnitude < 5.0]
    assert 0.01 < np.mean(bright & DOUBLE > 0) < 0.1
    assert 0.02 < np.mean(bright & UNRELIABLE > 0) < 0.3


@pytest.mark.parametrize("hip", [71683, 71681, 78820, 78821])  # alpha Centauri A and B, beta Scorpii
def test_famous_doubles_are_known(hip, catalogue):
    flags = star_flags(catalogue, 60 * ARCSEC)
    assert flags[catalogue.find_index(np.array([hip]))[0]] & DOUBLE


NOON = np.array(["2026-03-01T12:00", "2026-03-01T12:00", "NaT", "2026-09-01T00:00"], "datetime64[us]")


def test_only_the_brighter_of_two_stars_in_one_image_can_be_matched_and_none_too_faint_to_be_detected():
    catalogue = made([0.0, 1e-4, 0.1, 0.1], [0.0, 0.0, 0.0, 3e-4], [3.0, 4.0, 4.5, 4.2])
    found = [guide_stars(catalogue, 6.0, apart).hip.tolist() for apart in (2e-4, 5e-4, 5e-5)]
    assert found == [[1, 3, 4], [1, 4], [1, 2, 3, 4]]
    faint = made([0.0, 1e-4], [0.0, 0.0], [5.0, 7.0])
    assert [guide_stars(faint, limit, 1e-3).hip.tolist() for limit in (6.0, 4.0)] == [[1], []]


@pytest.mark.parametrize(("n", "reach"), [(0, 0.1), (1, 0.1), (2, 3.0), (300, 0.2), (3000, 0.01), (3000, 0.0)])
def test_close_pairs_are_those_of_a_tree_of_neighbours(n, reach):
    place = np.random.default_rng(n).normal(size=(n, 3))
    place /= np.linalg.norm(place, axis=1, keepdims=True)
    place = np.concatenate([place, place[:2]])  # some in one place, and at the same height
    a, b = close_pairs(place, reach)
    expected = KDTree(place).query_pairs(reach) if len(place) else set()
    assert sorted(zip(a.tolist(), b.tolist(), strict=True)) == sorted(expected)


def test_guide_stars_ascend_in_declination_and_their_motion_is_across_the_line_of_sight(catalogue):
    stars = guide_stars(catalogue, 5.5, 1e-4)
    assert (np.diff(stars.place[:, 2]) >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(stars.place, axis=1), 1)
    assert stars.density == pytest.approx(len(stars.hip) / (4 * np.pi))
    assert (catalogue.magnitude[catalogue.find_index(stars.hip)] <= 5.5).all()
    stars = guide_stars(made([1.0, 2.0], [0.5, -0.5], [3.0, 3.0], pm_dec_rad_yr=[1e-6] * 2), 6.0, 1e-4)
    np.testing.assert_allclose(np.sum(stars.place * stars.motion, axis=1), 0, atol=1e-20)
    np.testing.assert_allclose(np.linalg.norm(stars.motion, axis=1), 1e-6)
    assert (stars.motion[:, 2] > 0).all()


def test_the_observer_moves_with_the_earth_and_the_satellite():
    velocity = np.array([[7e3, 0.0, 0.0], [np.nan] * 3, [0.0] * 3, [0.0] * 3])
    motion = observer_motion(NOON, velocity)
    place, speed = earth_state(days_since_j2000(NOON[[0, 3]]))
    np.testing.assert_allclose(motion.earth_au[[0, 1, 3]], place[[0, 0, 1]])
    np.testing.assert_allclose(motion.beta[0] - motion.beta[1], [7e3 / 299792458, 0, 0], atol=1e-18)
    np.testing.assert_allclose(motion.beta[3], speed[1] / 173.1446326846693)
    assert 34.9 < motion.years[0] < 35.0
    assert np.isnan(motion.years).tolist() == [False, False, True, False]  # at an unknown time no star has a place
    np.testing.assert_array_equal(motion[1:4].years, motion.years[1:4])
    np.testing.assert_array_equal(motion[1:4].beta, motion.beta[1:4])
