"""The choices of a calibration on the command line, by group: each is declared in `calibration.options`."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import Any

import click

from boresight.calibration.options import GROUPS, OPTIONS, Option

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


def calibration_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command every choice of a calibration."""
    for option in reversed(OPTIONS.values()):
        if option.flag is None:
            continue
        ticked = {"is_flag": True, "default": None} if option.kind == "yes or no" else {}
        give = click.option(
            option.flag, option.name, cls=Choice, of=option, help=_help(option), type=_TYPES.get(option.kind),
            metavar=_METAVARS.get(option.kind), **ticked,
        )  # fmt: skip
        command = give(command)
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
