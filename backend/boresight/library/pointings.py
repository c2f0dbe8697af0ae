"""A plan of pointings as the library returns it, and the list of attitudes that it reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from boresight.errors import RefusedInputError
from boresight.library.results import Summarised, Tabular
from boresight.library.text import Summary, written
from boresight.simulation import plans
from boresight.simulation.plans import CANDIDATE_COLUMNS, MOST_CANDIDATES, parse_candidates
from boresight.simulation.pointings import Candidates


@dataclass(frozen=True, kw_only=True, repr=False)
class PointingPlan(Summarised, Tabular, plans.PointingPlan):
    """What to observe next: `pointings` in order, and what a calibration of them will know.

    `sigma_before`, `sigma_after`: one sigma of each free parameter, SI; None before where nothing is known. `minutes_to_gate`:
    until every direction is known to half a typical sigma, the gate's limit; None where the plan does not reach it.
    """

    @classmethod
    def of(cls, found: plans.PointingPlan) -> PointingPlan:
        """Give a plan its face."""
        return cls(**{item.name: getattr(found, item.name) for item in fields(found) if item.init})

    def _columns(self) -> pa.Table:
        return self.to_table()

    def save(self, path: str | Path) -> None:
        """Write the pointings as CSV."""
        Path(path).write_bytes(self.to_csv())

    def _summarise(self) -> Summary:
        rows: list[Sequence[str]] = [("UTC", "slew s", "RA °", "Dec °", "roll °", "stars", "weakest σ")]
        rows += [
            (
                one.start_utc, f"{one.slew_s:.0f}", f"{one.ra_deg:.2f}", f"{one.dec_deg:+.2f}", f"{one.roll_deg:.1f}",
                str(one.stars), written(one.weakest, ".3g"),
            )
            for one in self.pointings
        ]  # fmt: skip
        return Summary(f"{self.sensor}: {self.sentence}", rows, (0,), [])


def list_degrees(path: Path) -> list[list[float]]:
    """Read attitudes as a server takes them: right ascension, declination and roll of each."""
    read = read_candidates(path)
    degrees: list[list[float]] = np.degrees(np.stack([read.ra_rad, read.dec_rad, read.roll_rad], axis=1)).tolist()
    return degrees


def read_candidates(path: str | Path) -> Candidates:
    """Read attitudes that may be chosen: CSV with ra_deg, dec_deg and roll_deg; refuses what is no angle with its row."""
    name = Path(path).name
    columns = csv.ConvertOptions(
        include_columns=list(CANDIDATE_COLUMNS), column_types=dict.fromkeys(CANDIDATE_COLUMNS, pa.float64())
    )
    try:
        table = csv.read_csv(path, convert_options=columns)
    except FileNotFoundError as error:
        raise RefusedInputError(f"There is no file {name}: check the name.") from error
    except (pa.ArrowException, KeyError, OSError) as error:
        raise RefusedInputError(
            f"{name} cannot be read ({error}): write CSV with {', '.join(CANDIDATE_COLUMNS)}, once each, one attitude per row."
        ) from error
    if not 0 < len(table) <= MOST_CANDIDATES:
        raise RefusedInputError(f"{name} has {len(table):,} attitudes: give 1 to {MOST_CANDIDATES:,}.")
    columns_deg = [np.asarray(table[column].to_numpy()) for column in CANDIDATE_COLUMNS]
    return parse_candidates(columns_deg, lambda index: f"{name}: row {index + 2}")
