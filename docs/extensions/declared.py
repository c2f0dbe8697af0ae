"""The reference, written from the product: a page says `<!-- declared: gates -->` where the table of all gates is to stand.

What is declared in the code (commands, options, settings, operations, gates, tests, causes, alarms, cameras, telemetry's columns,
schemas, the library's names, decisions) is written nowhere else, so the site cannot tell something else than the product does.
"""

from __future__ import annotations

import inspect
import json
import re
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

import boresight
from boresight.calibration.options import GROUPS, METHODS, listed
from boresight.calibration.trust.causes import CAUSES, UNKNOWN
from boresight.calibration.trust.trust_tests import TRUST_TESTS
from boresight.cameras import CAMERA_MODELS
from boresight.cli import main
from boresight.console.administration.fleet_metrics import GAUGES
from boresight.console.alarms import rules
from boresight.console.messages.kinds import KINDS
from boresight.settings import SETTINGS, read_settings
from boresight.site import SITE_FIELDS
from boresight.telemetry.declarations import DECLARATIONS
from boresight.telemetry.schema import OPTIONAL_COLUMNS, REQUIRED_COLUMNS
from boresight.verdicts.gates.measurements import GATES

ROOT = Path(__file__).resolve().parents[2]
#: A document and its number, as its `schema` says them.
DOCUMENT = re.compile(r"boresight\.[a-z-]+/[0-9]+")
MARK = re.compile(r"^<!-- declared: ([a-z-]+) -->$", re.MULTILINE)


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Write a Markdown table."""
    lines = (head, ["---"] * len(head), *rows)
    return "\n".join("| " + " | ".join(_cell(one) for one in line) + " |" for line in lines)


def _cell(value: object) -> str:
    return " ".join(str("" if value is None else value).split()).replace("|", r"\|")


def _code(value: object) -> str:
    return f"`{value}`" if value not in {None, ""} else ""


# The command line.


def _walk(group: click.Group, words: tuple[str, ...]) -> Iterator[tuple[str, click.Command]]:
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from _walk(command, (*words, name))
        if not isinstance(command, click.Group) or command.invoke_without_command:
            yield " ".join((*words, name)), command


def _parameter(one: click.Parameter) -> tuple[str, str, str, str]:
    names = (
        ", ".join(f"`{name}`" for name in (*one.opts, *one.secondary_opts))
        if isinstance(one, click.Option)
        else _code(one.human_readable_name)
    )
    values = "" if isinstance(one, click.Option) and one.is_flag else _values(one.type)
    plain = isinstance(one.default, str | int | float) and not isinstance(one.default, bool)
    return (
        names,
        values,
        _code(one.default if plain else ""),
        getattr(one, "help", None) or ("required" if one.required else ""),
    )


def _values(kind: click.ParamType) -> str:
    if isinstance(kind, click.Choice):
        return ", ".join(f"`{choice}`" for choice in kind.choices)
    if isinstance(kind, click.IntRange | click.FloatRange):
        return f"{kind.name.removesuffix(' range')}, {kind._describe_range()}"  # noqa: SLF001 - as click's own help has it
    return kind.name


def commands() -> str:
    """Write every command with its usage, what it does, and its options."""
    parts = []
    for name, command in _walk(main, ("boresight",)):
        context = click.Context(command, info_name=name)
        usage = " ".join((name, *command.collect_usage_pieces(context)))
        shown = [one for one in command.params if not getattr(one, "hidden", False)]
        said = inspect.cleandoc(command.help or "").replace("\b\n", "").replace("\f", "")
        rows = table(("Option", "Values", "Default", "What"), map(_parameter, shown))
        parts.append(f"## `{name}`\n\n```text\n{usage}\n```\n\n{said}\n\n{rows}")
    return "\n\n".join(parts)


def options() -> str:
    """Write every choice of a calibration, by group."""
    return "\n\n".join(f"### {group}\n\n{listed((group,))}" for group in GROUPS)


def methods() -> str:
    """Write the methods and when to use each."""
    return table(("Method", "Name", "When"), ((f"`{one.name}`", one.title, one.when) for one in METHODS.values()))


def settings() -> str:
    """Write every setting of the server."""
    rows = ((f"`{one.variable}`", _code(one.default), one.unit, one.sentence) for one in SETTINGS)
    return table(("Variable", "Default", "Unit", "Meaning"), rows)


# REST.


def operations() -> str:
    """Write every operation of the REST API, by noun."""
    from boresight.server import create_app  # noqa: PLC0415 - it loads the whole console, which other pages do without

    with tempfile.TemporaryDirectory() as folder:
        document = create_app(read_settings({"BORESIGHT_DATA_FOLDER": folder})).openapi()
    rows = defaultdict(list)
    for path, methods_of_path in document["paths"].items():
        for method, one in methods_of_path.items():
            rows[one.get("tags", ["others"])[0]].append((f"`{method.upper()}`", f"`{path}`", one.get("summary", "")))
    sentences = {tag["name"]: tag.get("description", "") for tag in document["tags"]}
    parts = (
        f"### {tag}\n\n{sentences.get(tag, '')}\n\n{table(('Method', 'Path', 'What'), found)}"
        for tag, found in rows.items()
    )
    return "\n\n".join(parts)


# What is asked of a result.


def _limit(gate: Any, value: float | None) -> str:
    return "" if value is None else f"{value:g} {gate.unit}".strip()


def gates() -> str:
    """Write every gate with its default limits."""
    rows = (
        (
            f"**{one.title}**<br>`{one.name}`",
            one.question,
            {"below": "at most", "above": "at least", "around": "within a factor of", "met": "yes"}[one.direction],
            _limit(one, one.marginal),
            _limit(one, one.limit),
            "never" if one.critical else "with a reason",
        )
        for one in GATES.values()
    )
    return table(("Gate", "Question", "Passes when", "MARGINAL beyond", "FAIL beyond", "Waived"), rows)


def trust_tests() -> str:
    """Write every test of the data against the model."""
    rows = ((f"**{one.title}**<br>`{one.name}`", one.finding, one.sound, GATES[one.gate].title) for one in TRUST_TESTS)
    return table(("Test", "If it notices something", "If not", "Gate"), rows)


def causes() -> str:
    """Write every cause that a result may name, with its remedy and the tests that it trips."""
    known = {one.name: one.title for one in TRUST_TESTS}
    parts = []
    for one in (*CAUSES.values(), UNKNOWN):
        sentence = one.sentence.replace("{size}", "…")
        own = [known[name] for name in one.tests if name == one.name and name in known]
        own_test = f" Its own test is *{own[0]}*." if own else ""
        parts.append(
            f"(cause-{one.name})=\n### `{one.name}`\n\n> {sentence}.\n\n**What to do:** {one.remedy}.{own_test}"
        )
    return "\n\n".join(parts)


def cause_advice() -> str:
    """Write what to do about every cause that advice may name, a section each."""
    return "\n\n".join(
        f"(advice-cause-{one.name.replace('_', '-')})=\n### Cause: {one.name.replace('_', ' ')}\n\n"
        f"{one.sentence.replace('{size}', '…')}. **What to do:** {one.remedy}. "
        f"[Its tests](../reference/tests-and-causes.md#cause-{one.name})."
        for one in (*CAUSES.values(), UNKNOWN)
    )


def alarms() -> str:
    """Write what raises each alarm."""
    rows = re.findall(r"^`([A-Z]+)` +(\w+) +(.*(?:\n {20}.*)*)", inspect.getdoc(rules) or "", re.MULTILINE)
    told = {"fleet.OLD_DAYS": "OLD_DAYS", "JUMP_S": "JUMP_S", "AWAY_S": "AWAY_S"}
    parts = []
    for kind, level, text in rows:
        for name, member in told.items():
            text = text.replace(f"`{name}`", f"{getattr(rules, member):g} {'days' if member == 'OLD_DAYS' else 's'}")  # noqa: PLW2901 - the same text
        parts.append(
            (f"[`{kind}`](../how-to/respond-to-an-alarm.md#{kind.lower()})", level, re.sub(r" \(`[\w.]+`\)", "", text))
        )
    return table(("Alarm", "Level", "Raised when"), parts)


# Files.


def columns() -> str:
    """Name the columns of telemetry."""
    return f"Required: {', '.join(map(_code, REQUIRED_COLUMNS))}. Optional: {', '.join(map(_code, OPTIONAL_COLUMNS))}."


def cameras() -> str:
    """Write every camera model: its equations and its parameters."""
    parts = []
    for camera in CAMERA_MODELS.values():
        rows = (
            (f"`{name}`", one.symbol, one.unit, one.role.name.lower().replace("_", " "), f"{one.typical_sigma:g}")
            for name, one in zip(camera.parameter_names, camera.parameters, strict=True)
        )
        steps = "\n".join(camera.equations.steps)
        parts.append(
            f"## `{camera.name}`\n\nRuns {camera.equations.runs}. Source: {camera.equations.source}.\n\n```text\n{steps}\n```\n\n"
            f"Backwards: {camera.equations.inverse}\n\n"
            + table(("Parameter", "Symbol", "Unit", "Role", "Typical sigma"), rows)
        )
    return "\n\n".join(parts)


def declarations() -> str:
    """Write what is declared in a sensor file because no data show it."""
    rows = (
        (f"`{one.name}`", one.title, "; ".join(f"`{word}`: {meaning}" for word, meaning in one.words.items()))
        for one in DECLARATIONS.values()
    )
    return table(("Name", "Title", "Words"), rows)


def site_fields() -> str:
    """Name what a site on the ground has."""
    return ", ".join(map(_code, SITE_FIELDS)) + "."


def _schema_rows(schema: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    for name, one in schema.get("properties", {}).items():
        yield f"`{name}`", _schema_type(one), one.get("description", "")


def _schema_type(one: dict[str, Any]) -> str:
    match one:
        case {"$ref": str(place)}:
            name = place.rpartition("/")[2]
            found = f"[{name}](#{name.lower()})"
        case {"anyOf": others}:
            found = " or ".join(map(_schema_type, others))
        case {"enum": values}:
            found = ", ".join(f"`{json.dumps(value)}`" for value in values)
        case {"const": value}:
            found = f"`{json.dumps(value)}`"
        case {"type": "array", "items": dict(inner)}:
            found = f"list of {_schema_type(inner)}"
        case {"type": "object", "additionalProperties": dict(inner)}:
            found = f"object of {_schema_type(inner)}"
        case _:
            found = str(one.get("type", "any"))
    return found


def _schema(name: str) -> str:
    document = json.loads((ROOT / "docs" / name).read_text(encoding="utf-8"))
    head = ("Member", "Type", "What")
    parts = [document.get("description", ""), table(head, _schema_rows(document))]
    for title, one in sorted(document.get("$defs", {}).items()):
        parts.append(f"## {title}\n\n{one.get('description', '')}")
        if "properties" in one:
            parts.append(table(head, _schema_rows(one)))
        else:
            parts.append(f"One of {_schema_type(one)}.")
    return "\n\n".join(parts)


def calibration_schema() -> str:
    """Write the members of a calibration JSON."""
    return _schema("calibration.schema.json")


def import_schema() -> str:
    """Write the members of a mapping profile."""
    return _schema("import-profile.schema.json")


def documents() -> str:
    """Name every document that has a number of its own, as the code writes it."""
    sources = (ROOT / "backend" / "boresight").rglob("*.py")
    found = {name for path in sources for name in DOCUMENT.findall(path.read_text(encoding="utf-8"))}
    return ", ".join(map(_code, sorted(found))) + "."


# What a site is told.


def metrics() -> str:
    """Write every metric that is read from the store and the server."""
    rows = ((f"`boresight_{one.name}`", ", ".join(map(_code, one.labels)), one.help) for one in GAUGES.values())
    return table(("Metric", "Labels", "What"), rows)


def message_kinds() -> str:
    """Write every kind of message to people."""
    return table(("Kind", "Told when"), ((f"`{one.name}`", one.title) for one in KINDS.values()))


# The library, and why things are as they are.


def library() -> str:
    """Have every name of the library documented from its docstring."""
    parts = []
    for name in boresight.__all__:
        value = getattr(boresight, name)
        kind = (
            ("autoexception" if issubclass(value, BaseException) else "autoclass")
            if inspect.isclass(value)
            else "autofunction"
        )
        members = "\n   :members:\n   :inherited-members: BaseException, tuple" if kind == "autoclass" else ""
        parts.append(f"## `bs.{name}`\n\n```{{eval-rst}}\n.. {kind}:: boresight.{name}{members}\n```")
    return "\n\n".join(parts)


def decisions() -> str:
    """Quote every decision."""
    rows = []
    for path in sorted((ROOT / "backend" / "decisions").glob("*.md")):
        text = path.read_text(encoding="utf-8")
        number, title = text.partition("\n")[0].removeprefix("# ").split(". ", 1)
        rows.append((int(number), title, text.partition("## Decision\n\n> ")[2].partition("\n")[0]))
    return table(("Number", "Title", "Decision"), rows)


WRITERS: dict[str, Callable[[], str]] = {
    function.__name__.replace("_", "-"): function
    for function in (
        alarms, calibration_schema, cameras, cause_advice, causes, columns, commands, decisions, declarations, documents,
        gates, import_schema, library, message_kinds, methods, metrics, operations, options, settings, site_fields, trust_tests,
    )
}  # fmt: skip


def _write(app: Sphinx, page: str, source: list[str]) -> None:  # noqa: ARG001 - the event's
    def replace(found: re.Match[str]) -> str:
        if found[1] not in WRITERS:
            raise ExtensionError(f"{page}: nothing is declared under {found[1]!r}; there are {', '.join(WRITERS)}.")
        return WRITERS[found[1]]()

    source[0] = MARK.sub(replace, source[0])


def setup(app: Sphinx) -> dict[str, Any]:
    """Replace the marks as pages are read."""
    app.connect("source-read", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
