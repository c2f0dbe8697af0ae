"""`boresight calibrate`: a telemetry file and a sensor file in, a calibration out; no server, no store."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click

from boresight.calibration.options import GROUPS, OPTIONS, CalibrationSettings, Option
from boresight.cli.output import aligned, check_writable, json_option, progress, write_json
from boresight.errors import RefusedInputError
from boresight.estimation.blocks import computing_on
from boresight.settings import read_settings, use_kernel_folder

OTHERS = "Files and output"
_TYPES = {"whole": int, "number": float}
_METAVARS = {"names": "NAMES", "wholes": "NUMBERS"}


class Choice(click.Option):
    """An option that is a setting's; absent, it leaves that setting alone."""

    def __init__(self, words: list[str], *, of: Option, **settings: Any) -> None:
        super().__init__(words, **settings)
        self.group = of.group


class GroupedCommand(click.Command):
    """A command whose help shows its options by group."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write a section a group, in the order of the options."""
        groups: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for option in self.get_params(ctx):
            if isinstance(option, click.Option) and (record := option.get_help_record(ctx)) is not None:
                groups[option.group if isinstance(option, Choice) else OTHERS].append(record)
        for group in (OTHERS, *GROUPS):
            with formatter.section(group):
                formatter.write_dl(groups[group])


def _help(option: Option) -> str:
    """The sentence, the words there are, and what holds without it."""
    words = f" Choose from {option.range}." if option.kind == "word" else ""
    default = "" if option.default in (None, False) else f"  [default: {_shown(option.default)}]"
    return f"{option.sentence}{words}{default}"


def _shown(default: Any) -> str:
    return ",".join(map(str, default)) if isinstance(default, tuple) else str(default)


def setting_option(name: str) -> Callable[..., Any]:
    """Give a command one choice of a calibration."""
    option = OPTIONS[name]
    ticked = {"is_flag": True, "default": None} if option.kind == "yes or no" else {}
    return click.option(
        str(option.flag), option.name, cls=Choice, of=option, help=_help(option), type=_TYPES.get(option.kind),
        metavar=_METAVARS.get(option.kind), **ticked,
    )  # fmt: skip


def calibration_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command every choice of a calibration."""
    for option in reversed(OPTIONS.values()):
        if option.flag is not None:
            command = setting_option(option.name)(command)
    return command


def chosen(choices: dict[str, Any]) -> dict[str, Any]:
    """Return the settings document of what was given; the rest keeps its default."""
    document = {name: value for name, value in choices.items() if value is not None}
    if "free" in document:
        document["free"] = [name.strip() for name in document["free"].split(",") if name.strip()]
    if "singular_values" in document:
        texts = [text.strip() for text in document["singular_values"].split(",")]
        document["singular_values"] = [int(text) if text.isdecimal() else text for text in texts]
    return document


#: Statuses under which the numbers are no calibration.
FAILED = ("diverged", "too_few_stars")


@click.command(cls=GroupedCommand)
@click.argument("telemetry", type=click.Path(path_type=Path))
@click.option("--sensor", "sensor_file", type=click.Path(path_type=Path), required=True, help="Sensor file, JSON.")
@calibration_options
@click.option(
    "--validate", type=click.Path(path_type=Path), help="Telemetry that takes no part, to check the result by."
)
@json_option
def calibrate(telemetry: Path, sensor_file: Path, validate: Path | None, json_file: str | None, **choices: Any) -> None:
    """Calibrate a sensor from TELEMETRY (CSV, JSON Lines or Parquet).

    Prints the parameters with their sigmas, what the fit is worth, and advice. A set from which nothing could be
    estimated, or a fit that diverged, writes its JSON and ends with exit code 1.
    """
    check_writable(json_file)
    use_kernel_folder(read_settings())
    settings = parse_settings(chosen(choices))
    with progress("reading the telemetry") as report, computing_on(read_settings().computing_threads):
        result = _calibrate(telemetry, sensor_file, validate, settings, report)
    write_json(result, json_file)
    if json_file != "-" and result["status"] != "too_few_stars":
        click.echo("\n".join(_lines(result)))
    if result["status"] in FAILED:
        raise RefusedInputError(result["advice"][0])


def parse_settings(document: dict[str, Any]) -> CalibrationSettings:
    """Read the choices; one that does not exist is wrong usage."""
    try:
        return CalibrationSettings.parse(document)
    except RefusedInputError as error:
        raise click.UsageError(str(error)) from error


def _calibrate(telemetry: Path, sensor_file: Path, validate: Path | None, settings: Any, report: Any) -> dict[str, Any]:
    from boresight.calibration import calibrate as estimator
    from boresight.calibration.telemetry_pieces import TelemetryFile
    from boresight.sky.catalogue import load_catalogue
    from boresight.telemetry.sensors import read_sensor

    sensor = read_sensor(sensor_file)
    limits = read_settings().telemetry_limits
    stars = TelemetryFile(telemetry, limits=limits).opened()
    validation = None if validate is None else TelemetryFile(validate, limits=limits).opened()
    report("loading the star catalogue")
    catalogue = load_catalogue(read_settings().catalogue_folder)
    report("building arcs and loading the compiled loops")
    files = {"telemetry": telemetry, "sensor": sensor_file} | ({"validation": validate} if validate else {})
    found = estimator.calibrate(
        stars,
        sensor,
        catalogue,
        settings,
        validation=validation,
        sha256s={role: _sha256(path) for role, path in files.items()},
        report=lambda step: report(step.message, step.fraction),
        cache_folder=read_settings().catalogue_folder,
    )
    return found.to_dict()


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _lines(result: dict[str, Any]) -> Iterator[str]:
    from boresight.figures.tables import HEADINGS, printed_rows

    words = [result["method"], result["variant"], result["status"].replace("_", " ")]
    left_out = "; ".join(f"{item['count']:,} {item['what']}: {item['reason']}" for item in result["left_out"])
    counts = ", ".join(f"{result[key]:,} {key}" for key in ("frames", "exposures", "stars", "pairs"))
    yield f"{result['sensor']}: {', '.join(word for word in words if word)}; {counts}"
    if left_out:
        yield f"left out: {left_out}"
    yield ""
    yield aligned([HEADINGS, *(row.cells for row in printed_rows(result))], left=(0, 1, 6))
    yield ""
    yield aligned(list(_scores(result)), left=(0, 1))
    for sentence in result["advice"]:
        yield f"\n- {sentence}"


def _scores(result: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "RMS arc error", _pair(result["rms_arc_rad"])
    if (fit := result["chi2"]) is not None:
        yield "chi2 per degree of freedom", _test(result["chi2_per_dof"], fit)
    if (nis := result["nis"]) is not None and result["method"] != "batch":
        yield "innovations (NIS)", _test(nis["mean"], nis)
    if (seen := result["observability"]) is not None:
        number = seen["condition_number"]
        yield "condition number", "infinite" if number is None else f"{number:,.4g}"
        yield "weakest direction", seen["weakest"]["sentence"]
    if (matching := result["matching"]) is not None:
        yield "matches", _matches(matching)
    for name, scores in (("calibration set", result["evaluation"]), ("validation set", result["validation"])):
        if scores is not None:
            yield f"{name}, availability", _share(scores)
            yield f"{name}, RMS", _pair(scores["rms_arc_rad"])
    if (alignment := result["alignment"]) is not None:
        yield "C_SD", alignment["sentence"]


def _matches(matching: dict[str, Any]) -> str:
    """Count what matching again did, and say whether it rests."""
    counts = ", ".join(f"{matching[key]:,} {key}" for key in ("given", "kept", "removed", "added"))
    cycles = len(matching["cycles"])
    rest = "the matches rest" if matching["rested"] else "the matches do not rest yet"
    return f"{counts}; {rest}" + (f" after {cycles} {'cycle' if cycles == 1 else 'cycles'}" if cycles else "")


def _share(scores: dict[str, Any]) -> str:
    """Availability before and after with its interval, by the flight code's tolerance."""
    sides = []
    for side in ("initial", "final"):
        low, high = scores["intervals"]["availability"][side] or (None, None)
        interval = "" if low is None or high is None else f" ({low:.1%} to {high:.1%})"
        sides.append(f"{scores['availability'][side]:.1%}{interval}")
    return f"{' -> '.join(sides)} of {scores['frames']:,} frames, arcs within {scores['flight_tolerance_rad'] * 1e6:.0f} µrad"


def _pair(rms: dict[str, float | None]) -> str:
    before, after = ("-" if value is None else f"{value * 1e6:.2f}" for value in (rms["initial"], rms["final"]))
    return f"{before} -> {after} µrad"


def _test(value: float, test: dict[str, Any]) -> str:
    word = "consistent" if test["consistent"] else "NOT consistent"
    return f"{value:.4g}, 95 % bounds {test['lower']:.4g} to {test['upper']:.4g}: {word}"
