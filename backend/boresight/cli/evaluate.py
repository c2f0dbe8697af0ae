"""`boresight check`, `match`, `evaluate`, `assess` and `submit`: quality and matches of telemetry, and how good parameters are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from boresight.cli.calibrate import chosen, parse_settings, setting_option
from boresight.cli.extract import extraction_options, open_source, pictures_option, take_extraction_choices
from boresight.cli.importing import profile_option, read_by_profile
from boresight.cli.input import INPUT_FILE
from boresight.cli.output import (
    FORMATS,
    STANDARD_OUTPUT,
    check_one_stream,
    check_writable,
    json_option,
    opened_for_writing,
    tell,
    write_json,
)
from boresight.cli.remote import find_set, open_client, required_server_option, server_option
from boresight.cli.sensor import place_sensor, site_option
from boresight.errors import RefusedInputError
from boresight.images.limits import is_image
from boresight.library import functions as library
from boresight.library.progress import progress
from boresight.library.text import aligned
from boresight.settings import read_settings

if TYPE_CHECKING:
    from boresight.library.results import Assessment, Matches


@click.command()
@click.argument("telemetry", type=INPUT_FILE, nargs=-1, required=True)
@click.option("--sensor", "sensor_file", type=INPUT_FILE, required=True, help="Sensor file, JSON.")
@site_option
@click.option(
    "--parameters",
    type=INPUT_FILE,
    help="Parameters to match with: calibration JSON, or a JSON object of names and values.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="File to write: .csv, .jsonl or .parquet; - is standard output, CSV.",
)
@setting_option("leave_out_doubles")
@setting_option("blends")
@click.option("--flight", is_flag=True, help="Keep only what the simulated check of the flight code accepts.")
@extraction_options
@profile_option
@pictures_option
@json_option
def match(
    telemetry: tuple[Path, ...],
    sensor_file: Path,
    site: str | None,
    parameters: Path | None,
    out: Path,
    profile: str | None,
    **choices: Any,
) -> None:
    """Match the stars of TELEMETRY, or of images, again and write its rows with `star_id` as found (empty = unmatched).

    Every other column stays as it is. With --json every exposure is listed with its attitude and covariance, or the reason
    why it has none.
    """
    check_writable(choices["json_file"])
    check_one_stream(out, choices["json_file"])
    for path in telemetry:
        _check_out(path, out)
    extraction = take_extraction_choices(choices)
    with (
        progress("reading the telemetry") as report,
        open_source(telemetry, profile, sensor_file, extraction, report) as source,
    ):
        found = library.match(
            source,
            place_sensor(sensor_file, site),
            parameters=parameters,
            leave_out_doubles=bool(choices["leave_out_doubles"]),
            **chosen({"blends": choices["blends"]}),
            flight=choices["flight"],
            progress=report,
        )
        _write_rows(source, found.telemetry.star_id, out)
        if choices["pictures"] is not None:
            _draw(telemetry, sensor_file, found, parameters, choices["pictures"], extraction["raw"])
    document = found.to_dict()
    write_json(document, choices["json_file"])
    if choices["json_file"] != STANDARD_OUTPUT:
        tell("\n".join(_match_lines(document)), out)


def _draw(
    images: tuple[Path, ...], sensor: Path, found: Matches, parameters: Path | None, folder: Path, raw: Any
) -> None:
    """Draw the images with their stars, matches and residuals; refuses a telemetry file, which has none."""
    if not is_image(images[0]):
        raise RefusedInputError(f"{images[0].name} is telemetry, which cannot be drawn as an image: omit --pictures.")
    library.draw_images(images, sensor, found, folder, parameters=parameters, raw=raw)


def _check_out(telemetry: Path, out: Path) -> None:
    """Refuse an output that cannot be written, is the input itself, or has no known suffix."""
    if str(out) == STANDARD_OUTPUT:
        return
    check_writable(out, FORMATS.get(out.suffix.lower(), ""))
    if out.suffix.lower() not in {".csv", ".jsonl", ".ndjson", ".parquet"}:
        raise RefusedInputError(f"{out.name} has no known format: end the name with .csv, .jsonl or .parquet.")
    if out.exists() and telemetry.exists() and out.samefile(telemetry):
        raise RefusedInputError(
            f"{out} is an input file and will not be overwritten: choose another name.", code="would-overwrite"
        )


def _write_rows(telemetry: Any, star_id: Any, out: Path) -> None:
    """Write the rows of a telemetry file again, every other column as it stands; or those that were imported."""
    from boresight.telemetry.read.tables import read_table
    from boresight.telemetry.writing import contract_table, write_with_stars

    if isinstance(telemetry, Path):
        table = read_table(telemetry, telemetry.name, read_settings().telemetry_limits)
    else:
        table = contract_table(telemetry.telemetry)
    with opened_for_writing(out) as stream:
        write_with_stars(table, star_id, stream, out.suffix.lower())


def _match_lines(document: dict[str, Any]) -> Iterator[str]:
    keys = ("given", "kept", "changed", "added", "removed", "matched")
    yield f"{document['sensor']}: {document['rows']:,} detections"
    if document["flight_tolerance_rad"] is not None:
        yield f"accepted: arcs that agree within {document['flight_tolerance_rad'] * 1e6:.0f} µrad (simulated flight tolerance)"
    yield ""
    yield aligned([keys, [f"{document[key]:,}" for key in keys]], left=())
    yield ""
    yield f"frames valid: {document['valid_frames']:,} of {document['frames']:,}"
    for sentence in document["advice"]:
        yield f"\n- {sentence}"
    for title, key in (
        ("frames not valid", "frame_reasons"),
        ("given stars removed", "removed_reasons"),
        ("detections without a star", "unmatched_reasons"),
        ("exposures by source of their attitude", "starts"),
    ):
        if document[key]:
            yield f"\n{title}:"
            yield aligned([(f"  {count:,}", phrase) for phrase, count in document[key].items()], left=(1,))


@click.command()
@click.argument("telemetry", type=INPUT_FILE)
@click.option("--sensor", "sensor_file", type=INPUT_FILE, required=True, help="Sensor file, JSON.")
@profile_option
@json_option
def check(telemetry: Path, sensor_file: Path, profile: str | None, json_file: str | None) -> None:
    """Report on the quality of TELEMETRY: counts, gaps, coverage, magnitudes, matches."""
    check_writable(json_file)
    with progress("reading the telemetry") as report:
        quality = library.check(
            read_by_profile(telemetry, profile, sensor_file), sensor_file, progress=report
        ).to_dict()
    write_json(quality, json_file)
    if json_file != "-":
        for finding in quality["findings"]:
            click.echo(f"{finding['severity']}: {finding['sentence']}\n")
        click.echo(aligned(list(_rows({key: quality[key] for key in FACTS if key in quality})), left=(0, 1)))


#: What `check` prints of a quality report beside its findings; `--json` has all of it.
FACTS = (
    "verdict",
    "frames",
    "exposures",
    "stars",
    "matched",
    "usable",
    "usable_frames",
    "off_detector",
    "magnitudes",
    "time",
)


def _rows(document: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the report as rows of name and value, without its long tables of numbers."""
    for key, value in document.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _rows(value, f"{name}.")
        elif isinstance(value, list) and value and isinstance(value[0], str):
            yield from ((name if i == 0 else "", line) for i, line in enumerate(value))
        elif not isinstance(value, list):
            yield name, _text(value)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,.6g}" if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else str(value)


FRAMES_SHOWN = 40


@click.command()
@click.argument("telemetry", type=INPUT_FILE)
@click.option("--sensor", "sensor_file", type=INPUT_FILE, required=True, help="Sensor file, JSON.")
@site_option
@click.option(
    "--parameters",
    type=INPUT_FILE,
    required=True,
    help="Calibration JSON, or a JSON object of parameter names and values.",
)
@click.option("--against", type=INPUT_FILE, help="Parameters to compare with; the sensor file's if omitted.")
@setting_option("match")
@setting_option("flight_tolerance_urad")
@click.option("--shadow", is_flag=True, help="List the frames that one of the two parameter sets would lose.")
@json_option
def evaluate(
    telemetry: Path, sensor_file: Path, site: str | None, json_file: str | None, *, shadow: bool, **choices: Any
) -> None:
    """Compare two parameter sets on TELEMETRY: availability, matched stars, RMS on common pairs.

    The check of the flight code is simulated: an exposure is valid when at least four matches, and more than two thirds of
    its matches, agree with the catalogue in all their arcs.
    """
    check_writable(json_file)
    with progress("reading the telemetry") as report:
        document = library.evaluate(
            telemetry,
            place_sensor(sensor_file, site),
            choices["parameters"],
            against=choices["against"],
            shadow=shadow,
            progress=report,
            **_parsed({key: choices[key] for key in ("match", "flight_tolerance_urad")}),
        ).to_dict()
    write_json(document, json_file)
    if json_file != "-":
        click.echo("\n".join(_lines(document)))


def _parsed(choices: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that were given; an invalid one is wrong usage."""
    given = chosen(choices)
    parse_settings(given)
    return given


def _lines(document: dict[str, Any]) -> Iterator[str]:
    tolerance = document["flight_tolerance_rad"] * 1e6
    yield f"{document['sensor']}: {document['frames']:,} frames, {document['common_pairs']:,} common pairs"
    yield f"accepted: arcs that agree within {tolerance:.0f} µrad (simulated flight tolerance)"
    yield ""
    yield aligned([("", "initial", "95 %", "final", "95 %"), *_scores(document)])
    if phrases := list(dict.fromkeys([*document["reasons"]["initial"], *document["reasons"]["final"]])):
        counts = [
            [str(document["reasons"][side].get(phrase, 0)) for side in ("initial", "final")] for phrase in phrases
        ]
        yield ""
        yield aligned(
            [("frames not available", "initial", "final"), *((p, *c) for p, c in zip(phrases, counts, strict=True))]
        )
    for sentence in document["advice"]:
        yield f"\n- {sentence}"
    if "shadow" in document:
        yield from _shadow_lines(document["shadow"])


def _scores(document: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    """Return the table of scores with their intervals."""
    intervals, stars = document["intervals"], document["matched_stars"]
    for name, key, scale, digits in (
        ("availability", "availability", 1, 3),
        ("RMS arc error, µrad", "rms_arc_rad", 1e6, 2),
    ):
        sides = [
            (_number(document[key][side], scale, digits), _interval(intervals[key][side], scale, digits))
            for side in ("initial", "final")
        ]
        yield (name, *sides[0], *sides[1])
    yield "matched stars", f"{stars['initial']:,}", "", f"{stars['final']:,}", ""
    ratio = document["matched_star_ratio"]
    yield "matched star ratio", "", "", _number(ratio, 1, 3), _interval(intervals["matched_star_ratio"], 1, 3)
    yield "RMS ratio", "", "", _number(document["rms_ratio"], 1, 3), _interval(intervals["rms_ratio"], 1, 3)


def _number(value: float | None, scale: float, digits: int) -> str:
    return "-" if value is None else f"{value * scale:.{digits}f}"


def _interval(ends: list[float | None], scale: float, digits: int) -> str:
    return " to ".join(_number(end, scale, digits) for end in ends)


def _shadow_lines(shadow: dict[str, Any]) -> Iterator[str]:
    """Return the lines on the frames that one of the two would lose, and a summary."""
    differing = [frame for frame in shadow["frames"] if frame["baseline"]["valid"] != frame["candidate"]["valid"]]
    if differing:
        yield ""
        rows = [
            (
                str(frame["frame"]),
                (frame["time_utc"] or "")[:19],
                loser,
                str(frame[winner]["matched"]),
                frame[loser]["reason"],
            )
            for frame in differing[:FRAMES_SHOWN]
            for loser, winner in (
                ("candidate", "baseline") if frame["baseline"]["valid"] else ("baseline", "candidate"),
            )
        ]
        yield aligned([("frame", "time", "lost by", "stars", "reason"), *rows], left=(1, 2, 4))
    if len(differing) > FRAMES_SHOWN:
        yield f"and {len(differing) - FRAMES_SHOWN:,} more; use --json to list all."
    yield f"\n{shadow['summary']['sentence']}"


@click.command()
@click.argument("calibration", metavar="CALIBRATION|PARAMETER_SET", type=INPUT_FILE)
@click.option("--sensor", "sensor_file", type=INPUT_FILE, help="Sensor file, JSON; needed without --server.")
@click.option("--against", type=INPUT_FILE, help="The baseline's parameters; the sensor file's if omitted.")
@click.option("--validate", "telemetry", type=INPUT_FILE, help="Held-out telemetry; the calibration's own if omitted.")
@click.option("--profile", "profile_file", type=INPUT_FILE, help="Gate profile, JSON; the default limits if omitted.")
@server_option
@json_option
def assess(
    calibration: Path,
    sensor_file: Path | None,
    against: Path | None,
    telemetry: Path | None,
    profile_file: Path | None,
    server_url: str | None,
    json_file: str | None,
) -> None:
    """Compare CALIBRATION, a JSON of `boresight calibrate`, with limits and with the baseline.

    Each gate reports PASS, MARGINAL, NO-DATA or FAIL; the worst is the verdict. The exit code is 0 regardless of the
    verdict. Scripts read `verdict` and `blocking` from --json.

    With --server a PARAMETER_SET of that server, PS-<sensor>-<n> or its number, is compared with the limits and the baseline of
    its sensor, on the server's own validation frames.
    """
    check_writable(json_file)
    given = (sensor_file, against, telemetry, profile_file)
    if server_url is None and sensor_file is None:
        raise click.MissingParameter(param_hint="'--sensor'", param_type="option")
    if server_url is not None and any(one is not None for one in given):
        raise RefusedInputError(
            "With --server, sensor, baseline, validation frames and limits come from the server: omit --sensor, --against, "
            "--validate and --profile."
        )
    if server_url is not None:
        from boresight.library.remote import member

        with open_client(server_url) as server:
            named = find_set(server, str(calibration))
            found = server.assess(named).as_assessment(member(named.document, "sensor", str))
    elif sensor_file is not None:
        with progress("reading the calibration") as report:
            found = library.assess(
                calibration, sensor_file, validate=telemetry, against=against, profile=profile_file, progress=report
            )
    write_json(found.to_dict(), json_file)
    if json_file != "-":
        click.echo("\n".join(_gate_lines(found)))


def _gate_lines(found: Assessment) -> Iterator[str]:
    """Lay a report out for a terminal: the table, then a sentence for every gate that does not pass."""
    from boresight.verdicts.gates.judgement import gate_rows

    rows = gate_rows(found.gates, found.blocking)
    head = ("gate", "result", "measured", "95 %", "limit", "marginal from", "baseline", "unit")
    table = [
        (row.title, row.status, row.value, row.interval, row.limit, row.marginal, row.incumbent, row.unit)
        for row in rows
    ]
    yield aligned([head, *table], left=(0, 1, 7))
    yield ""
    failing = [row for row in rows if row.status != "PASS"]
    for sentence in dict.fromkeys(row.sentence for row in failing):
        named = [f"{row.title} {row.status}" for row in failing if row.sentence == sentence]
        yield f"{'; '.join(named)}: {sentence}"
    yield ""
    blocking = f"; it would be blocked by {', '.join(found.blocking)}" if found.blocking else ""
    yield f"{found.sensor}: {found.words}{blocking}"


@click.command()
@click.argument("parameter_set", required=False)
@click.option(
    "--run",
    type=click.IntRange(min=1),
    help="Submit the result of this run instead; a parameter set is created from it first.",
)
@click.option("--reason", required=True, help="Why it should become the baseline; the approvers read it.")
@required_server_option
@json_option
def submit(parameter_set: str | None, run: int | None, reason: str, server_url: str, json_file: str | None) -> None:
    """Request on a server that PARAMETER_SET, PS-<sensor>-<n> or its number, becomes the baseline.

    The server assesses its gates, and the request binds the report. Only people can sign it, not a key.
    """
    check_writable(json_file)
    if (parameter_set is None) == (run is None):
        raise RefusedInputError("Name one parameter set, or give the number of a run as --run.")
    with open_client(server_url) as server:
        named = find_set(server, parameter_set) if parameter_set is not None else server.make_parameter_set(run or 0)
        request = server.submit(named, reason)
    write_json(asdict(request), json_file)
    if json_file != STANDARD_OUTPUT:
        until = "" if request.expires_utc is None else f" until {request.expires_utc}"
        signatures = "1 signature" if request.needed == 1 else f"{request.needed} signatures"
        click.echo(f"{named.name}: request {request.id} is {request.state}{until} and needs {signatures}")
