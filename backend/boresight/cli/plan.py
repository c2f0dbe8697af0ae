"""`boresight plan`: what to observe next."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from boresight.cli.input import INPUT_FILE
from boresight.cli.output import STANDARD_OUTPUT, check_one_stream, check_writable, json_option, write_bytes, write_json
from boresight.cli.remote import first_message, open_client, server_option
from boresight.errors import RefusedInputError
from boresight.library import functions as library
from boresight.library.progress import progress


def _read_orbit(_: click.Context, __: click.Parameter, text: str | None) -> dict[str, float] | None:
    if text is None:
        return None
    parts = text.split(",")
    try:
        altitude, inclination, hour = (float(part) for part in parts)
    except ValueError as error:
        raise RefusedInputError(
            f"The orbit {text[:40]!r} is not three numbers: write altitude in km, inclination in degrees and hour of the node, as "
            "570,97.8,10.5."
        ) from error
    return {"altitude_km": altitude, "inclination_deg": inclination, "node_hour": hour}


@click.command()
@click.option("--sensor", "sensor_file", type=INPUT_FILE, required=True, help="Sensor file, JSON.")
@click.option("--start", required=True, metavar="UTC", help="Start time, such as 2026-10-01T00:00:00Z.")
@click.option("--minutes", type=float, required=True, help="Maximum duration.")
@click.option(
    "--calibration",
    metavar="FILE",
    help="Calibration JSON with the prior knowledge; on a server a set's name or a run's number.",
)
@click.option(
    "--candidates",
    type=INPUT_FILE,
    help="CSV of candidate attitudes: ra_deg, dec_deg, roll_deg; the whole sky if omitted.",
)
@click.option(
    "--orbit",
    metavar="KM,DEG,HOUR",
    callback=_read_orbit,
    help="Circular orbit: altitude, inclination, local solar hour of the ascending node. Without it, the Earth is not considered.",
)
@click.option(
    "--criterion",
    type=click.Choice(["A", "D"]),
    default="A",
    show_default=True,
    help="A: minimum sum of variances in typical sigmas. D: minimum volume of the confidence region.",
)
@click.option("--dwell-s", type=float, help="Duration of a pointing; 60 if omitted.")
@click.option("--exposure-s", type=float, help="Seconds from one exposure to the next; 10 if omitted.")
@click.option("--slew-deg-s", type=float, help="Slew rate; 0.5 if omitted.")
@click.option("--settle-s", type=float, help="Settling time after a slew; 10 if omitted.")
@click.option("--sun-deg", type=float, help="Minimum angle from the Sun; 40 if omitted.")
@click.option("--moon-deg", type=float, help="Minimum angle from the Moon; 15 if omitted.")
@click.option("--earth-deg", type=float, help="Minimum angle from the Earth's limb; 20 if omitted.")
@click.option("--visits", type=int, help="Maximum number of visits to one pointing; 3 if omitted.")
@click.option("--out", "out_file", metavar="FILE", help="Write the pointings as CSV; - is standard output.")
@server_option
@json_option
def plan(  # noqa: PLR0913, PLR0917 - an option each
    sensor_file: Path,
    start: str,
    minutes: float,
    calibration: str | None,
    candidates: Path | None,
    orbit: dict[str, float] | None,
    criterion: str,
    out_file: str | None,
    server_url: str | None,
    json_file: str | None,
    **constraints: Any,
) -> None:
    """Plan the next observations: pointings and rolls that reduce the largest uncertainties most per minute.

    The information of each exposure is computed from the catalogue stars on the detector, with its attitude unknown. Pointings are
    chosen by gain per second of slew and dwell, improved by exchange, and kept clear of Sun, Moon and Earth.

    With --server the plan is computed there; --sensor may be the name of a sensor of that server.
    """
    check_one_stream(out_file, json_file)
    check_writable(out_file, "CSV")
    check_writable(json_file)
    given = {name: value for name, value in constraints.items() if value is not None}
    conditions = {"candidates": candidates, "criterion": criterion, "orbit": orbit, **given}
    with progress("planning" if server_url is None else first_message(server_url)) as report:
        if server_url is None:
            known = None if calibration is None else INPUT_FILE.convert(calibration, None, None)
            found = library.plan(sensor_file, start, minutes, calibration=known, progress=report, **conditions)
        else:
            with open_client(server_url) as server:
                found = server.plan(str(sensor_file), start, minutes, calibration=calibration, **conditions)
    write_json(found.to_dict(), json_file)
    if out_file is not None:
        write_bytes(found.to_csv(), out_file)
    if STANDARD_OUTPUT not in {json_file, out_file}:
        click.echo(str(found))
