"""A sensor's parameters for another camera model: what is allowed, what is written, and that the product takes it."""

import dataclasses

import numpy as np
import pytest

from boresight.calibration.conversion import ARCSEC_PER_RAD, converted, sensor_file, sensor_under
from boresight.calibration.parameter_file import parse_parameters
from boresight.errors import RefusedInputError
from boresight.simulation.sensors import WU_TRUTH, wu_sensor
from boresight.telemetry.sensors import parse_sensor, sensor_document

SENSOR = wu_sensor()
NAMES = ("s", "f_m", "u0_px", "v0_px", "k1", "k2")
#: A good lens: two pixels of distortion in the corner.
LENS = dict(zip(NAMES, [1.0, 0.016, 970.0, 550.0, -0.05, 0.02], strict=True))
SPREAD = np.array([1e-4, 1e-6, 1.0, 1.0, 1e-3, 1e-2])
MEASURED = {"parameters": LENS, "covariance": {"names": list(NAMES), "matrix": np.diag(SPREAD**2).tolist()}}


def convert(document=LENS, sensor=SENSOR, target="inverted_wang", **options):
    return converted(document, sensor, "lens.json", target, **options)


def test_a_distorted_lens_that_fits_to_ten_thousandths_of_a_pixel_is_converted():
    how = convert()["conversion"]
    assert 1e-6 < how["misfit_px"]["rms"] < how["misfit_px"]["max"] < how["allowed_px"]
    assert how["allowed_px"] == pytest.approx(0.01 * SENSOR.centroid_sigma_px)
    arcsec_of_a_pixel = SENSOR.pixel_pitch_m / LENS["f_m"] * ARCSEC_PER_RAD
    assert how["misfit_arcsec"]["max"] / how["misfit_px"]["max"] == pytest.approx(arcsec_of_a_pixel, rel=0.1)


def test_the_paper_s_strong_distortion_misses_the_rule_and_passes_when_more_is_allowed():
    strong = dict(zip(NAMES, WU_TRUTH.tolist(), strict=True))
    with pytest.raises(RefusedInputError, match=r"up to 0\.0029 px \(0\.11 arcsec\)"):
        convert(strong)
    assert convert(strong, allowed_px=0.005)["conversion"]["misfit_px"]["max"] < 0.005


def test_what_a_mean_of_stars_would_see_is_refused_with_the_rule_the_misfit_and_the_reason():
    sharp = dataclasses.replace(SENSOR, centroid_sigma_px=convert()["conversion"]["misfit_px"]["max"])
    with pytest.raises(
        RefusedInputError, match=r"1 % of the sensor's centroid_sigma_px.* radial polynomial"
    ) as refused:
        convert(sensor=sharp)
    assert "arcsec" in str(refused.value)
    assert convert(sensor=sharp, allowed_px=1.0)["camera_model"] == "inverted_wang"


def test_decentring_is_refused_and_the_sentence_says_what_to_do():
    there = convert()
    sensor = sensor_under(SENSOR, there)
    with pytest.raises(RefusedInputError, match=r"decentring; calibrate the telemetry under pinhole_radial instead"):
        converted(there["parameters"] | {"a1_rad": 0.01}, sensor, "x.json", "pinhole_radial")


def test_the_covariance_is_carried_and_a_document_without_one_gets_none():
    there = convert(MEASURED)
    P = np.array(there["covariance"]["matrix"])
    np.testing.assert_allclose(list(there["sigma"].values()), np.sqrt(np.diag(P)))
    # the focal length is f / s
    assert P[0, 0] == pytest.approx((1e-6) ** 2 + (0.016e-4) ** 2, rel=1e-3)
    assert convert()["covariance"] is None
    assert set(convert()["sigma"].values()) == {None}


def test_a_converted_file_is_read_again_with_the_sensor_file_beside_it_and_goes_back():
    there = convert(MEASURED)
    sensor = parse_sensor(sensor_file(SENSOR, there))
    x, P = parse_parameters(there, sensor, "there.json")
    back = converted(there, sensor, "there.json", "pinhole_radial")
    assert P is not None
    np.testing.assert_array_equal(x, list(there["parameters"].values()))
    np.testing.assert_allclose(list(back["parameters"].values()), list(LENS.values()), rtol=1e-3)
    np.testing.assert_allclose(list(back["sigma"].values()), SPREAD, rtol=0.05)


def test_the_sensor_file_lets_every_parameter_of_the_new_model_move():
    document = sensor_file(SENSOR, convert())
    assert document["camera_model"] == "inverted_wang"
    assert document["free"] == list(document["initial"])
    assert all(value > 0 for value in document["typical_sigma"].values())
    assert {key: document[key] for key in ("name", "detector", "parity")} == {
        key: sensor_document(SENSOR)[key] for key in ("name", "detector", "parity")
    }


@pytest.mark.parametrize(
    ("target", "said"),
    [("fisheye", "There is no camera model 'fisheye': choose"), ("pinhole_radial", "already: choose inverted_wang")],
)
def test_a_model_that_is_none_or_its_own_is_refused(target, said):
    with pytest.raises(RefusedInputError, match=said):
        convert(target=target)


def test_parameters_of_another_model_are_refused():
    with pytest.raises(RefusedInputError, match="of the camera model inverted_wang"):
        convert({"camera_model": "inverted_wang", "parameters": {}})


def test_parameters_that_were_not_estimated_are_named_beside_the_sigmas():
    only_f = {"parameters": LENS, "covariance": {"names": ["f_m"], "matrix": [[1e-12]]}}
    assert convert(only_f)["conversion"]["assumed"] == ["s", "u0_px", "v0_px", "k1", "k2"]
    assert convert(MEASURED)["conversion"]["assumed"] == []
    assert convert()["conversion"]["assumed"] == [], "without a covariance no sigma is told"
