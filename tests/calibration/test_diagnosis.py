"""A diagnosis names what is wrong, mends nothing that it has not matched with, and says so where it does not know."""

import json
import re
from dataclasses import fields, replace

import numpy as np
import pytest

from benchmarks.diagnosis import INPUTS, KNOWN, MISTAKES, OF, ORBIT, Input, is_right, make_sets, mends_wrongly, spoil
from benchmarks.images import make_night
from boresight.calibration.calibrate import calibrate
from boresight.calibration.diagnosis.camera_fit import fit_directions
from boresight.calibration.diagnosis.diagnose import diagnose, find_consensus, sample_exposures
from boresight.calibration.diagnosis.explain import add_to_report
from boresight.calibration.diagnosis.result import parse_diagnosis
from boresight.calibration.diagnosis.trials import Hypothesis
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import Role
from boresight.errors import RefusedInputError
from boresight.simulation.scenes import simulate
from boresight.sky.apparent import apparent_directions
from boresight.sky.identification import Recognised
from boresight.telemetry.imports.profile import Axis, Detector, Layout, Profile, Quaternion, Time
from boresight.telemetry.mapping import TelemetryMapping, parse_mapping, profile_members
from boresight.telemetry.quality.report import quality_report
from boresight.telemetry.schema import find_exposures
from boresight.telemetry.sensors import parse_sensor, sensor_document
from tests.effort import few_of

SIMULATED = [one for one in INPUTS if one[0] in {ORBIT, KNOWN}]
FIRST = [
    (ORBIT, ("parity",)),
    (ORBIT, ("focal length +40 %",)),
    (ORBIT, ("swapped axes", "focal length -40 %")),
    (KNOWN, ("origin half a pixel",)),
]
FRAMES = 12


@pytest.fixture(scope="module")
def sets(catalogue):
    return make_sets(catalogue, FRAMES, 3)


@pytest.fixture(scope="module")
def spoiled(sets, catalogue, catalogue_folder):
    """The first of the sets with its image mirrored, and what is found of it."""
    one = spoil(sets[ORBIT], ["parity"], catalogue)
    return one, diagnose(one.telemetry, one.sensor, catalogue, cache_folder=catalogue_folder)


@pytest.mark.few(2)
@pytest.mark.parametrize("case", few_of([*FIRST, *(one for one in SIMULATED if one not in FIRST)], 3), ids=str)
def test_a_mistake_is_named_and_its_mend_matches_the_true_stars(sets, catalogue, catalogue_folder, case):
    name, mistakes = case
    one = spoil(sets[name], mistakes, catalogue)
    found = diagnose(one.telemetry, one.sensor, catalogue, cache_folder=catalogue_folder)
    causes = {MISTAKES[mistake][0] for mistake in mistakes}
    assert is_right(found, causes), found.sentence
    assert not mends_wrongly(found, one, causes, catalogue, catalogue_folder)
    assert parse_diagnosis(json.loads(json.dumps(found.to_dict(), allow_nan=False))) == found


def test_a_mapping_is_told_in_members_that_a_profile_has():
    mapping = TelemetryMapping(
        swapped_axes=True, centred=True, unit_px=4.0, flipped_rows=True, quaternion_order="wxyz", time_shift_s=-18.0
    )
    parts = {"row": Axis, "col": Axis, "detector": Detector, "quaternion": Quaternion, "time": Time, "layout": Layout}
    told = re.findall(r"([a-z]+)\.([a-z_]+)", profile_members(mapping.document()))
    assert len(told) >= 7
    for part, member in told:
        assert part in Profile.__dataclass_fields__
        assert member in parts[part].__dataclass_fields__


def _reading(one, centred, unit_m):
    """Centroids as a file has them that counts in this unit, or from the middle of the detector."""
    sensor = one.sensor
    middle = [(size - 1) / 2 if centred else 0.0 for size in (sensor.rows, sensor.columns)]
    scale = 1.0 if unit_m is None else sensor.pixel_pitch_m / unit_m
    stars = one.telemetry
    return replace(stars, row_px=(stars.row_px - middle[0]) * scale, col_px=(stars.col_px - middle[1]) * scale)


@pytest.mark.parametrize(
    ("centred", "unit_m", "causes"),
    [
        (True, None, {"centred_origin"}),
        (False, 1e-3, {"length_unit"}),
        (True, 1e-6, {"centred_origin", "length_unit"}),
    ],
)
def test_how_centroids_are_counted_is_named_and_mended(sets, catalogue, catalogue_folder, centred, unit_m, causes):
    one = sets[ORBIT]
    read = _reading(one, centred, unit_m)
    found = diagnose(read, one.sensor, catalogue, cache_folder=catalogue_folder)
    assert set(found.names) == causes
    assert found.exposures_solved > 0.8 * found.exposures
    mended = parse_mapping(found.mapping).apply(read, one.sensor)
    np.testing.assert_allclose(mended.row_px, one.telemetry.row_px, atol=1e-6)


@pytest.mark.full
def test_the_real_field_from_its_middle_is_not_taken_for_a_match(sets, catalogue, catalogue_folder, real_sky):
    assert real_sky
    one = sets["real field"]
    found = diagnose(_reading(one, True, None), one.sensor, catalogue, cache_folder=catalogue_folder)
    assert found.names == ("centred_origin",)
    assert found.tried[0].stars < 0.5 * max(tried.stars for tried in found.tried)


def test_centroids_off_the_detector_are_never_said_to_match(sets, catalogue, catalogue_folder):
    one = sets[ORBIT]
    off = replace(
        one.telemetry,
        row_px=one.telemetry.row_px + 0.3 * one.sensor.rows, col_px=one.telemetry.col_px + 0.3 * one.sensor.columns,
    )  # fmt: skip
    found = diagnose(off, one.sensor, catalogue, cache_folder=catalogue_folder)
    assert found.names == ("unknown",)
    assert found.off_detector > 0.2


@pytest.mark.few(1)
@pytest.mark.parametrize("ratio", [0.5, 2.0])
def test_a_focal_length_of_half_or_double_is_found(sets, catalogue, catalogue_folder, ratio):
    one = sets[ORBIT]
    x = one.sensor.initial.copy()
    place = CAMERA_MODELS[one.sensor.camera_model].place(Role.FOCAL)
    x[place] *= ratio
    found = diagnose(one.telemetry, replace(one.sensor, initial=x), catalogue, cache_folder=catalogue_folder)
    assert found.names == ("focal_length",)
    mended = parse_sensor(found.sensor_document)
    assert mended.initial[place] == pytest.approx(one.focal_m, rel=0.01)


def test_images_without_a_time_are_told_the_option_that_gives_it(sets, catalogue, catalogue_folder):
    one = sets[ORBIT]
    width = np.full(len(one.telemetry), 1.0)
    timeless = replace(one.telemetry, time_utc=None, star_id=None, ra_rad=None, dec_rad=None, psf_sigma_px=width)
    found = diagnose(timeless, one.sensor, catalogue, cache_folder=catalogue_folder)
    assert found.names == ("no_time",)
    assert "--times" in found.sentence
    assert "add time_utc" not in found.sentence


@pytest.mark.full
@pytest.mark.parametrize("mistakes", [("swapped axes",), ("parity", "focal length +40 %")], ids=" and ".join)
def test_mistakes_on_the_real_field_are_named(sets, catalogue, catalogue_folder, mistakes, real_sky):
    assert real_sky
    one = spoil(sets["real field"], mistakes, catalogue)
    found = diagnose(one.telemetry, one.sensor, catalogue, cache_folder=catalogue_folder)
    assert is_right(found, {MISTAKES[mistake][0] for mistake in mistakes})


def test_files_that_fit_have_nothing_wrong_and_nothing_mended(sets, catalogue, catalogue_folder):
    one = sets[ORBIT]
    found = diagnose(one.telemetry, one.sensor, catalogue, cache_folder=catalogue_folder)
    assert found.names == ("none",)
    assert found.sensor_document == sensor_document(one.sensor)
    assert found.mapping is None
    assert found.exposures == found.of_exposures == 2 * FRAMES


def test_of_what_are_no_stars_the_cause_is_unknown_and_nothing_is_mended(sets, catalogue, catalogue_folder):
    one, rng = sets[ORBIT], np.random.default_rng(5)
    n = len(one.telemetry)
    noise = replace(
        one.telemetry, row_px=rng.uniform(0, one.sensor.rows - 1, n), col_px=rng.uniform(0, one.sensor.columns - 1, n)
    )
    found = diagnose(noise, one.sensor, catalogue, cache_folder=catalogue_folder)
    assert found.names == ("unknown",)
    assert (found.sensor_document, found.mapping, found.log10_chance) == (None, None, None)
    assert found.tried


def test_a_search_that_is_out_of_time_says_so_and_mends_nothing(spoiled, catalogue, catalogue_folder):
    one, _ = spoiled
    found = diagnose(one.telemetry, one.sensor, catalogue, cache_folder=catalogue_folder, budget_s=0.0)
    assert found.cut_short
    assert found.names == ("unknown",)


@pytest.mark.full
def test_a_calibration_of_a_mirrored_set_says_first_that_it_is(spoiled, catalogue, catalogue_folder):
    one, found = spoiled
    ended = calibrate(one.telemetry, one.sensor, catalogue, CalibrationSettings(), cache_folder=catalogue_folder)
    assert ended.status == "too_few_stars"
    assert ended.advice[0].startswith(found.sentence)


def test_a_quality_report_does_not_deny_what_is_recognised(sets, catalogue, catalogue_folder):
    one = sets[ORBIT]
    plain = quality_report(one.telemetry, one.sensor, catalogue)
    assert plain["verdict"] == "SERIOUS"
    found = diagnose(one.telemetry, one.sensor, catalogue, cache_folder=catalogue_folder)
    report = add_to_report(plain, found)
    assert {"NO_MATCHES", "FEW_STARS"} & {finding["code"] for finding in report["findings"]} == set()
    assert report["verdict"] != "SERIOUS"
    assert report["diagnosis"] == found.to_dict()


def test_the_image_is_as_most_exposures_agree_and_as_none_where_none_do():
    def seen(ratio, mirrored=False):
        return Recognised(np.array([0.0, 0.0, 0.0, 1.0]), mirrored, ratio)

    image = find_consensus([seen(1.4, True), None, seen(0.7), seen(1.401, True), seen(1.39, True), seen(0.9)])
    assert (image.mirrored, image.exposures) == (True, 3)
    assert image.focal_ratio == pytest.approx(1.4)
    assert find_consensus([seen(1.4), seen(0.7), seen(1.4, True), None]) is None


def test_a_sample_is_whole_frames_spread_over_the_set(sets):
    telemetry = sets[ORBIT].telemetry
    sample, exposures = sample_exposures(telemetry, 10)
    assert exposures == 2 * FRAMES
    assert len(find_exposures(sample)) == 10
    assert sample.frame[0] < FRAMES / 3
    assert sample.frame[-1] > 2 * FRAMES / 3


def test_chi2_of_a_moved_principal_point_is_the_minimum_over_all_parameters(sets, catalogue):
    one = sets[ORBIT]
    index = catalogue.find_index(one.truth)
    assert (index >= 0).any()
    exposures = find_exposures(one.telemetry)
    s_i = apparent_directions(catalogue, index, one.telemetry.time_utc, one.telemetry.velocity_m_s)
    starts = np.append(exposures.start, len(one.truth))
    found = fit_directions(one.telemetry, one.sensor, index >= 0, s_i, starts, 10.0)
    mu = np.random.default_rng(1).normal(size=len(found.b))
    stacked = np.linalg.cholesky(found.H + 1e-12 * np.eye(len(mu))).T
    target = np.linalg.solve(stacked.T, found.b)
    w = np.linalg.lstsq(np.vstack([stacked, np.eye(len(mu))]), np.r_[target, mu], rcond=None)[0]
    naive = found.c - 2 * found.b @ w + w @ found.H @ w + (w - mu) @ (w - mu)
    assert found.chi2_at(mu) == pytest.approx(naive, rel=1e-6)


@pytest.mark.parametrize(
    "mapping",
    [
        TelemetryMapping(origin_px=1.0),
        TelemetryMapping(swapped_axes=True, flipped_rows=True),
        TelemetryMapping(flipped_columns=True, quaternion_order="wxyz"),
        TelemetryMapping(quaternion_sense="detector_to_icrs", time_shift_s=-18.0),
        TelemetryMapping(centred=True, unit_px=4.0, flipped_rows=True),
    ],
    ids=str,
)
def test_a_mapping_reads_back_what_a_file_of_its_kind_holds(sets, mapping):
    right, sensor = sets[ORBIT].telemetry, sets[ORBIT].sensor
    row = sensor.rows - 1 - right.row_px if mapping.flipped_rows else right.row_px
    col = sensor.columns - 1 - right.col_px if mapping.flipped_columns else right.col_px
    first, second = (col, row) if mapping.swapped_axes else (row, col)
    q = right.quaternion * ([-1, -1, -1, 1] if mapping.quaternion_sense == "detector_to_icrs" else 1)
    middle = [(size - 1) / 2 if mapping.centred else 0.0 for size in (sensor.rows, sensor.columns)]
    file = replace(
        right,
        row_px=(first - middle[0] + mapping.origin_px) / mapping.unit_px,
        col_px=(second - middle[1] + mapping.origin_px) / mapping.unit_px,
        quaternion=np.roll(q, 1, axis=1) if mapping.quaternion_order == "wxyz" else q,
        time_utc=right.time_utc - np.timedelta64(round(mapping.time_shift_s), "s"),
    )
    read = parse_mapping(json.loads(json.dumps(mapping.document()))).apply(file, sensor)
    np.testing.assert_allclose(read.row_px, right.row_px, atol=1e-9)
    np.testing.assert_allclose(read.col_px, right.col_px, atol=1e-9)
    np.testing.assert_array_equal(read.quaternion, right.quaternion)
    np.testing.assert_array_equal(read.time_utc, right.time_utc)


@pytest.mark.parametrize(
    "document",
    [
        {"origin": 1},
        {"origin_px": "one"},
        {"origin_px": float("nan")},
        {"quaternion_order": "zyxw"},
        {"swapped_axes": 1},
    ],
    ids=str,
)
def test_a_mapping_that_says_nothing_known_is_refused(document):
    with pytest.raises(RefusedInputError):
        parse_mapping(document)


def test_a_hypothesis_mends_only_what_it_names(sets):
    sensor = sets[ORBIT].sensor
    mended = Hypothesis(("parity", "focal_length"), parity=True, focal_ratio=1.1).mend(sensor)
    assert mended.parity == -sensor.parity
    assert mended.initial[0] == pytest.approx(1.1 * sensor.initial[0])
    changed = {one.name for one in fields(sensor) if getattr(mended, one.name) is not getattr(sensor, one.name)}
    assert changed == {"parity", "initial"}


def test_inputs_are_as_many_as_the_benchmark_says(sets):
    assert len(INPUTS) == OF
    assert isinstance(sets[ORBIT], Input)


def test_neither_the_air_nor_an_aspect_that_is_held_passes_for_times_of_another_epoch(catalogue, catalogue_folder):
    night = make_night(12, 5)
    stars = simulate(night, np.random.default_rng(3), catalogue)
    stars = replace(stars, star_id=None, ra_rad=None, dec_rad=None, quaternion=None, velocity_m_s=None)
    sensor = replace(night.sensor, free=("f_m", "u0_px", "v0_px", "k1"))
    found = diagnose(stars, sensor, catalogue, cache_folder=catalogue_folder)
    assert "wrong_epoch" not in found.names
