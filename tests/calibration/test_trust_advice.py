"""Which trust numbers are worth a sentence, and which of them comes first."""

from dataclasses import replace

import pytest

from boresight.calibration.trust import trust_advice
from boresight.simulation.sensors import st16_sensor, st16_truth
from tests.calibration.judged import case, field, simulated

QUANTITIES = ("radius", "magnitude", "temperature", "time")


@pytest.fixture(scope="module")
def clean(catalogue):
    return simulated(catalogue, seed=4).trust


def _spoiled(trust, **parts):
    return {
        **trust,
        **{name: {**trust[name], **keys} if isinstance(keys, dict) else keys for name, keys in parts.items()},
    }


def test_a_clean_set_calls_for_nothing(clean):
    assert trust_advice(clean) == []


def test_graver_sentences_come_first(clean):
    spoiled = _spoiled(
        clean,
        two_halves={"chi2": {**clean["two_halves"]["chi2"], "p": 1e-6}, "sentence": "halves"},
        efficiency={"overall_ratio": 0.8, "sentence": "bound"},
        whiteness={"white": False, "sentence": "drift"},
        nis_over_time={"consistent": False, "sentence": "innovations"},
        suspects=[4711],
        stars_sentence="stars",
        residual_against={name: {"even": name in {"radius", "time"}, "sentence": name} for name in QUANTITIES},
        drop_one=[{"needed": False}, {"needed": False}, {"needed": True}],
        drop_one_sentence="spare",
    )  # fmt: skip
    assert trust_advice(spoiled) == [
        "halves", "bound", "drift", "temperature", "innovations", "stars", "magnitude", "spare",
    ]  # fmt: skip


def test_a_single_spare_parameter_is_not_worth_a_sentence(clean):
    assert trust_advice(_spoiled(clean, drop_one=[{"needed": False}, {"needed": True}])) == []


def test_a_start_that_is_the_truth_is_said_to_leave_little_to_estimate(catalogue):
    sensor = replace(st16_sensor(1), initial=st16_truth(1))
    advice = trust_advice(case(simulated(catalogue, frames=40).telemetry, sensor, catalogue).trust)
    assert advice[-1].startswith("These data do not ask for")
    assert advice[-1].endswith("It may be held fixed, one parameter at a time.")


def test_every_sentence_ends_and_names_no_code(sensor, catalogue):
    trust = case(field(1), sensor, catalogue).trust
    parts = [part["sentence"] for part in trust.values() if isinstance(part, dict) and "sentence" in part]
    bins = [part["sentence"] for part in trust["residual_against"].values() if part is not None]
    for sentence in [
        *parts,
        *bins,
        trust["drop_one_sentence"],
        trust["stars_sentence"],
        *trust["unavailable"].values(),
    ]:
        assert sentence.endswith(".")
        assert "_" not in sentence.replace("g_y", "")
        assert "nan" not in sentence
        assert "None" not in sentence.replace("None of", "")
