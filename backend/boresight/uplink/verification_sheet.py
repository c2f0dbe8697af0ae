"""The sheet that people take to the console: what changes, who said so, what to compare, and blanks for what was done.

One HTML file that stands alone, made for printing. Everything in it is escaped by the template; a content security policy
in it forbids scripts and connections.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from boresight.resources import folder
from boresight.uplink.parameter_files import changes
from boresight.uplink.table_definition import TableDefinition

Step = tuple[str, str, str]  # what is done, how, what must be seen


def verification_sheet(
    subject: Mapping[str, Any],
    before: Mapping[str, Any] | None,
    definition: TableDefinition | None,
    facts: Mapping[str, Any] | None,
    quantisation: Mapping[str, Any] | None,
    *,
    said: Mapping[str, Any],
) -> bytes:
    """Write the sheet of a set."""
    environment = Environment(
        loader=FileSystemLoader(folder("frontend") / "templates"), autoescape=True, undefined=StrictUndefined
    )
    return (
        environment.get_template("uplinks/verification_sheet.html")
        .render(
            subject=subject,
            before=before,
            rows=changes(subject, before),
            definition=definition,
            facts=facts,
            quantisation=quantisation,
            steps=_steps(definition, facts),
            number=_number,
            **said,
        )
        .encode()
    )


def _number(value: Any) -> str:
    """Write a number with the digits that a person compares, or a dash."""
    return "–" if value is None else f"{value:.10g}" if isinstance(value, int | float) else str(value)


def _steps(definition: TableDefinition | None, facts: Mapping[str, Any] | None) -> list[Step]:
    """List what is done, in order."""
    steps: list[Step] = [("Check the package", "sha256sum -c SHA256SUMS", "every file OK")]
    if definition is None or facts is None:
        return [
            *steps,
            ("Load", "by the mission's own procedure: no table definition is configured here", "accepted"),
            ("Check", "by the mission's own procedure, before it is used", "agrees with parameters.json"),
            ("Activate", "command by the mission's own procedure", "accepted"),
            ("Dump and compare", "read the parameters back and compare each", "agrees with parameters.json"),
        ]
    name = definition.table_id if definition.cfe is None else definition.cfe.table_name
    file = "table.bin" if definition.cfe is None else "table.tbl"
    told = facts["crc_told"]
    check = f"{told['name']} {told['value']}" if told else "agrees with the mission's own check"
    return [
        *steps,
        ("Check the software", "flight software version in telemetry", definition.flight_software_version),
        ("Load", f"{file} into the inactive image of {name}", f"{facts['bytes']} bytes accepted"),
        ("Check", f"validate the inactive image of {name}; its CRC in telemetry", check),
        ("Activate", f"activate {name}; not before the check passed", "accepted"),
        ("Dump", f"dump the active image of {name} to a file", f"{facts['bytes']} bytes"),
        ("Compare", "upload the dump: every byte and field is compared", "VERIFIED, by bytes"),
    ]
