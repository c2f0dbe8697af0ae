"""From files of images to telemetry and to a calibration in one command; what cannot be used is named, each file."""

import hashlib
import json
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from PIL import Image
from scipy import stats

import boresight as bs
from boresight.errors import RefusedInputError
from boresight.images.detection import DetectionOptions
from boresight.images.extraction import IMAGE_COLUMNS, extract
from boresight.images.limits import ImageLimits, ImageSource
from boresight.sky.matching import BLENDED, ROW_REASONS
from boresight.telemetry.readers import read_telemetry
from tests.cli.conftest import accepted, assert_refused, boresight, data_folder  # noqa: F401 - fixtures
from tests.images.files import write_fits
from tests.refusals import has_code

FREE = ("s", "f_m", "u0_px", "v0_px", "k1", "k2")


@pytest.fixture(scope="session")
def images(folder):
    return sorted(folder.glob("*.fits"))


def test_each_image_is_a_frame_in_the_order_of_time_and_keeps_its_hash(folder, images, tmp_path):
    found = bs.extract(images[::-1], folder / "camera.json", processes=1, progress=False)
    assert [image.name for image in found.images] == [path.name for path in images]
    for suffix in ("csv", "parquet"):
        found.save(tmp_path / f"t.{suffix}")
        read = read_telemetry(tmp_path / f"t.{suffix}")
        assert tuple(read.unknown) == IMAGE_COLUMNS
        hashes = dict(zip(read.frame.tolist(), read.unknown["image_sha256"].to_pylist(), strict=True))
        assert hashes == {k: hashlib.sha256(path.read_bytes()).hexdigest() for k, path in enumerate(images)}
        assert np.array_equal(read.row_px, found.telemetry.row_px)
        assert np.array_equal(read.sigma_px, found.telemetry.sigma_px)
    assert found.to_dict()["hot_pixels"] > 0
    assert "stars" in repr(found)


@pytest.mark.full
def test_several_processes_say_what_one_says(folder, images):
    one, two = (bs.extract(images[:3], folder / "camera.json", processes=n, progress=False) for n in (1, 2))
    assert one.to_dict() == two.to_dict()
    assert np.array_equal(one.telemetry.col_px, two.telemetry.col_px)


def test_every_image_that_cannot_be_used_is_named(images, night, tmp_path):
    for name in ("bad-1.fits", "bad-2.fits"):
        (tmp_path / name).write_bytes(b"SIMPLE  = nothing")
    sources = [ImageSource(path, path.name) for path in [*images[:2], *sorted(tmp_path.iterdir()), images[2]]]
    with pytest.raises(RefusedInputError, match=r"bad-"):
        extract(sources, night.sensor, DetectionOptions())
    with pytest.raises(RefusedInputError, match="at most 2"):
        extract(sources, night.sensor, DetectionOptions(), limits=ImageLimits(images=2))
    with pytest.raises(RefusedInputError, match="Two images"):
        extract([sources[0], sources[0]], night.sensor, DetectionOptions())
    with pytest.raises(RefusedInputError):
        extract([], night.sensor, DetectionOptions())
    with pytest.raises(RefusedInputError, check=has_code("times-missing")):
        extract(sources[:1], night.sensor, DetectionOptions(), times={})


def test_images_without_a_time_keep_their_order_and_say_so(folder, hard_images, tmp_path):
    paths = []
    for image in hard_images[:3]:
        paths.append(tmp_path / f"img-{9 - image.frame}.png")
        Image.fromarray(image.dn).save(paths[-1])
    found = bs.extract(paths, folder / "camera.json", gain_e_per_dn=1.0, processes=1, progress=False)
    assert [image.name for image in found.images] == [path.name for path in paths]
    assert found.telemetry.time_utc is None
    assert any("--times" in sentence for sentence in found.sentences)


@pytest.mark.full
def test_one_command_leads_from_a_hard_night_to_a_calibration(boresight, folder, images, night, tmp_path):  # noqa: F811 - a fixture
    out = tmp_path / "c.json"
    done = boresight("calibrate", *images, "--sensor", folder / "camera.json", "--processes", 1, "--json", out)
    accepted(done)
    found = json.loads(out.read_text())
    assert found["status"] == "converged"
    assert found["frames"] == len(images)
    truth = dict(zip(("s", "f_m", "u0_px", "v0_px", "k1", "k2"), night.truth[:6].tolist(), strict=True))
    e = np.array([found["parameters"][name] - truth[name] for name in FREE])
    nees = e @ np.linalg.solve(np.array(found["covariance"]["matrix"]), e)
    assert nees < stats.chi2.ppf(1 - 1e-5, len(FREE))
    assert found["chi2_per_dof"] < 1.3
    assert found["matching"]["flagged"]["blended"] > 0


@pytest.mark.full
def test_a_night_is_seen_through_the_air_of_the_sensor_s_site_and_without_the_site_its_camera_is_wrong(
    folder, images, night
):
    extracted = bs.extract(images, folder / "camera.json", processes=1, progress=False)
    scores = {}
    for site in (night.sensor.site, None):
        found = bs.calibrate(extracted.telemetry, replace(night.sensor, site=site), progress=False)
        e = np.array([found.parameters[name] for name in FREE]) - night.truth[: len(FREE)]
        scores[site is None] = e @ np.linalg.solve(np.array(found.covariance.matrix), e)
    assert scores[False] < stats.chi2.ppf(1 - 1e-5, len(FREE)) < 0.1 * scores[True]


def test_stars_that_the_catalogue_knows_to_blend_in_these_images_take_no_part_unless_they_are_to(folder, images):
    extracted = bs.extract(images, folder / "camera.json", processes=1, progress=False)
    width = extracted.to_dict()["star_sigma_px"]
    assert (extracted.telemetry.psf_sigma_px == width).all()
    few, all_of_them = (
        bs.match(extracted.telemetry, folder / "camera.json", blends=one, progress=False)
        for one in ("leave-out", "keep")
    )
    gone = (all_of_them.telemetry.star_id > 0) & (few.telemetry.star_id == 0)
    assert 0 < gone.sum() < 0.2 * (all_of_them.telemetry.star_id > 0).sum()
    assert few.to_dict()["unmatched_reasons"][ROW_REASONS[BLENDED]] == gone.sum()
    assert ROW_REASONS[BLENDED] not in all_of_them.to_dict()["unmatched_reasons"]


def test_match_takes_images(boresight, folder, images, tmp_path):  # noqa: F811 - a fixture
    out, pictures = tmp_path / "matched.csv", tmp_path / "pictures"
    words = ("--sensor", folder / "camera.json", "--processes", 1, "--out", out, "--pictures", pictures)
    accepted(boresight("match", *images[:2], *words))
    drawn = ET.parse(pictures / f"{images[0].name}.svg").getroot()  # noqa: S314 - our own file
    named = [one.text for one in drawn.iter("{http://www.w3.org/2000/svg}title")]
    stars = len(list(drawn.iter("{http://www.w3.org/2000/svg}circle")))
    residuals = len(list(drawn.iter("{http://www.w3.org/2000/svg}line")))
    assert 5 < residuals == sum("HIP" in text for text in named) < stars
    assert_refused(boresight("match", out, *words[:2], "--out", tmp_path / "again.csv", "--pictures", pictures))
    read = read_telemetry(out)
    assert set(IMAGE_COLUMNS) <= set(read.unknown)
    assert (read.star_id > 0).sum() > 10


def test_the_command_writes_telemetry_and_refuses_a_mixture(boresight, folder, images, tmp_path):  # noqa: F811 - a fixture
    out = tmp_path / "t.csv"
    sensor = folder / "camera.json"
    accepted(boresight("extract", *images[:1], "--sensor", sensor, "--processes", 1, "--out", out))
    assert len(read_telemetry(out)) > 20
    assert_refused(boresight("extract", *images[:1], "--sensor", sensor, "--out", tmp_path / "t.png"))
    assert_refused(boresight("calibrate", images[0], out, "--sensor", sensor))
    assert_refused(boresight("calibrate", out, out, "--sensor", sensor))


def test_an_image_goes_through_a_pipe_and_its_stars_come_out_of_one(boresight, folder, images, tmp_path):  # noqa: F811 - a fixture
    piped = boresight("extract", "-", "--sensor", folder / "camera.json", "--out", "-", stdin=images[0].read_bytes())
    assert piped.exit_code == 0, piped.stderr
    named = accepted(
        boresight("extract", images[0], "--sensor", folder / "camera.json", "--out", tmp_path / "stars.jsonl")
    )
    assert named
    lines = (tmp_path / "stars.jsonl").read_text().splitlines()
    assert len(piped.stdout.splitlines()) == 1 + len(lines) > 20
    taken = boresight("import", "-", "--profile", "contract", "--out", "-", stdin=piped.stdout.encode())
    assert taken.exit_code == 0, taken.stderr
    assert len(taken.stdout.splitlines()) == 1 + len(lines)


def test_a_header_says_the_gain_and_the_white_level(hard_images, folder, tmp_path):
    path = write_fits(tmp_path / "a.fits", hard_images[0], EGAIN=2.5, SATURATE=3000.0)
    found = bs.extract([path], folder / "camera.json", processes=1, progress=False).to_dict()
    assert (found["gain_e_per_dn"], found["gain_estimated"], found["saturation_dn"]) == (2.5, False, 3000.0)
