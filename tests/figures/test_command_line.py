"""The command that makes a result again must be one that the command line takes, and must say every choice."""

from dataclasses import asdict

import click
import pytest

from boresight.calibration.options import CalibrationSettings
from boresight.cli import main
from boresight.figures.report import calibrate_command

CHANGED = {
    "method": "sqrf", "variant": "q", "free": ["f_m", "m0_px"], "match": "given", "match_parameters": "baseline",
    "match_rule": "flight", "flight_tolerance_urad": 300.0, "leave_out_doubles": True, "minimum_stars": 5,
    "max_iterations": 20, "error": "cosine", "robust": "huber", "huber_threshold": 2.0, "linearisations": 1,
    "process_noise_sigma": 0.5, "forgetting_factor": 0.9, "initial_sigma_scale": 3.0,
    "star_model": 2, "singular_values": [1, 3], "gain_form": "gain",
}  # fmt: skip


def words(settings):
    return calibrate_command("a b.csv", "s.json", settings, None, "r.json")


def test_the_defaults_are_said_in_two_words():
    assert words(CalibrationSettings().document())[2:-1] == ["--method batch", "--match rematch"]


def test_a_name_with_a_blank_is_quoted():
    assert words({})[0] == "boresight calibrate 'a b.csv'"


@pytest.mark.parametrize("name", [*CHANGED])
def test_every_changed_setting_becomes_an_option_that_the_command_reads_back(name):
    command = main.commands["calibrate"]
    line = words({name: CHANGED[name]})[1:]
    with click.Context(command) as context:
        choices = command.parse_args(context, ["t.csv", *" ".join(line).split()])
        read = context.params[name]
    assert choices == []
    listed = isinstance(CHANGED[name], list)
    assert read == (",".join(map(str, CHANGED[name])) if listed else CHANGED[name])


def test_no_setting_that_changes_numbers_is_forgotten():
    assert set(CHANGED) == set(asdict(CalibrationSettings())) - {"replay_frames_per_s"}
