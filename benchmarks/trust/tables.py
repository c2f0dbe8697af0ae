"""The part `trust` as tables in Markdown: clean sets, cases, faults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from benchmarks.pages.tables import number, table

Found = Mapping[str, Any]
Rows = Sequence[Found]

INTRODUCTION = """Sets of {frames} frames of two exposures with about twelve stars, by cameras, a sky and attitudes that share no
code with the product.

- *Error*: the largest of the parameters, in claimed sigmas of noise alone, median of the sets; *with misfit*, in those that include
  model error.
- *Noticed*: the share of sets on which advice, a test, a cause, a removed star, a gate or the verdict's level is there that the
  clean set of the same seed has not.
- *Shift*: root mean square change of the worst parameter against the clean set's, in its sigma. *Excess*: what the errors are above
  the claimed sigmas, in these. A fault matters from the strength on at which one of them is above 1.
- *Seen at best*: the chi-square that is left when every parameter and attitude has adapted to the fault, without noise. Below about
  10 no test on such a set notices the fault reliably, whatever its form.
- *Passes*: the share of sets that the fault makes wrong by more than 3 of the widest sigmas they claim, while every gate answers as
  for the clean set.

"""
CASE_HEADS = (
    "case", "strength", "error, σ", "with misfit, σ", "NEES", "NEES with misfit", "χ² / dof", "removed", "first advice",
    "first cause", "verdict", "gates changed", "assumptions", "passes",
)  # fmt: skip
FAULT_HEADS = (
    "fault", "strengths", "shift, σ", "excess, σ", "seen at best", "noticed", "by, at the first that matters", "first cause",
    "passes", "in time",
)  # fmt: skip
LONGEST = 100


def render(found: Found) -> str:
    """The section of the page."""
    return INTRODUCTION.format(**found) + "\n".join(found["tables"].values())


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}" if 0 < value < 0.1 else f"{value:.0%}"


def _shares(found: Mapping[str, float], most: int = 4) -> str:
    return ", ".join(
        _short(name) + ("" if share == 1 else f" {_share(share)}") for name, share in list(found.items())[:most]
    )


def _short(words: str) -> str:
    return words if len(words) <= LONGEST else f"{words[:LONGEST].rpartition(' ')[0]} …"


def clean_tables(clean: Found) -> str:
    """Coverage and efficiency of the methods, and false alarms."""
    rows = [
        [name, "{:.4f} ({:.4f} to {:.4f})".format(one["over_likelihood"], *one["over_likelihood_interval"]),
         f"{one['nees']:.2f} ± {one['nees_sigma']:.2f}", number(one["nees_with_misfit"]),
         *(f"{share:.1%}" for share in one["coverage"].values())]
        for name, one in clean["methods"].items()
    ]  # fmt: skip
    levels = (f"inside {level}" for level in next(iter(clean["methods"].values()))["coverage"])
    heads = ("method", "squared error over maximum likelihood's", "NEES", "with misfit", *levels)
    named = {**{key: clean.get(f"false_{key}", {}) for key in clean["false"]}, "verdict": clean["levels"]}
    false = [[name, _share(share), _shares(named[name], 3)] for name, share in clean["false"].items()]
    return (
        f"### {clean['sets']:,} clean sets\n\nNEES of maximum likelihood: {clean['likelihood_nees']:.2f}.\n\n"
        + table(heads, rows) + "\n" + table(("held against a clean set by", "of the sets", "which"), false, (0, 2))
        + f"\nNo data for the gates {', '.join(clean['no_data'])}: nothing was held out, no incumbent, or nothing declared.\n"
    )  # fmt: skip


def case_table(rows: Rows) -> str:
    """A row a case and strength."""
    return "### Known cases\n\n" + table(CASE_HEADS, list(map(_case, rows)), (0, 8, 9, 10, 11, 12))


def _case(row: Found) -> list[str]:
    figures = ("worst_sigma", "worst_sigma_with_misfit", "nees", "nees_with_misfit", "chi2_per_dof", "removed")
    return [
        row["says"] + ("" if row["visible"] else " (unobservable)"), f"{row['strength']:g} {row['unit']}".strip(),
        *(number(row[key]) for key in figures), _short(row["first"]), row["first_cause"], row["level"], _shares(row["gates"]),
        row["assumptions"], _share(row["passes"]),
    ]  # fmt: skip


def fault_table(rows: Rows) -> str:
    """A row a fault, the strengths at which it matters in bold."""
    cells = list(_faults(rows))
    late = [one[0] for one in cells if one[-1] != "yes"]
    return (
        f"### {len(cells)} faults\n\nNoticed before they matter, or where they begin to: {len(cells) - len(late)} of {len(cells)}. "
        f"Not: {'; '.join(late) or 'none'}. Each has three strengths; those at which it matters are bold.\n\n"
        + table(FAULT_HEADS, cells, (0, 1, 6, 7, 9))
    )


def _faults(rows: Rows) -> Iterator[list[str]]:
    for _, group in groupby(rows, lambda row: row["name"]):
        of = list(group)
        first = next((row for row in of if row["matters"]), of[-1])
        by = {where: share for where, share in first["where"].items() if where not in {"tests", "causes"}}
        strengths = (f"**{row['strength']:.3g}**" if row["matters"] else f"{row['strength']:.3g}" for row in of)
        yield [
            of[0]["says"], f"{', '.join(strengths)} {of[0]['unit']}",
            *(", ".join(number(row[key], 2) for row in of) for key in ("shift", "excess", "noncentrality")),
            ", ".join(_share(row["noticed_share"]) for row in of), _shares({**first["tests"], **by}), first["first_cause"],
            ", ".join(_share(row["passes"]) for row in of), "yes" if in_time(of) else "**no**",
        ]  # fmt: skip


def in_time(rows: Rows) -> bool:
    """Whether a fault is noticed at the strength at which it first matters, or below it."""
    noticed, matters = (
        next((k for k, row in enumerate(rows) if row[key]), len(rows)) for key in ("noticed", "matters")
    )
    return matters == len(rows) or noticed <= matters
