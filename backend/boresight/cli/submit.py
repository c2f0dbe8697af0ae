"""`boresight submit`: a parameter set's request to become the baseline, on a server, where people sign it."""

from __future__ import annotations

from dataclasses import asdict

import click

from boresight.cli.output import STANDARD_OUTPUT, check_writable, json_option, write_json
from boresight.cli.remote import find_set, open_client, required_server_option
from boresight.errors import RefusedInputError


@click.command()
@click.argument("parameter_set", required=False)
@click.option("--run", type=click.IntRange(min=1), help="Submit the result of this run instead; its set is made first.")
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
