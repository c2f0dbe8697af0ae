"""A sensor file from stars alone: parity and focal length of mirrored and upright cameras, its calibration, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.images import OPTICS, make_night
from boresight.calibration.calibrate import calibrate
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.proposal import PITCH_UM, propose
from boresight.errors import RefusedInputError
from boresight.images.detection import DetectionOptions
from boresight.images.extraction import extract, sensor_of_images
from boresight.images.limits import ImageSource
from boresight.simulation.images import simulate_images
from boresight.simulation.scenes import calibration_scenario, simulate
from boresight.telemetry.data_sheets import LensAndDetector
from boresight.telemetry.readers import read_telemetry
from boresight.telemetry.schema import select_rows
from boresight.telemetry.sensors import parse_sensor, sensor_document
from tests.images.files import write_fits

ROWS, COLUMNS, PITCH_M = 480, 640, 15e-6
#: Electrons of a star of magnitude 0, by focal length: a longer lens sees fewer stars, and has a larger opening.
CAMERAS = [
    (25.0, -1, 6e5),
    (16.0, 1, 4e5),
    (12.0, -1, 3e5),
    (12.0, 1, 3e5),
    (35.0, 1, 1.5e6),
    (50.0, -1, 3e6),
    (50.0, 1, 3e6),
]


def night_of(focal_mm, parity, frames=6):
    """A camera of that lens, whose principal point and distortion are off, before a clear sky."""
    night = make_night(frames)
    document = sensor_document(night.sensor) | {"parity": parity}
    document["detector"] = {"rows": ROWS, "columns": COLUMNS, "pixel_pitch_m": PITCH_M}
    document["initial"] |= {"f_m": focal_mm * 1e-3, "u0_px": 320.0, "v0_px": 240.0}
    truth = night.truth.copy()
    truth[[0, 1, 2, 3]] = 1.0, focal_mm * 1e-3, 325.0, 235.0
    truth[4:] = [-0.05, 0.0, 0.0, 0.0, 0.0]
    return replace(night, sensor=parse_sensor(document), truth=truth)


def images_of(night, electrons, folder, catalogue):
    optics = replace(OPTICS, zero_magnitude_e=electrons)
    made = simulate_images(night, optics, np.random.default_rng(1), catalogue)
    return [write_fits(folder / f"night-{image.frame:02d}.fits", image) for image in made]


def extracted(paths):
    sources = [ImageSource(path, path.name) for path in paths]
    return extract(sources, sensor_of_images(sources, LensAndDetector()), DetectionOptions(gain_e_per_dn=1.0)).telemetry


@pytest.mark.full
@pytest.mark.parametrize("camera", CAMERAS)
def test_images_alone_tell_parity_and_focal_length_and_calibrate_from_there(
    camera, tmp_path, catalogue, catalogue_folder
):
    focal_mm, parity, electrons = camera
    night = night_of(focal_mm, parity)
    stars = extracted(images_of(night, electrons, tmp_path, catalogue))
    found = propose(
        stars,
        catalogue,
        LensAndDetector(pixel_pitch_um=PITCH_M * 1e6, rows=ROWS, columns=COLUMNS, site=night.sensor.site),
        cache_folder=catalogue_folder,
    )
    sensor = found.described.sensor
    assert (sensor.rows, sensor.columns, sensor.parity) == (ROWS, COLUMNS, parity)
    true_px = focal_mm * 1e-3 / PITCH_M
    assert found.focal_px == pytest.approx(true_px, rel=0.01)
    assert abs(found.focal_px - true_px) < 5 * found.focal_sigma_px
    assert found.solved == found.exposures == night.frames
    assert 0.01 < sensor.centroid_sigma_px < 0.4
    assert 4.0 < sensor.magnitude_limit < 11.0  # the brightest lens sees 10.1; the catalogue is sparse from 9 on
    done = calibrate(
        stars, sensor, catalogue, CalibrationSettings(leave_out_doubles=True), cache_folder=catalogue_folder
    )
    assert done.status == "converged"
    for name in ("f_m", "u0_px", "v0_px"):
        place = list(done.covariance.names).index(name)
        true = night.truth[list(sensor_document(night.sensor)["initial"]).index(name)]
        off = done.parameters[name] - true
        spread = sensor.typical_sigma[list(sensor_document(sensor)["initial"]).index(name)]
        assert abs(off) < 5 * np.sqrt(done.covariance.matrix[place][place])
        assert abs(done.parameters[name] - sensor_document(sensor)["initial"][name]) < 3 * spread


@pytest.fixture(scope="module")
def centroids(catalogue):
    """Centroids without names or times of a tracker whose image is mirrored, and the tracker."""
    scenario = calibration_scenario(3, 12)
    stars = simulate(scenario, np.random.default_rng(2), catalogue)
    return replace(stars, star_id=None, time_utc=None, ra_rad=None, dec_rad=None, quaternion=None), scenario.sensor


@pytest.mark.full
def test_telemetry_alone_tells_a_sensor_and_what_is_given_scales_it(centroids, catalogue, catalogue_folder):
    stars, truth = centroids
    true_px = truth.initial[0] / truth.pixel_pitch_m
    sized = LensAndDetector(rows=truth.rows, columns=truth.columns)
    found = propose(stars, catalogue, sized, cache_folder=catalogue_folder)
    assert found.described.sensor.parity == truth.parity
    assert found.focal_px == pytest.approx(true_px, rel=0.01)
    assert found.described.sensor.pixel_pitch_m == pytest.approx(PITCH_UM * 1e-6)
    by_lens = propose(stars, catalogue, replace(sized, focal_length_mm=16.0), cache_folder=catalogue_folder)
    assert by_lens.described.sensor.pixel_pitch_m == pytest.approx(16e-3 / found.focal_px, rel=1e-4)
    wrong = replace(sized, focal_length_mm=25.0, pixel_pitch_um=2.2, parity=-truth.parity)
    mended = propose(stars, catalogue, wrong, cache_folder=catalogue_folder)
    assert mended.focal_px == pytest.approx(found.focal_px, rel=1e-3)
    assert mended.described.sensor.parity == truth.parity
    assert len(mended.sentences) > len(by_lens.sentences)  # the lens that was given is contradicted
    alone = propose(stars, catalogue, cache_folder=catalogue_folder)
    assert alone.focal_px == pytest.approx(true_px, rel=0.01)
    assert abs(alone.described.sensor.rows - truth.rows) < 0.05 * truth.rows
    assert set(found.described.reasons) >= {"detector.pixel_pitch_m", "parity", "initial.focal_length"}


def test_what_cannot_be_solved_is_refused_with_the_fields_that_were_tried(centroids, catalogue, catalogue_folder):
    stars, truth = centroids
    rng = np.random.default_rng(3)
    noise = replace(
        stars,
        row_px=rng.uniform(0, truth.rows, len(stars)),
        col_px=rng.uniform(0, truth.columns, len(stars)),
        magnitude=None,
    )
    with pytest.raises(RefusedInputError) as refusal:
        propose(noise, catalogue, budget_s=0.0, cache_folder=catalogue_folder)  # the first guess alone
    assert "17° to 44.4°" in str(refusal.value)
    few = replace(stars, frame=np.arange(len(stars)) // 2, exposure=np.zeros(len(stars), np.int64))
    few = select_rows(few, slice(0, 20))
    with pytest.raises(RefusedInputError) as refusal:
        propose(few, catalogue, cache_folder=catalogue_folder)
    assert "fewer than 7 stars" in str(refusal.value)
    with pytest.raises(RefusedInputError):
        propose(stars, catalogue, LensAndDetector(rows=100, columns=100), cache_folder=catalogue_folder)
    with pytest.raises(RefusedInputError):
        propose(stars, catalogue, LensAndDetector(pixel_pitch_um=-1.0), cache_folder=catalogue_folder)


def test_the_real_sky_tells_its_lens(real_sky, catalogue, catalogue_folder):
    stars = read_telemetry(real_sky / "esa-5-frames.csv")
    known = LensAndDetector(rows=768, columns=1024, pixel_pitch_um=6.9)
    found = propose(stars, catalogue, known, cache_folder=catalogue_folder)
    assert (found.solved, found.described.sensor.parity) == (5, -1)
    assert found.focal_px * 6.9e-3 == pytest.approx(35.30, abs=0.05)
    assert found.described.sensor.centroid_sigma_px == pytest.approx(0.13, abs=0.03)
    json.dumps(found.described.document)
