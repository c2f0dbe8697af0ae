"""`boresight schema`: the published JSON Schemas."""

from __future__ import annotations

import click

from boresight.cli.output import check_writable, json_option, write_json


@click.command()
@click.argument("document", type=click.Choice(["alignment", "calibration", "import-profile"]))
@json_option
def schema(document: str, json_file: str | None) -> None:
    """Print the JSON Schema (2020-12) of the JSON that `boresight calibrate` or `align` writes, or of a mapping profile.

    For code generators and validators; also in `docs/`, as `docs/calibration.schema.json`.
    """
    check_writable(json_file)
    if document == "calibration":
        from boresight.calibration.calibration import compute_json_schema as compute
    elif document == "alignment":
        from boresight.calibration.alignment.result import compute_json_schema as compute
    else:
        from boresight.telemetry.imports.profile import compute_json_schema as compute
    write_json(compute(), json_file or "-")
