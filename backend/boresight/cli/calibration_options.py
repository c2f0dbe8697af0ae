"""The choices of a calibration on the command line, by group; words and defaults are the settings' own.

They are read only when help is asked for, or a run made: the settings know the filters, and so load the compiled loops.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from functools import partial
from typing import Any

import click

METHOD = "Method"
MATCHING = "Matching"
BATCH = "Of the batch"
FILTER = "Of the filters"
REFERENCE = "Of svd and angular"
OTHERS = "Files and output"


class Choice(click.Option):
    """An option whose words and default are those of a setting; absent, it leaves that setting alone."""

    def __init__(self, words: list[str], *, group: str, **settings: Any) -> None:
        super().__init__(words, **settings)
        self.group = group

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Add the setting's words and default to the help."""
        record = super().get_help_record(ctx)
        return None if record is None else (record[0], f"{record[1]}{_words_and_default(str(self.name))}")


def _words_and_default(name: str) -> str:
    """Say which words a setting takes, and what holds without it."""
    from boresight.calibration.settings import CHOICES, CalibrationSettings

    words = f" Choose from {', '.join(CHOICES[name])}." if name in CHOICES else ""
    default = getattr(CalibrationSettings(), name)
    shown = ",".join(map(str, default)) if isinstance(default, tuple) else default
    return words if default is None or default is False else f"{words}  [default: {shown}]"


class GroupedCommand(click.Command):
    """A command whose help shows its options by group."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write a section a group, in the order of the options."""
        groups: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for option in self.get_params(ctx):
            if isinstance(option, click.Option) and (record := option.get_help_record(ctx)) is not None:
                groups[option.group if isinstance(option, Choice) else OTHERS].append(record)
        for group in (OTHERS, METHOD, MATCHING, BATCH, FILTER, REFERENCE):
            with formatter.section(group):
                formatter.write_dl(groups[group])


_choice = partial(click.option, cls=Choice)

CHOICES_OF_A_CALIBRATION = (
    _choice("--method", group=METHOD, help="Estimator."),
    _choice(
        "--variant", group=METHOD, help="Of a filter: no-q holds still, q follows drift, no-refit is q on old matches."
    ),
    _choice(
        "--free",
        group=METHOD,
        metavar="NAMES",
        help="Parameters to estimate, as f_m,b2_per_m2; the sensor's own list if left out.",
    ),
    _choice("--minimum-stars", type=int, group=METHOD, help="Exposures with fewer stars take no part."),
    _choice("--match", group=MATCHING, help="Star identities: those in the file, or made again as parameters improve."),
    _choice("--match-parameters", group=MATCHING, help="Which parameters a filter matches each frame with."),
    _choice(
        "--match-rule", group=MATCHING, help="Tolerance of a match: from its own noise, or that of the flight code."
    ),
    _choice(
        "--flight-tolerance-urad",
        type=float,
        group=MATCHING,
        help="Largest disagreement of an arc that the flight code accepts; five sigmas of an arc if left out.",
    ),
    _choice(
        "--leave-out-doubles",
        is_flag=True,
        default=None,
        group=MATCHING,
        help="Leave out double stars and stars with unreliable astrometry.",
    ),
    _choice("--max-iterations", type=int, group=BATCH, help="Most iterations of a fit."),
    _choice("--error", group=BATCH, help="What is minimised; cosine is worse, for comparison."),
    _choice("--robust", group=BATCH, help="Loss that bounds what a false star may say."),
    _choice("--huber-threshold", type=float, group=BATCH, help="Of huber, in whitened sigmas."),
    _choice("--linearisations", type=int, group=FILTER, help="Most a frame; 1 is the filter as printed."),
    _choice(
        "--process-noise",
        "process_noise_sigma",
        type=float,
        group=FILTER,
        help="Of q and no-refit: drift a frame, in typical sigmas.",
    ),
    _choice("--forgetting-factor", type=float, group=FILTER, help="Share of the information kept from frame to frame."),
    _choice("--initial-sigma-scale", type=float, group=FILTER, help="Sigma of the start, in typical sigmas."),
    _choice(
        "--star-model", type=int, group=REFERENCE, help="Of svd: star combinations, 1 to 4; 4 is the paper's choice."
    ),
    _choice(
        "--singular-values",
        group=REFERENCE,
        metavar="NUMBERS",
        help="Of svd: some of 1,2,3; the first adds nothing to the others, for their squares add up to the number of stars.",
    ),
    _choice(
        "--gain-form", group=REFERENCE, help="How the update is computed; gain is as printed, slower, the same result."
    ),
)


def calibration_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command every choice of a calibration."""
    for give in reversed(CHOICES_OF_A_CALIBRATION):
        command = give(command)
    return command


def chosen(choices: dict[str, Any]) -> dict[str, Any]:
    """Return the settings document of what was given; the rest keeps its default."""
    document = {name: value for name, value in choices.items() if value is not None}
    if "free" in document:
        document["free"] = [name.strip() for name in document["free"].split(",") if name.strip()]
    if "singular_values" in document:
        document["singular_values"] = [_number(text.strip()) for text in document["singular_values"].split(",")]
    return document


def _number(text: str) -> int | str:
    """Read a whole number; what is none stays as it is, for the settings to refuse."""
    return int(text) if text.isdecimal() else text
