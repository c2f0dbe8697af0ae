"""The choices of `boresight calibrate`: every setting has its option, the help says its words, and they reach the estimator."""

import json

import click
import pytest

from boresight.calibration.options import OPTIONS, CalibrationSettings
from boresight.cli.calibrate import Choice, calibrate

OF_PAGES_ONLY = {"replay_frames_per_s"}  # a pace to watch at


def _run(boresight, folder, *words):
    return boresight("calibrate", folder / "calibration.csv", "--sensor", folder / "sensor.json", "--json", "-", *words)


def test_every_setting_has_an_option():
    options = {option.name for option in calibrate.params if isinstance(option, Choice)}
    assert options == set(CalibrationSettings().document()) - OF_PAGES_ONLY


def test_the_help_names_every_word_and_every_default_by_group(boresight):
    text = boresight("calibrate", "--help").stdout
    flat = " ".join(text.replace("-\n", "-").split())
    assert [line for line in text.splitlines() if line.endswith(":") and line[0] != " "][-6:] == [
        "Files and output:", "Method:", "Matching:", "Of the batch:", "Of the filters:", "Of svd and angular:"
    ]  # fmt: skip
    for name, option in ((name, option) for name, option in OPTIONS.items() if option.kind == "word"):
        listed = f"Choose from {', '.join(option.words)}. [default: {getattr(CalibrationSettings(), name)}]"
        assert listed.replace(" ", "") in flat.replace(" ", "")
    assert "[default: 1.345]" in text


def test_what_is_not_given_keeps_the_default_of_the_settings(boresight, simulated):
    settings = json.loads(_run(boresight, simulated).stdout)["inputs"]["settings"]
    assert settings == CalibrationSettings().document()


@pytest.mark.parametrize(
    ("words", "kept"),
    [
        (("--robust", "huber", "--huber-threshold", "2"), {"robust": "huber", "huber_threshold": 2.0}),
        (("--error", "cosine"), {"error": "cosine"}),
        (
            ("--method", "ukf", "--variant", "q", "--process-noise", "0.1", "--forgetting-factor", "0.99"),
            {"method": "ukf", "process_noise_sigma": 0.1, "forgetting_factor": 0.99},
        ),
        (
            ("--method", "svd", "--star-model", "1", "--singular-values", "3,2,1", "--gain-form", "gain"),
            {"method": "svd", "star_model": 1, "singular_values": [1, 2, 3], "gain_form": "gain"},
        ),
        (("--method", "angular"), {"method": "angular"}),
    ],
)
def test_a_choice_reaches_the_estimator(boresight, simulated, words, kept):
    result = json.loads(_run(boresight, simulated, *words).stdout)
    assert result["status"] == "converged"
    assert kept.items() <= result["inputs"]["settings"].items()


def test_matching_choices_are_read(boresight, simulated):
    words = (
        "--match",
        "given",
        "--match-rule",
        "flight",
        "--flight-tolerance-urad",
        "90",
        "--match-parameters",
        "baseline",
    )
    settings = json.loads(_run(boresight, simulated, *words, "--leave-out-doubles").stdout)["inputs"]["settings"]
    assert (settings["match_rule"], settings["flight_tolerance_urad"]) == ("flight", 90.0)
    assert (settings["match_parameters"], settings["leave_out_doubles"]) == ("baseline", True)


def test_choices_that_exclude_one_another_are_wrong_usage(boresight, simulated):
    done = _run(boresight, simulated, "--method", "sqrf", "--robust", "huber")
    assert done.exit_code == click.UsageError.exit_code
    assert "Robust loss is the batch's" in done.stderr
