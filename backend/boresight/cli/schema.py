"""`boresight schema`: the published JSON Schemas."""

from __future__ import annotations

import click

from boresight.cli.output import check_writable, json_option, write_json


@click.command()
@click.argument("document", type=click.Choice(["calibration"]))
@json_option
def schema(document: str, json_file: str | None) -> None:  # noqa: ARG001 - there is one as yet
    """Print the JSON Schema (2020-12) of the JSON that `boresight calibrate --json` writes.

    Code generators and validators take it; it is `docs/calibration.schema.json` too.
    """
    from boresight.calibration.calibration import compute_json_schema

    check_writable(json_file)
    write_json(compute_json_schema(), json_file or "-")
