"""`boresight calibrate`: a telemetry file and a sensor file in, a calibration out; here, or on a server."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from boresight.calibration.options import GROUPS, OPTIONS, CalibrationSettings, Option
from boresight.cli.extract import extraction_options, open_sources, take_extraction_choices
from boresight.cli.importing import profile_option
from boresight.cli.input import INPUT_FILE
from boresight.cli.output import check_writable, json_option, write_json
from boresight.cli.remote import first_message, open_client, server_option
from boresight.cli.sensor import place_sensor, refuse_site_on_server, site_option
from boresight.errors import RefusedInputError
from boresight.library.functions import calibrate as estimate
from boresight.library.functions import parse_choices
from boresight.library.progress import progress
from boresight.library.text import summary_lines

OTHERS = "Files and output"
_TYPES = {"whole": int, "number": float}
_METAVARS = {"names": "NAMES", "numbers": "NAME=NUMBER", "times": "TIMES", "wholes": "NUMBERS", "stars": "NUMBERS"}


class SettingOption(click.Option):
    """An option for a setting; if absent, the setting keeps its default."""

    def __init__(self, words: list[str], *, of: Option, **settings: Any) -> None:
        super().__init__(words, **settings)
        self.group, self.of = of.group, of

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete a word by the choices that the setting is declared with."""
        if self.of.kind != "word":
            return super().shell_complete(ctx, incomplete)
        return [CompletionItem(word) for word in self.of.words if word.startswith(incomplete)]


class GroupedCommand(click.Command):
    """A command whose help shows its options by group."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write a section a group, in the order of the options."""
        groups: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for option in self.get_params(ctx):
            if isinstance(option, click.Option) and (record := option.get_help_record(ctx)) is not None:
                groups[option.group if isinstance(option, SettingOption) else OTHERS].append(record)
        for group in (OTHERS, *GROUPS):
            with formatter.section(group):
                formatter.write_dl(groups[group])


def _help(option: Option) -> str:
    """Return an option's help: its sentence, its choices and its default."""
    words = f" Choose from {option.range}." if option.kind == "word" else ""
    default = "" if option.default in (None, False) else f"  [default: {_format_default(option.default)}]"
    return f"{option.sentence}{words}{default}"


def _format_default(default: Any) -> str:
    return ",".join(map(str, default)) if isinstance(default, tuple) else str(default)


def setting_option(name: str) -> Callable[..., Any]:
    """Add the option of one calibration setting to a command."""
    option = OPTIONS[name]
    ticked = {"is_flag": True, "default": None} if option.kind == "yes or no" else {}
    return click.option(
        str(option.flag), option.name, cls=SettingOption, of=option, help=_help(option), type=_TYPES.get(option.kind),
        metavar=_METAVARS.get(option.kind), **ticked,
    )  # fmt: skip


def calibration_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of every calibration setting to a command."""
    for option in reversed(OPTIONS.values()):
        if option.flag is not None:
            command = setting_option(option.name)(command)
    return command


def chosen(choices: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that were given; the others keep their defaults."""
    return {name: value for name, value in choices.items() if value is not None}


#: Statuses of a failed calibration.
FAILED = ("diverged", "too_few_stars")


@click.command(cls=GroupedCommand)
@click.argument("telemetry", type=INPUT_FILE, nargs=-1, required=True)
@click.option("--sensor", "sensor_file", type=INPUT_FILE, required=True, help="Sensor file, JSON.")
@site_option
@calibration_options
@click.option("--validate", type=INPUT_FILE, help="Held-out telemetry for checking the result.")
@click.option(
    "--prior",
    metavar="FILE",
    help="Calibration JSON of this sensor to start from, with its covariance; on a server a set's name or a run's number.",
)
@extraction_options
@profile_option
@server_option
@json_option
def calibrate(
    telemetry: tuple[Path, ...],
    sensor_file: Path,
    site: str | None,
    validate: Path | None,
    prior: str | None,
    profile: str | None,
    server_url: str | None,
    json_file: str | None,
    **choices: Any,
) -> None:
    """Calibrate a sensor from TELEMETRY (CSV, JSON Lines or Parquet), or from images (FITS, PNG, TIFF or raw numbers).

    Several telemetry sets of one sensor are calibrated jointly, in one fit of all their stars.

    Prints the parameters with their sigmas, the quality of the fit, and advice. If nothing could be estimated from a set,
    or the fit diverged, the JSON is still written and the exit code is 1.

    With --server the files are uploaded, the calibration is a run there, and its JSON is returned; --sensor may be the name
    of a sensor of that server.
    """
    check_writable(json_file)
    refuse_site_on_server(site, server_url)
    extraction = take_extraction_choices(choices)
    settings = chosen(choices)
    parse_settings(settings)
    if profile is not None and server_url is not None:
        raise RefusedInputError("--server does not read mapping profiles: import the file first.")
    if prior is not None and server_url is not None and Path(prior).is_file():
        raise RefusedInputError(
            "A server starts from its own results: give a parameter set's name or a run's number as --prior."
        )
    former = None if prior is None or server_url is not None else INPUT_FILE.convert(prior, None, None)
    with (
        progress(first_message(server_url)) as report,
        open_sources(telemetry, profile, sensor_file, extraction, report) as sources,
    ):
        if server_url is None:
            sensor = place_sensor(sensor_file, site)
            found = estimate(sources, sensor, validate=validate, prior=former, progress=report, **settings)
        else:
            with open_client(server_url) as server:
                found = server.calibrate(
                    sources, str(sensor_file), validate=validate, prior=prior, progress=report, **settings
                )
    write_json(found.to_dict(), json_file)
    if json_file != "-" and found.status != "too_few_stars":
        click.echo("\n".join(summary_lines(found)))
    if found.status in FAILED:
        raise RefusedInputError(found.advice[0])


def parse_settings(document: dict[str, Any]) -> CalibrationSettings:
    """Parse the settings; an invalid one is wrong usage."""
    try:
        return parse_choices(document)
    except RefusedInputError as error:
        raise click.UsageError(str(error)) from error
