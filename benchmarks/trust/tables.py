"""The part `trust` as tables in Markdown: clean sets, cases, faults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from benchmarks.pages.tables import number, table

Found = Mapping[str, Any]

INTRODUCTION = """Sets of {frames} frames of two exposures with about twelve stars, by cameras, a sky and attitudes that share no
code with the product.

- *Error*: the largest of the parameters, in claimed sigmas of noise alone, median of the sets; *with misfit*, in those that include
  model error.
- *Noticed*: the share of sets on which advice, a test, a cause, a removed star, a gate or the verdict's level is there that the
  clean set of the same seed has not.
- *Shift*: root mean square change of the worst parameter against the clean set's, in its sigma. *Excess*: what the errors are above
  the claimed sigmas, in these. A fault matters where one of them is above 1.
- *Seen at best*: the chi-square that is left when every parameter and attitude has adapted to the fault, without noise. Below about
  10 no test on such a set notices the fault reliably, whatever its form.
- *Passes*: the share of sets that are wrong by more than 3 of the widest sigmas they claim while every gate answers as for a clean
  set.

"""
CASE_HEADS = (
    "case", "strength", "error, σ", "with misfit, σ", "NEES", "NEES with misfit", "χ² / dof", "removed", "first advice",
    "first cause", "verdict", "gates changed", "assumptions", "passes",
)  # fmt: skip
FAULT_HEADS = ("fault", "strength", "shift, σ", "excess, σ", "seen at best", "noticed", "by", "first cause", "passes")


def render(found: Found) -> str:
    """The section of the page."""
    parts = [INTRODUCTION.format(**found)]
    if found["clean"]:
        parts.append(_clean(found["clean"]))
    if found["cases"]:
        parts.append("\n### Known cases\n\n" + table(CASE_HEADS, list(_cases(found["cases"])), (0, 8, 9, 10, 11, 12)))
    if found["faults"]:
        parts.append(_faults(found["faults"]))
    return "".join(parts)


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}" if 0 < value < 0.1 else f"{value:.0%}"


def _shares(found: Mapping[str, float], most: int = 4) -> str:
    return ", ".join(name + ("" if share == 1 else f" {_share(share)}") for name, share in list(found.items())[:most])


def _clean(clean: Found) -> str:
    """Coverage and efficiency of the methods, and false alarms."""
    rows = [
        [name, "{:.4f} ({:.4f} to {:.4f})".format(one["over_likelihood"], *one["over_likelihood_interval"]),
         f"{one['nees']:.2f} ± {one['nees_sigma']:.2f}", number(one["nees_with_misfit"]),
         *(f"{share:.1%}" for share in one["coverage"].values())]
        for name, one in clean["methods"].items()
    ]  # fmt: skip
    levels = next(iter(clean["methods"].values()))["coverage"]
    heads = (
        "method",
        "squared error over maximum likelihood's",
        "NEES",
        "with misfit",
        *(f"inside {level}" for level in levels),
    )
    false = [
        [name, _share(share), _shares(clean.get(f"false_{name}", {}), 5)] for name, share in clean["false"].items()
    ]
    false[4][2] = _shares(clean["levels"])
    return (
        f"### {clean['sets']:,} clean sets\n\nNEES of maximum likelihood: {clean['likelihood_nees']:.2f}.\n\n"
        + table(heads, rows) + "\n" + table(("held against a clean set by", "of the sets", "which"), false, (0, 2))
        + f"\nNo data for the gates {', '.join(clean['no_data'])}: nothing was held out, no incumbent, or nothing declared.\n"
    )  # fmt: skip


def _cases(cases: Found) -> Iterator[list[str]]:
    for one in cases.values():
        for row in one["rows"]:
            yield [
                one["says"] + ("" if one["visible"] else " (unobservable)"), f"{row['strength']:g} {one['unit']}".strip(),
                *(number(row[key]) for key in ("worst_sigma", "worst_sigma_with_misfit", "nees", "nees_with_misfit", "chi2_per_dof",
                                               "removed")),
                row["first"], row["first_cause"], row["level"], _shares(row["gates"]), row["assumptions"], _share(row["passes"]),
            ]  # fmt: skip


def _faults(faults: Found) -> str:
    """Every fault at every strength, the strength at which it matters in bold."""
    rows = []
    for one in faults.values():
        for row in one["rows"]:
            strength = f"{row['strength']:.3g} {one['unit']}"
            by = {
                **row["tests"],
                **{where: share for where, share in row["where"].items() if where not in {"tests", "causes"}},
            }
            rows.append([
                one["says"], f"**{strength}**" if row["matters"] else strength, number(row["shift"]), number(row["excess"]),
                number(row["noncentrality"]), _share(row["noticed_share"]), _shares(by), row["first_cause"], _share(row["passes"]),
            ])  # fmt: skip
    late = [one["says"] for one in faults.values() if not one["in_time"]]
    return (
        f"\n### {len(faults)} faults\n\nNoticed before they matter, or where they begin to: {len(faults) - len(late)} of "
        f"{len(faults)}. Not: {'; '.join(late) or 'none'}. Strengths at which a fault matters are bold.\n\n"
        + table(FAULT_HEADS, rows, (0, 6, 7))
    )
