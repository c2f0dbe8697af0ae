"""The settings of a calibration, its parameter files and their conversion: what is accepted, and what is refused in which words."""

import dataclasses
import json

import numpy as np
import pytest

from boresight.arrays import ARCSEC_PER_RAD
from boresight.calibration.conversion import converted, sensor_file, sensor_under
from boresight.calibration.options import (
    FILTERS,
    FORM,
    GROUPS,
    METHODS,
    OPTIONS,
    USUAL_DRIFT,
    CalibrationSettings,
    schema,
)
from boresight.calibration.parameter_file import parse_parameters, read_parameters
from boresight.errors import RefusedInputError
from boresight.estimation import filters, singular_values
from boresight.simulation.sensors import WU_TRUTH, wu_sensor
from boresight.telemetry.sensors import parse_sensor, sensor_document
from tests.refusals import has_code

CHOICES = {name: tuple(option.words) for name, option in OPTIONS.items() if option.kind == "word"}
#: A choice that only some methods have is tried with one of them.
METHOD_WITH = {"gain_form": {"method": "angular"}, "process_noise_per": {"method": "sqrf"}}


@pytest.mark.parametrize(("name", "word"), [(name, word) for name, words in CHOICES.items() for word in words])
def test_every_word_of_every_choice_is_accepted_and_kept(name, word):
    assert CalibrationSettings.parse(METHOD_WITH.get(name, {}) | {name: word}).document()[name] == word


@pytest.mark.parametrize("name", CHOICES)
def test_any_other_word_is_refused_with_the_words_there_are(name):
    with pytest.raises(RefusedInputError, match=f"'{name}'.*'other'.* {', '.join(CHOICES[name])}"):
        CalibrationSettings.parse({name: "other"})


@pytest.mark.parametrize(
    "chosen",
    [
        {"method": "ukf", "variant": "no-refit", "match": "rematch", "match_rule": "flight", "forgetting_factor": 0.99}
        | {"flight_tolerance_urad": 120.0, "leave_out_doubles": True},
        {"method": "svd", "star_model": 2, "singular_values": (1, 2), "gain_form": "gain"},
        {"method": "sqrf", "free": ("f_m",), "replay_frames_per_s": 4.0},
    ],
    ids=lambda chosen: chosen["method"],
)
def test_every_setting_survives_its_document(chosen):
    settings = CalibrationSettings(**chosen)
    assert CalibrationSettings.parse(json.loads(json.dumps(settings.document()))) == settings


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ({"method": ["batch"]}, "choose from"),
        ({"metod": "batch"}, "Setting 'metod' is unknown"),
        ({"linearisations": 0}, "give a whole number from 1 to 100"),
        ({"process_noise_sigma": float("nan")}, "give a number from 0 to 10"),
        ({"free": "f_m"}, "is not a list of parameter names"),
        ({"minimum_stars": 3}, "from 4 to 1000"),
        ({"minimum_stars": True}, "from 4 to 1000"),
        ({"method": "svd", "star_model": 5}, "give a whole number from 1 to 4"),
        ({"method": "svd", "singular_values": [0]}, r"give some of 1, 2, 3, as \[2, 3\]"),
        ({"method": "svd", "singular_values": [2, 2]}, "give some of 1, 2, 3"),
        ({"method": "svd", "singular_values": []}, "give some of 1, 2, 3"),
        ({"method": "svd", "singular_values": "23"}, "give some of 1, 2, 3"),
        ({"method": "sqrf", "star_model": 3}, "Star model and singular values are only for method 'svd'"),
        ({"singular_values": [3]}, "Star model and singular values are only for method 'svd'"),
        ({"method": "ekf", "gain_form": "gain"}, "The gain form applies only to methods svd and angular"),
        ({"forgetting_factor": 0.4, "method": "sqrf"}, "give a number from 0.5 to 1"),
        ({"forgetting_factor": float("nan"), "method": "sqrf"}, "give a number from 0.5 to 1"),
        ({"huber_threshold": 0}, "give a number from 0.1 to 10"),
        ({"flight_tolerance_urad": -1}, "give a number from 0.1"),
        ({"leave_out_doubles": "yes"}, "give true or false"),
        ({"method": "sqrf", "robust": "huber"}, "Robust loss works only with method 'batch'"),
        ({"method": "ukf", "error": "cosine"}, "The cosine error works only with method 'batch'"),
        ({"error": "cosine", "robust": "huber"}, "set 'robust' to 'none'"),
        ({"forgetting_factor": 0.9}, "A forgetting factor is only for filters"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(document, sentence):
    with pytest.raises(RefusedInputError, match=sentence):
        CalibrationSettings.parse(document)


def test_no_refit_is_q_with_the_baseline_s_matches_and_methods_and_bounds_are_the_estimators():
    no_refit = CalibrationSettings(method="sqrf", variant="no-refit", match_parameters="latest")
    assert no_refit.matched_with == "baseline"
    assert no_refit.process_noise == USUAL_DRIFT
    assert CalibrationSettings(method="sqrf", variant="q").matched_with == "latest"
    assert CalibrationSettings(method="sqrf").process_noise == 0
    assert list(FILTERS) == list(filters.FILTERS)
    assert set(OPTIONS["star_model"].words) == {str(model) for model in singular_values.STAR_MODELS}
    assert singular_values.Selection(OPTIONS["star_model"].default, OPTIONS["singular_values"].default) == (
        singular_values.CHOSEN
    )


@pytest.mark.parametrize("option", OPTIONS.values(), ids=lambda option: option.name)
def test_an_option_is_declared_whole(option):
    assert option.title and option.sentence.endswith(".")  # noqa: PT018 - one fact
    assert option.group in GROUPS
    assert set(option.methods) <= set(METHODS)
    assert option.kind not in {"whole", "number"} or option.lowest < option.highest
    option.check(option.default)
    assert schema()["properties"][option.name]["description"] == option.sentence


SENSOR = wu_sensor()
NAMES = ("s", "f_m", "u0_px", "v0_px", "k1", "k2")
SOUND = dict(zip(NAMES, WU_TRUTH.tolist(), strict=True))
UNSOUND = {
    "a distortion that folds back before the corner at row -0.5, column -0.5": {"k1": -10.0, "k2": 0.0},
    "the principal point at row 550, column -1990, far outside the detector": {"u0_px": -1990.0},
}


@pytest.fixture
def read(tmp_path):
    def read_written(document):
        (tmp_path / "downlinked.json").write_text(json.dumps(document))
        return read_parameters(tmp_path / "downlinked.json", SENSOR)

    return read_written


@pytest.mark.parametrize(("said", "changed"), UNSOUND.items(), ids=["turn", "principal point"])
def test_what_no_lens_has_is_refused_under_the_name_and_key_of_the_file(read, said, changed):
    for document, subject in (
        ({"parameters": SOUND | changed}, "the set under 'parameters'"),
        (SOUND | changed, "the set of parameters"),
    ):
        with pytest.raises(RefusedInputError) as refused:
            read(document)
        assert str(refused.value).startswith(f"downlinked.json: {subject} ")
        assert said in str(refused.value)
        assert "initial" not in str(refused.value)


def test_a_sound_file_is_read_in_the_camera_s_order(read):
    x, P = read({"parameters": SOUND})
    assert x.tolist() == WU_TRUTH.tolist()
    assert P is None


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


def test_the_paper_s_strong_distortion_misses_the_rule_and_what_a_mean_of_stars_would_see_is_refused_with_the_reason():
    strong = dict(zip(NAMES, WU_TRUTH.tolist(), strict=True))
    with pytest.raises(RefusedInputError, match=r"up to 0\.0029 px \(0\.11 arcsec\)"):
        convert(strong)
    assert convert(strong, allowed_px=0.005)["conversion"]["misfit_px"]["max"] < 0.005
    sharp = dataclasses.replace(SENSOR, centroid_sigma_px=convert()["conversion"]["misfit_px"]["max"])
    with pytest.raises(
        RefusedInputError, match=r"1 %.*radial polynomial", check=has_code("not-expressible")
    ) as refused:
        convert(sensor=sharp)
    assert "arcsec" in str(refused.value)
    assert convert(sensor=sharp, allowed_px=1.0)["camera_model"] == "inverted_wang"


def test_decentring_and_parameters_of_another_model_are_refused():
    there = convert()
    sensor = sensor_under(SENSOR, there)
    with pytest.raises(RefusedInputError, match=r"tilt.*pinhole_radial", check=has_code("not-expressible")):
        converted(there["parameters"] | {"a1_rad": 0.01}, sensor, "x.json", "pinhole_radial")
    with pytest.raises(RefusedInputError, match="inverted_wang", check=has_code("other-camera-model")):
        convert({"camera_model": "inverted_wang", "parameters": {}})


def test_the_covariance_is_carried_and_what_was_not_estimated_is_named_beside_the_sigmas():
    there = convert(MEASURED)
    P = np.array(there["covariance"]["matrix"])
    np.testing.assert_allclose(list(there["sigma"].values()), np.sqrt(np.diag(P)))
    # the focal length is f / s
    assert P[0, 0] == pytest.approx((1e-6) ** 2 + (0.016e-4) ** 2, rel=1e-3)
    assert convert()["covariance"] is None
    assert set(convert()["sigma"].values()) == {None}
    only_f = {"parameters": LENS, "covariance": {"names": ["f_m"], "matrix": [[1e-12]]}}
    assert convert(only_f)["conversion"]["assumed"] == ["s", "u0_px", "v0_px", "k1", "k2"]
    assert convert(MEASURED)["conversion"]["assumed"] == []
    assert convert()["conversion"]["assumed"] == [], "without a covariance no sigma is told"


def test_a_converted_file_is_read_again_with_the_sensor_file_beside_it_which_lets_every_parameter_move():
    there = convert(MEASURED)
    sensor = parse_sensor(sensor_file(SENSOR, there))
    x, P = parse_parameters(there, sensor, "there.json")
    back = converted(there, sensor, "there.json", "pinhole_radial")
    assert P is not None
    np.testing.assert_array_equal(x, list(there["parameters"].values()))
    np.testing.assert_allclose(list(back["parameters"].values()), list(LENS.values()), rtol=1e-3)
    np.testing.assert_allclose(list(back["sigma"].values()), SPREAD, rtol=0.05)
    document = sensor_file(SENSOR, convert())
    assert document["camera_model"] == "inverted_wang"
    assert document["free"] == list(document["initial"])
    assert all(value > 0 for value in document["typical_sigma"].values())
    for key in ("name", "detector", "parity"):
        assert document[key] == sensor_document(SENSOR)[key]


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("fisheye", "There is no camera model 'fisheye': choose"),
        ("pinhole_radial", "already: choose .*inverted_wang or"),
    ],
)
def test_a_model_that_is_none_or_its_own_is_refused(target, said):
    with pytest.raises(RefusedInputError, match=said):
        convert(target=target)


def test_every_choice_stands_once_on_the_form_of_a_launch():
    beside = [
        "method",
        "free",
        "match",
    ]  # buttons with a sentence each, the sensor's own parameters, and the panel of its own
    shown = [
        option.name
        for part in ("usual", "more", "of_one_run")
        for fieldset in FORM[part]
        for row in fieldset.rows
        for option in row
    ]
    assert sorted(shown + beside) == sorted(OPTIONS)


@pytest.mark.parametrize("name", [name for name, one in OPTIONS.items() if one.cell and one.default is None])
def test_a_field_that_is_left_empty_is_the_usual_choice(name):
    assert OPTIONS[name].read(" ") is None
    OPTIONS[name].check(OPTIONS[name].read(""))
