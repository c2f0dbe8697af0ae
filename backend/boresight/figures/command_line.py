"""The command that makes a result again: `boresight calibrate` with every choice that is not the default."""

from __future__ import annotations

from collections.abc import Mapping
from shlex import quote
from typing import Any

from boresight.calibration.options import CalibrationSettings

#: Settings whose option has another name than theirs.
OPTIONS = {"process_noise_sigma": "--process-noise"}
#: Said even where it is the default, because it names the calibration.
ALWAYS = ("method", "match")
#: A pace to watch by; it changes no number.
NEVER = ("replay_frames_per_s",)


def calibrate_command(
    telemetry: str, sensor: str, settings: Mapping[str, Any], validation: str | None, json_file: str
) -> list[str]:
    """Return the words of the command, an option with its value as one.

    Parameters
    ----------
    telemetry, sensor, validation, json_file
        File names.
    settings
        As in `inputs.settings` of a calibration JSON.
    """
    words = [f"boresight calibrate {quote(telemetry)}", f"--sensor {quote(sensor)}", *_choices(settings)]
    if validation:
        words.append(f"--validate {quote(validation)}")
    return [*words, f"--json {quote(json_file)}"]


def _choices(settings: Mapping[str, Any]) -> list[str]:
    """Return the options of the settings."""
    defaults = CalibrationSettings().document()
    words = []
    for name, default in defaults.items():
        value = settings.get(name, default)
        if name in NEVER or value is None or (value == default and name not in ALWAYS):
            continue
        option = OPTIONS.get(name, "--" + name.replace("_", "-"))
        text = (
            ",".join(map(str, value))
            if isinstance(value, list)
            else f"{value:g}"
            if isinstance(value, float)
            else str(value)
        )
        words.append(option if value is True else f"{option} {quote(text)}")
    return words
