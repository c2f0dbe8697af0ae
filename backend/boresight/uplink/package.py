"""The uplink package: one set, everything about it, and the way back, as one file whose bytes follow from its inputs alone.

::

    MANIFEST.json  SHA256SUMS  SHA256SUMS.sig  verify_package.py  table_definition.json
    parameter_set.json  parameters.json  parameters.csv  c_sd.json  camera_files.txt ...  verification_sheet.html
    correction_table.json  correction_table.csv  where the camera model leaves a displacement
    table.bin  table.hex.txt  table.tbl  table_def.txt  table_report.csv  pus_st20.csv  quantisation.json
    backout/    the same files of the set to go back to
    on_board/   the same files of the set that is recorded as active, where it is neither of the two

The way back of a set that is not baseline yet is the current baseline; of the baseline it is the one before it, because the
baseline itself is what may have to be taken back; a sensor's first baseline has none before it and is its own.

`inputs` is one JSON document, kept with the package: no clock, no database and no setting is asked here. Nor is a key: whoever has
one signs SHA256SUMS (Ed25519), which covers every other file, and the signature is kept with the package too.

The sheet that people take to the console: what changes, who said so, what to compare, and blanks for what was done.

One HTML file that stands alone, made for printing. Everything in it is escaped by the template; a content security policy
in it forbids scripts and connections.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.resources import folder
from boresight.telemetry.sensors import Sensor, parse_sensor
from boresight.uplink import verify_package
from boresight.uplink.archive import archive, canonical_bytes, json_bytes, sums
from boresight.uplink.camera_files import camera_files, why_not
from boresight.uplink.correction_table import correction_files, describe_correction
from boresight.uplink.parameter_files import (
    alignment_json,
    approved_alignment,
    changes,
    parameters_csv,
    parameters_json,
)
from boresight.uplink.table_definition import (
    TableDefinition,
    alignment_numbers,
    parse_definition,
    quantisation_effect,
    quantised,
)
from boresight.uplink.table_files import held_by, table_facts, table_files
from boresight.uplink.verify_package import SIGNATURE, SUMS

SCHEMA = "boresight.uplink-package/1"
SIMULATED = "SIMULATED: this sensor's telemetry is simulated; do not load this package into a spacecraft."
Inputs = Mapping[str, Any]


def build_package(inputs: Inputs, signature: bytes | None = None) -> bytes:
    """Build the ZIP, with the signature of its sums where there is one."""
    files = make_files(inputs, signed=signature is not None)
    return archive(files if signature is None else files | {SIGNATURE: signature})


def make_files(inputs: Inputs, *, signed: bool) -> dict[str, bytes]:
    """Make every file but the signature; a signed package brings the program that verifies it."""
    sensor = parse_sensor(inputs["sensor"])
    definition = _definition(inputs, sensor)
    subject, backout = inputs["subject"], inputs["backout"]
    alone = backout["sha256"] == subject["sha256"]
    sets = {"": subject, "backout/": backout, "on_board/": inputs["active"]}
    tables = {folder: _tables(definition, sensor, one, folder) for folder, one in sets.items() if one is not None}
    files: dict[str, bytes] = {}
    for place, made in tables.items():
        before = None if alone else backout if place == "" else subject
        way_back = tables["backout/"]
        said = _make_sentences(inputs, place) | {"back_to": way_back.facts, "keeps_image": way_back.missing is not None}
        held = _files(sensor, definition, sets[place], before, made, said)
        files |= {f"{place}{name}": content for name, content in held.items()}
    if definition is not None:
        files["table_definition.json"] = json_bytes(definition.document)
    files["MANIFEST.json"] = json_bytes(_manifest(inputs, sensor, tables))
    if signed:
        files["verify_package.py"] = Path(verify_package.__file__).read_bytes()
    return files | {SUMS: sums(files)}


def _definition(inputs: Inputs, sensor: Sensor) -> TableDefinition | None:
    named = inputs["definition"]
    return None if named is None else parse_definition(named["document"], sensor)


@dataclass(frozen=True)
class _Tables:
    """The files of a set's table, what to compare of it, and what its number format does; empty without a definition.

    `missing`: why there is none although there is a definition.
    """

    files: Mapping[str, bytes]
    facts: Mapping[str, Any] | None = None
    rounding: Mapping[str, Any] | None = None
    missing: str | None = None


def _tables(definition: TableDefinition | None, sensor: Sensor, subject: Mapping[str, Any], place: str) -> _Tables:
    if definition is None:
        return _Tables({})
    parameters, name, alignment = subject["document"]["parameters"], subject["name"], subject.get("alignment")
    if definition.is_aligned and alignment is None:
        said = f"The table {definition.table_id} contains an alignment, but no alignment made with {name} is approved"
        if place == "":
            raise RefusedInputError(
                f"{said}: align its run, submit the alignment and have it approved, or set a definition without alignment fields."
            )
        missing = f"{said}: save the current on-board image before loading, and reload it to go back."
        return _Tables({"table_missing.txt": f"{missing}\n".encode()}, missing=missing)
    numbers = None if alignment is None else alignment_numbers(alignment["quaternion"])
    try:
        files = table_files(definition, parameters, name, numbers)
        rounding = _quantisation(definition, sensor, parameters)
    except RefusedInputError as refusal:
        raise RefusedInputError(
            f"{name} does not fit into the table {definition.table_id}: {refusal}", code="does-not-fit"
        ) from refusal
    return _Tables(files | {"quantisation.json": json_bytes(rounding)}, table_facts(definition, files), rounding)


def _files(
    sensor: Sensor,
    definition: TableDefinition | None,
    subject: Mapping[str, Any],
    before: Mapping[str, Any] | None,
    tables: _Tables,
    said: Mapping[str, Any],
) -> dict[str, bytes]:
    parameters = subject["document"]["parameters"]
    held = {} if definition is None else held_by(definition, parameters)
    return {
        "parameter_set.json": canonical_bytes(subject["document"]),
        "parameters.json": parameters_json(sensor, subject, held),
        "parameters.csv": parameters_csv(subject, before, held),
        "c_sd.json": alignment_json(subject, before),
        **approved_alignment(subject),
        "verification_sheet.html": verification_sheet(
            subject, before, definition if tables.facts else None, tables, said=said
        ),
        **camera_files(sensor, parameters, subject["name"]),
        **correction_files(subject),
        **tables.files,
    }


def _quantisation(definition: TableDefinition, sensor: Sensor, parameters: Mapping[str, float]) -> dict[str, Any]:
    """Say what the number format on board does to the camera."""
    held = quantised(definition, parameters)
    effect = quantisation_effect(CAMERA_MODELS[sensor.camera_model], sensor, parameters, held)
    return {
        "schema": "boresight.quantisation/1",
        **effect,
        "sentence": f"The table's number format moves a star by at most {effect['max_px']:.3g} px, "
        f"{effect['max_arcsec']:.3g} arcsec, anywhere on the detector.",
        "parameters": {
            name: {"value": value, "on_board": held[name], "difference": held[name] - value}
            for name, value in parameters.items()
        },
    }


def _make_sentences(inputs: Inputs, folder: str) -> dict[str, Any]:
    """Return the sentences that the sheets share; the way back's own sheet has none."""
    subject, sensor = inputs["subject"], inputs["sensor"]
    of = {
        "": "uplink package",
        "backout/": "back-out inside the uplink package",
        "on_board/": "active set inside the uplink package",
    }
    return {
        "package": f"Sensor {sensor['name']}, {of[folder]} of {subject['name']}.",
        "simulated": SIMULATED if inputs["simulated"] else None,
        "backout": _way_back(inputs) if folder == "" else None,
        "four_eyes": inputs["four_eyes"]["sentence"],
        "audit_head": inputs["first_built"]["audit_head"],
    }


def _way_back(inputs: Inputs) -> str:
    """Say what is in `backout/`, and what is on board where that is something else."""
    subject, backout, active = inputs["subject"], inputs["backout"], inputs["active"]
    if backout["sha256"] == subject["sha256"]:
        text = (
            f"{subject['name']} is the sensor's first baseline: there is nothing earlier, so backout/ is the same set."
        )
    elif subject["ground_state"] == "BASELINE":
        text = f"backout/ is {backout['name']}, the baseline before {subject['name']}."
    else:
        text = f"backout/ is {backout['name']}, the current baseline."
    if active is not None:
        text += (
            f" The set recorded as active on board is {active['name']}, which is neither of these; it is in on_board/."
        )
    return text


def _manifest(inputs: Inputs, sensor: Sensor, tables: Mapping[str, _Tables]) -> dict[str, Any]:
    """Say what the package is, who answers for it and what it is for."""
    subject, definition = inputs["subject"], inputs["definition"]
    document = None if definition is None else definition["document"]
    reason = why_not(sensor)
    return {
        "schema": SCHEMA,
        "sensor": sensor.name,
        "simulated": inputs["simulated"],
        "parameter_set": {key: subject[key] for key in ("id", "name", "sha256", "ground_state")},
        "four_eyes": inputs["four_eyes"],
        "approval": subject["approval"],
        "gates": subject["gates"],
        "audit": {"head": inputs["first_built"]["audit_head"], "at_utc": inputs["first_built"]["at_utc"]},
        "flight_software_version": None if document is None else document["flight_software_version"],
        "table_id": None if document is None else document["table_id"],
        "table_definition": None
        if definition is None
        else {"number": definition["number"], "sha256": definition["sha256"]},
        "tables": {folder or ".": made.facts for folder, made in tables.items()},
        "backout": {
            "name": inputs["backout"]["name"],
            "sha256": inputs["backout"]["sha256"],
            "sentence": _way_back(inputs),
        },
        "on_board": None if inputs["active"] is None else {key: inputs["active"][key] for key in ("name", "sha256")},
        "camera_files": {"exact": reason is None, "reason": reason},
        **describe_correction(subject),
        "software": inputs["software"],
        "inputs": inputs,
        "checks": "sha256sum -c SHA256SUMS; sha256sum parameter_set.json is the hash of the parameter set",
    }


Step = tuple[str, str, str]  # what is done, how, what must be seen


def verification_sheet(
    subject: Mapping[str, Any],
    before: Mapping[str, Any] | None,
    definition: TableDefinition | None,
    tables: _Tables,
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
            facts=tables.facts,
            quantisation=tables.rounding,
            steps=_steps(definition, tables, keeps_image=said["keeps_image"]),
            number=_number,
            **said,
        )
        .encode()
    )


def _number(value: Any) -> str:
    """Write a number with the digits that a person compares, or a dash."""
    return "–" if value is None else f"{value:.10g}" if isinstance(value, int | float) else str(value)


def _steps(definition: TableDefinition | None, tables: _Tables, *, keeps_image: bool) -> list[Step]:
    steps: list[Step] = [("Check the package", "sha256sum -c SHA256SUMS", "every file OK")]
    facts = tables.facts
    if definition is None or facts is None:
        load = "By the mission's own procedure: no table definition is configured here"
        if tables.missing is not None:
            load = "The image that was saved before loading: table_missing.txt says why there is none here"
        return [
            *steps,
            ("Load", load, "Accepted"),
            ("Check", "By the mission's own procedure, before it is used", "Agrees with parameters.json"),
            ("Activate", "Command by the mission's own procedure", "Accepted"),
            ("Dump and compare", "Read the parameters back and compare each", "Agrees with parameters.json"),
        ]
    name = definition.table_id if definition.cfe is None else definition.cfe.table_name
    file = "table.bin" if definition.cfe is None else "table.tbl"
    told = facts["crc_told"]
    check = f"{told['name']} as under Expected values" if told else "Agrees with the mission's own check"
    if keeps_image:
        kept = f"Dump the active image of {name} to a file: backout/ has no table to go back to"
        steps.append(("Save the on-board image", kept, f"{facts['bytes']} bytes"))
    return [
        *steps,
        ("Check the software", "Flight software version in telemetry", definition.flight_software_version),
        ("Load", f"{file} into the inactive image of {name}", f"{facts['bytes']} bytes accepted"),
        ("Check", f"Validate the inactive image of {name}; its CRC in telemetry", check),
        ("Activate", f"Activate {name}, only after the check has passed", "Accepted"),
        ("Dump", f"Dump the active image of {name} to a file", f"{facts['bytes']} bytes"),
        ("Compare", "Upload the dump: every byte and field is compared", "VERIFIED, by bytes"),
    ]
