"""The settings of a calibration: what is accepted, what is refused and in which words."""

import json

import pytest

from boresight.calibration.options import FILTERS, GROUPS, METHODS, OPTIONS, CalibrationSettings, schema
from boresight.errors import RefusedInputError
from boresight.estimation import filters, singular_values

CHOICES = {name: tuple(option.words) for name, option in OPTIONS.items() if option.kind == "word"}
#: A choice that only some methods have is tried with one of them.
METHOD_WITH = {"gain_form": {"method": "angular"}}


@pytest.mark.parametrize(("name", "word"), [(name, word) for name, words in CHOICES.items() for word in words])
def test_every_word_of_every_choice_is_accepted_and_kept(name, word):
    assert CalibrationSettings.parse(METHOD_WITH.get(name, {}) | {name: word}).document()[name] == word


@pytest.mark.parametrize("name", CHOICES)
def test_any_other_word_is_refused_with_the_words_there_are(name):
    with pytest.raises(RefusedInputError, match=f"Setting '{name}' is 'other'; choose from {', '.join(CHOICES[name])}"):
        CalibrationSettings.parse({name: "other"})


def test_every_setting_survives_its_document():
    chosen = CalibrationSettings(
        method="ukf", variant="no-refit", match="rematch", match_rule="flight", flight_tolerance_urad=120.0,
        leave_out_doubles=True, forgetting_factor=0.99,
    )  # fmt: skip
    assert CalibrationSettings.parse(json.loads(json.dumps(chosen.document()))) == chosen
    reference = CalibrationSettings(method="svd", star_model=2, singular_values=(1, 2), gain_form="gain")
    assert CalibrationSettings.parse(json.loads(json.dumps(reference.document()))) == reference


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ({"method": ["batch"]}, "choose from"),
        ({"method": "svd", "star_model": 5}, "give a whole number from 1 to 4"),
        ({"method": "svd", "singular_values": [0]}, r"give some of 1, 2, 3, as \[2, 3\]"),
        ({"method": "svd", "singular_values": [2, 2]}, "give some of 1, 2, 3"),
        ({"method": "svd", "singular_values": []}, "give some of 1, 2, 3"),
        ({"method": "svd", "singular_values": "23"}, "give some of 1, 2, 3"),
        ({"method": "sqrf", "star_model": 3}, "Star model and singular values are of method 'svd'"),
        ({"singular_values": [3]}, "Star model and singular values are of method 'svd'"),
        ({"method": "ekf", "gain_form": "gain"}, "The gain form is of methods svd and angular"),
        ({"forgetting_factor": 0.4, "method": "sqrf"}, "give a number from 0.5 to 1"),
        ({"forgetting_factor": float("nan"), "method": "sqrf"}, "give a number from 0.5 to 1"),
        ({"huber_threshold": 0}, "give a number from 0.1 to 10"),
        ({"flight_tolerance_urad": -1}, "give a number from 0.1"),
        ({"leave_out_doubles": "yes"}, "give true or false"),
        ({"method": "sqrf", "robust": "huber"}, "Robust loss is the batch's"),
        ({"method": "ukf", "error": "cosine"}, "The cosine error is the batch's"),
        ({"error": "cosine", "robust": "huber"}, "set 'robust' to 'none'"),
        ({"forgetting_factor": 0.9}, "A forgetting factor is a filter's"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(document, sentence):
    with pytest.raises(RefusedInputError, match=sentence):
        CalibrationSettings.parse(document)


def test_no_refit_is_q_with_the_matches_of_the_baseline():
    no_refit = CalibrationSettings(method="sqrf", variant="no-refit", match_parameters="latest")
    assert no_refit.matched_with == "baseline"
    assert no_refit.process_noise == no_refit.process_noise_sigma > 0
    assert CalibrationSettings(method="sqrf", variant="q").matched_with == "latest"
    assert CalibrationSettings(method="sqrf").process_noise == 0


def test_methods_and_bounds_are_those_of_the_estimators():
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
